"""`fieldkit emulate | devices | vehicles | channels`. Heavy imports stay inside the commands."""

import sys
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.emulators.defaults import FIRMWARE, HIDDEN_HZ, PICTURES_HZ, PROFILE, SOURCES
from fieldkit import settings as given

if TYPE_CHECKING:
    from drivers.inventory import Found

NO_MAP = """none of {count} lines is a reading under any map:
{maps}
and none is a strength in dBm by the name of rssi, rss, signal, power or level.
Write a map of your own into a file radio.toml, as docs/lines.md shows, for
'fieldkit walk --receiver radio.toml ...'. Of 'S=79' that means -79 dBm:
  format = "regex"
  pattern = 'S=(?P<rss>\\d+)'
  unit = "-dBm\""""


SHOWN_LINES = 20
"""Of a radio that is watched; a fast one prints hundreds."""
SIGMA_DB = 4.0
"""Of emulated radios, where no antenna file says it."""

emulate = typer.Typer(
    help="Emulate a radio, a rover or a whole field on real wires. Example: fieldkit emulate xbee",
    no_args_is_help=True,
    rich_markup_mode=None,
)

ORIGIN_DEG = (47.3977, 8.5456)
"""Where an emulated field lies."""
SPEED_M_S = 0.4

Rate = Annotated[float, typer.Option(help="Mission seconds per wall second.")]


def _finite(**options: float) -> None:
    """Raises `ConfigError` for an option that is no number: a bound does not keep one out."""
    import math

    from fieldkit.errors import ConfigError

    for name, value in options.items():
        if not math.isfinite(value):
            raise ConfigError(f"--{name.replace('_', '-')}: expected a number, got {value}")


Seed = Annotated[int, typer.Option(min=0, help="Same seed, same sources and noise.")]
Around = Annotated[
    list[str] | None,
    typer.Option(
        "--with",
        metavar="NAME=VALUE",
        help="What the ground adds: shadow_db, shadow_m, walls, lobe_db, offset_db, deaf, packet_loss, foreign_hz, "
        "collision_s, walk_m_s, jump_m, jump_s, wander_m. May be given more than once.",
    ),
]


@emulate.command()
def xbee(
    profile: Annotated[str, typer.Option(help="s1, s1pro, s2c, xb3, 900hp or zigbee.")] = PROFILE,
    rate_hz: Annotated[float, typer.Option(help="Packets per second it hears.")] = 1.0,
    rss_dbm: Annotated[float, typer.Option(help="How strongly it hears them, mean.")] = -70.0,
    sigma_db: Annotated[float, typer.Option(help="Standard deviation of the strength.")] = SIGMA_DB,
    api_mode: Annotated[int, typer.Option(help="AP: 0 transparent, 1 API, 2 API escaped.")] = 2,
    output: Annotated[int, typer.Option(help="AO: 2 gives frames with RSSI.")] = 2,
    tcp: Annotated[int, typer.Option(help="Serve on this TCP port instead of a pseudo-terminal.")] = 0,
    seed: Seed = 1,
) -> None:
    """Emulate an XBee that hears a transmitter. Example: fieldkit emulate xbee --profile s1pro"""
    import asyncio

    from drivers.emulators.alone import run_xbee
    from drivers.emulators.xbee import PROFILES
    from fieldkit.errors import ConfigError

    if profile not in PROFILES:
        raise ConfigError(f"--profile: no '{profile}'; there are: {', '.join(PROFILES)}")
    if rate_hz <= 0:
        raise ConfigError(f"--rate-hz: expected a positive number, got {rate_hz:g}")
    _finite(rate_hz=rate_hz, rss_dbm=rss_dbm, sigma_db=sigma_db)
    settings = {"AP": api_mode, "AO": output}
    asyncio.run(run_xbee(PROFILES[profile], settings, rate_hz, rss_dbm, sigma_db, tcp, seed))


@emulate.command()
def rover(
    address: Annotated[str, typer.Option(help="Where its telemetry goes, host:port.")] = given.TELEMETRY,
    system_id: Annotated[int, typer.Option(min=1, max=250, help="Its MAVLink system id.")] = 1,
    latitude_deg: Annotated[float, typer.Option(help="Where it stands.")] = 47.3977,
    longitude_deg: Annotated[float, typer.Option(help="Where it stands.")] = 8.5456,
    max_speed_m_s: Annotated[float, typer.Option(help="Its top speed.")] = 1.0,
    firmware: Annotated[str, typer.Option(help="rover, copter or px4.")] = FIRMWARE,
    rate: Rate = 1.0,
    seed: Seed = 1,
) -> None:
    """Emulate an ArduRover, or a copter, on UDP. Example: fieldkit emulate rover --firmware copter"""
    from drivers.emulators.alone import run_field
    from drivers.emulators.field import EmulatedRobot
    from drivers.emulators.profiles import PROFILES
    from fieldkit.errors import ConfigError
    from fieldkit.world.surroundings import NOTHING_AROUND

    if firmware not in PROFILES:
        raise ConfigError(f"--firmware: no '{firmware}'; there are: {', '.join(PROFILES)}")
    _finite(latitude_deg=latitude_deg, longitude_deg=longitude_deg, max_speed_m_s=max_speed_m_s)
    robots = (EmulatedRobot(firmware, system_id, 0.0, 0.0, firmware=firmware),)
    run_field(
        robots, (), address, (latitude_deg, longitude_deg), max_speed_m_s, rate, seed, 1.0, NOTHING_AROUND
    )


@emulate.command()
def field(
    robots: Annotated[int, typer.Option(min=1, max=100, help="Robots, each with an XBee and a rover.")] = 4,
    sources: Annotated[int, typer.Option(min=0, max=50, help="Hidden transmitters.")] = SOURCES,
    size_m: Annotated[float, typer.Option(min=1.0, help="Side of the square field.")] = 10.0,
    address: Annotated[str, typer.Option(help="Where telemetry goes, host:port.")] = given.TELEMETRY,
    agents: Annotated[
        bool,
        typer.Option(
            "--agents", help="For 'fieldkit agent': a port for each robot, from that of --address on."
        ),
    ] = False,
    around: Around = None,
    rate: Rate = 1.0,
    seed: Seed = 1,
    out: Annotated[
        Path, typer.Option(help="Folder for a mission file and an antenna file that fit it; written anew.")
    ] = Path("emulated-field"),
) -> None:
    """Emulate robots, radios and hidden transmitters, and write a mission that searches for them, ready to run.

    Example: fieldkit emulate field --robots 4

    Example: fieldkit emulate field --robots 2 --agents

    Example: fieldkit emulate field --with shadow_db=6 --with walls=4
    """
    import numpy as np

    from drivers.emulators.alone import run_field, write_mission
    from drivers.emulators.claims import claimed_folder
    from drivers.emulators.field import EmulatedRobot
    from drivers.links import host_and_port
    from fieldkit.world.sources import random_sources
    from fieldkit.world.surroundings import surroundings_of

    _finite(size_m=size_m)
    ground = surroundings_of(around or ())
    rng = np.random.default_rng(seed)
    hidden = random_sources(sources, size_m, size_m, (0.0,), HIDDEN_HZ, rng)
    write = partial(write_mission, out, size_m, sources, ORIGIN_DEG, SPEED_M_S, agents)
    host, port = host_and_port(address)
    team = tuple(
        EmulatedRobot(
            f"robot{n + 1}",
            n + 1,
            size_m * (n + 0.5) / robots,
            0.5,
            address=f"{host}:{port + n}" if agents else "",
        )
        for n in range(robots)
    )
    with claimed_folder(out):
        run_field(team, tuple(hidden), address, ORIGIN_DEG, SPEED_M_S, rate, seed, size_m, ground, write)


@emulate.command()
def radios(
    mission: Annotated[str, typer.Option(help="The mission file whose robots get radios.")] = "mission.toml",
    telemetry: Annotated[
        str, typer.Option(help="Where a copy of the vehicles' telemetry comes in.")
    ] = "udpin:127.0.0.1:14560",
    source: Annotated[
        list[str] | None, typer.Option(help="A transmitter: EAST,NORTH in metres, or EAST,NORTH,POWER_DB.")
    ] = None,
    sources: Annotated[
        int, typer.Option(min=1, max=50, help="Hidden at random where none is named.")
    ] = SOURCES,
    rate_hz: Annotated[float, typer.Option(help="How often a named one transmits.")] = 0.2,
    profile: Annotated[str, typer.Option(help="s1, s1pro, s2c or xb3.")] = PROFILE,
    around: Around = None,
    seed: Seed = 1,
) -> None:
    """Give the robots of a mission file radios that hear from where their vehicles are, to rehearse with.

    Example: fieldkit emulate radios --mission mission.toml --source 12,30
    """
    import asyncio
    from pathlib import Path

    from drivers.emulators.rehearsal import named_sources, read_rehearsal, run_radios
    from fieldkit.clock import RealClock
    from fieldkit.world.surroundings import surroundings_of

    named, ground = named_sources(source or (), rate_hz), surroundings_of(around or ())
    what = read_rehearsal(
        Path(mission), sources=named, count=sources, seed=seed, profile=profile, around=ground
    )
    asyncio.run(run_radios(what, telemetry, RealClock(), seed, typer.echo))


@emulate.command()
def sniffer(
    kind: Annotated[str, typer.Option(help="nrf, ti, or pcap: a live pipe.")] = "nrf",
    channel: Annotated[int, typer.Option(min=11, max=26, help="Channel the packets are on.")] = given.CHANNEL,
    rate_hz: Annotated[float, typer.Option(min=0.001, help="Packets per second it hears.")] = 1.0,
    rss_dbm: Annotated[float, typer.Option(help="How strongly it hears them, mean.")] = -70.0,
    sigma_db: Annotated[float, typer.Option(help="Standard deviation of the strength.")] = SIGMA_DB,
    seed: Seed = 1,
) -> None:
    """Emulate a promiscuous 802.15.4 receiver. Example: fieldkit emulate sniffer --kind ti"""
    import asyncio

    from drivers.emulators.alone import run_sniffer
    from fieldkit.errors import ConfigError

    if kind not in ("nrf", "ti", "pcap"):
        raise ConfigError(f"--kind: expected nrf, ti or pcap, got {kind!r}")
    _finite(rate_hz=rate_hz, rss_dbm=rss_dbm, sigma_db=sigma_db)
    asyncio.run(run_sniffer(kind, channel, rate_hz, rss_dbm, sigma_db, seed))


@emulate.command()
def printer(
    style: Annotated[
        str, typer.Option(help="Whose words: esp32-ble, rylr, meshtastic, rtl_433, ...")
    ] = "rylr",
    rate_hz: Annotated[float, typer.Option(min=0.001, help="Packets per second it hears.")] = 1.0,
    rss_dbm: Annotated[float, typer.Option(help="How strongly it hears them, mean.")] = -70.0,
    sigma_db: Annotated[float, typer.Option(help="Standard deviation of the strength.")] = SIGMA_DB,
    seed: Seed = 1,
) -> None:
    """Emulate a radio that prints what it hears. Example: fieldkit emulate printer --style esp32-ble"""
    import asyncio

    from drivers.emulators.alone import run_printer
    from drivers.emulators.printer import STYLES
    from fieldkit.errors import ConfigError

    if style not in STYLES:
        raise ConfigError(f"--style: no '{style}'; there are: {', '.join(STYLES)}")
    _finite(rate_hz=rate_hz, rss_dbm=rss_dbm, sigma_db=sigma_db)
    asyncio.run(run_printer(style, rate_hz, rss_dbm, sigma_db, seed))


@emulate.command()
def camera(
    out: Annotated[str, typer.Option(help="Folder that gets the calibration file.")] = ".",
    rate_hz: Annotated[float, typer.Option(min=0.1, max=60.0, help="Pictures per second.")] = PICTURES_HZ,
    port: Annotated[int, typer.Option(help="TCP port; 0: any.")] = 0,
) -> None:
    """Emulate an overhead network camera with four robots. Example: fieldkit emulate camera --port 8554"""
    import asyncio

    from drivers.emulators.alone import run_camera

    asyncio.run(run_camera(out, rate_hz, port))


def channels(
    port: Annotated[str, typer.Argument(help="The XBee's port.")],
    scans: Annotated[int, typer.Option(min=1, help="How many scans.")] = 5,
    scan_s: Annotated[float, typer.Option(min=0.01, max=15.0, help="Length of one scan.")] = 2.0,
    busy_dbm: Annotated[float, typer.Option(help="From here up a channel counts as busy.")] = -80.0,
    baud: Annotated[int, typer.Option(help="Baud rate of the port.")] = given.BAUD,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Scan the channels' energy with an XBee, to choose where to listen. It transmits nothing.

    Example: fieldkit channels /dev/ttyUSB0 --scans 10
    """
    import json

    from drivers.xbee.survey import occupancy

    found = occupancy(port, baud, scans, scan_s, busy_dbm)
    if as_json:
        typer.echo(json.dumps(found))
        return
    typer.echo("channel   mean dBm  strongest   busy")
    for each in found["channels"]:
        typer.echo(
            f"{each['channel']:7d} {each['mean_dbm']:10.1f} {each['strongest_dbm']:10.0f} {each['busy_share']:6.0%}"
        )
    typer.echo(
        f"{found['scans']} scans, for {found['not_listening_s']:.1f} s without packets. Any radio counts, WiFi too."
    )


def devices(
    port: Annotated[list[str] | None, typer.Argument(help="Ports to open and ask what they are.")] = None,
    baud: Annotated[int, typer.Option(help="Baud rate of the ports asked.")] = given.BAUD,
    watched: Annotated[
        str | None,
        typer.Option("--watch", metavar="PORT", help="Show the lines that come in, and propose a map."),
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.1, help="How long to watch.")] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Say what is plugged in and what it can hear; of a radio that prints, what its lines mean.

    Exit code 1: a port that is asked is absent, or nothing on it answers.

    Example: fieldkit devices --watch /dev/ttyUSB0
    """
    import json

    from drivers import inventory

    if watched is not None:
        _watch(watched, baud, seconds, as_json)
        return
    found = [inventory.ask(each, baud) for each in port] if port else inventory.ports()
    if as_json:
        typer.echo(json.dumps(inventory.as_json(found)))
    else:
        _print_found(found)
    if not all(each.answered for each in found):
        raise typer.Exit(1)


def _print_found(found: "list[Found]") -> None:
    """A port a line; below it its settings, and what to do."""
    for each in found:
        typer.echo(f"{each.port}: {each.what}")
        if each.settings:
            typer.echo("  " + ", ".join(f"{name}={value}" for name, value in each.settings.items()))
        for line in each.advice:
            typer.echo(f"  {line}")
    if not found:
        typer.echo("no USB serial device is plugged in")


def _watch(port: str, baud: int, seconds: float, as_json: bool) -> None:
    """Lines as they come, and what a mission file would say of them."""
    import json

    from drivers.lines.maps import MAPS
    from drivers.lines.propose import propose
    from drivers.lines.receiver import watch

    shown = 0

    def show(line: str) -> None:
        nonlocal shown
        shown += 1
        if shown <= SHOWN_LINES and not as_json:
            typer.echo(f"  {_harmless(line)[:76]}")

    if not as_json and sys.stderr.isatty():
        typer.echo(f"listening for {seconds:g} s; Ctrl-C ends it earlier", err=True)
    lines = watch(port, baud, seconds, show)
    found = propose(lines)
    if as_json:
        proposal = None if found is None else {"toml": found.toml(), "read": found.read, "of": found.of}
        typer.echo(json.dumps({"lines": lines, "proposal": proposal}))
        return
    if shown > SHOWN_LINES:
        typer.echo(f"  and {shown - SHOWN_LINES} more")
    if not lines:
        is_serial = "://" not in port and port != "-"
        hint = f"is the radio on, is its baud rate {baud}?" if is_serial else "does anything send there?"
        typer.echo(f"no line came from {port} within {seconds:g} s: {hint}")
    elif found is None:
        typer.echo(NO_MAP.format(count=len(lines), maps=fill(", ".join(MAPS), 78)))
    else:
        about = found.map.about or "made from the lines themselves"
        typer.echo(f"{found.read} of {len(lines)} lines are readings as: {about}")
        typer.echo(f'in a mission file:  receiver = {{ driver = "lines", port = "{port}", {found.toml()} }}')
        if found.name:
            typer.echo(f"without one:        fieldkit walk --receiver {port},{found.name} ...")
            return
        typer.echo("without one:        fieldkit walk --receiver radio.toml ..., with radio.toml:")
        for key in (f'port = "{port}"', *found.keys()):
            typer.echo(f"  {key}")


def _harmless(line: str) -> str:
    """What a radio prints, without what would move a terminal's cursor, clear it or name it anew."""
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in line)


def vehicles(
    address: Annotated[str, typer.Option(help="Link to listen on.")] = "udpin:0.0.0.0:14550",
    seconds: Annotated[float, typer.Option(min=1.0, help="How long to listen.")] = 5.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """List the vehicles heard on a link. Example: fieldkit vehicles --address udpin:0.0.0.0:14550"""
    import json

    from drivers import inventory

    found = inventory.heard_vehicles(address, seconds)
    if as_json:
        typer.echo(json.dumps(found))
        return
    for each in found:
        battery = "unknown" if each["battery_pct"] is None else f"{each['battery_pct']:.0f} %"
        armed = "armed" if each["armed"] else "disarmed"
        double = ", TWO VEHICLES HAVE THIS ID" if each["two_with_this_id"] else ""
        typer.echo(
            f"system {each['system_id']}: {each['firmware']}, {each['mode']}, {armed}, battery {battery}, "
            f"from {each['address']}{double}"
        )
    if not found:
        typer.echo(f"no vehicle heard on {address} in {seconds:g} s")
