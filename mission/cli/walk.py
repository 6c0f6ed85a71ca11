"""`fieldkit walk`: a person with a radio, a satellite receiver and a page. Heavy imports stay inside the command."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldkit import settings as given
from mission.cli.options import (
    HostOption,
    JsonOption,
    PageOption,
    PortOption,
    informed_maps,
    run_folder,
    say,
    shown_page,
    stay_open,
)

if TYPE_CHECKING:
    from mission.core.mission_file import Mission

FIRST_FIX_S = 120.0


def walk(
    mission_file: Annotated[
        Path | None,
        typer.Argument(metavar="[MISSION.TOML]", help="A mission file; without one, the options say all."),
    ] = None,
    receiver: Annotated[
        str,
        typer.Option(
            metavar="PORT[,MAP]",
            help="The radio: xbee:PORT, or where its lines come from, and their map; a .toml file with the keys of "
            "a map of your own.",
        ),
    ] = "",
    gnss: Annotated[
        str, typer.Option(help="The satellite receiver: gpsd://HOST, a serial port, udp://HOST:PORT.")
    ] = "",
    antenna: Annotated[Path | None, typer.Option(help="The antenna file of 'fieldkit calibrate'.")] = None,
    size_m: Annotated[
        float, typer.Option(min=10.0, help="Side of the field round the first position.")
    ] = given.WALK_SIDE_M,
    rate_hz: Annotated[
        float, typer.Option(min=1e-4, help="How often a transmitter sends.")
    ] = given.WALK_RATE_HZ,
    sources: Annotated[
        int, typer.Option(min=1, help="How many there may be; the walk ends when all are found.")
    ] = 1,
    within_m: Annotated[
        float, typer.Option(min=0.5, help="A transmitter is found within this.")
    ] = given.WALK_FOUND_WITHIN_M,
    cot: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL", help="Inform ATAK and the like: udp://239.2.3.1:6969, tcp://HOST:PORT; repeat."
        ),
    ] = None,
    background: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE", help="A map under the page's: an .mbtiles, or a geo-referenced picture."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder that gets a new folder for this walk.")] = Path("runs"),
    page: PageOption = True,
    page_host: HostOption = given.PAGE_HOST,
    page_port: PortOption = given.PAGE_PORT,
    as_json: JsonOption = False,
) -> None:
    """Walk to hidden transmitters: the page says where to go next, and what has been found.

    Open the page on the phone in your hand (--page-host 0.0.0.0). Nothing is ever sent by the radio.

    Example: fieldkit walk --receiver /dev/ttyUSB0,rylr --gnss /dev/ttyACM0 --antenna antenna.toml
    """
    from mission.cli.missions import print_flown
    from mission.shell import setups
    from mission.shell.flight import fly
    from mission.shell.terminal import Watch
    from mission.shell.warm_up import warm_up

    folder = run_folder(out)
    given = {"--receiver": receiver, "--gnss": gnss, "--antenna": antenna}
    numbers = (size_m, rate_hz, float(sources), within_m)
    maps = ("" if background is None else str(background.resolve()), tuple(cot or ()))
    mission = _mission(mission_file, folder, given, numbers, maps)
    setup = setups.live(mission)
    say("preparing the engine (compiled once on a new machine, up to a minute) ...")
    warm_up(mission)
    say(f"recording to {folder}/mission.mcap; waiting for {', '.join(mission.kernel.engine.robots)} ...")
    with shown_page(mission, page, page_host, page_port) as shown:
        with informed_maps(mission) as others, Watch(quiet=as_json and not sys.stderr.isatty()) as watch:
            runner = fly(mission, setup, folder / "mission.mcap", watch.show, page=shown, others=others)
        print_flown(runner, folder, as_json=as_json)
        stay_open(shown, runner)


def _mission(
    mission_file: Path | None,
    folder: Path,
    given: dict[str, Any],
    numbers: tuple[float, float, float, float],
    maps: tuple[str, tuple[str, ...]],
) -> "Mission":
    """The mission of a file, or of what the options say. Raises `ConfigError`, `DeviceError`."""
    from fieldkit.errors import ConfigError
    from mission.core.mission_file import read_mission
    from mission.maps.background import read_background

    if mission_file is None:
        missing = [name for name, value in given.items() if not value]
        if missing:
            raise ConfigError(
                f"expected a mission file, or --receiver, --gnss and --antenna; missing: {', '.join(missing)}. "
                "'fieldkit demo --walk lora' shows a walk without any device"
            )
        mission_file = _written(folder, given, numbers, maps)
    elif maps[1]:
        raise ConfigError(f"--cot: the mission file says whom it informs: [maps] cot = {list(maps[1])}")
    elif maps[0]:
        raise ConfigError(f"--background: the mission file names it: [field] background = {maps[0]!r}")
    mission = read_mission(mission_file)
    read_background(mission)  # before the walk: a map of elsewhere is of no use in the field
    if not mission.safety.on_foot:
        raise ConfigError(
            f'{mission_file}: robot: nobody walks; give a robot vehicle = {{ driver = "person", address = "page" }}'
        )
    return mission


def _written(
    folder: Path,
    given: dict[str, Any],
    numbers: tuple[float, float, float, float],
    maps: tuple[str, tuple[str, ...]],
) -> Path:
    """A mission file in the walk's folder, its field round the first position. Raises `ConfigError`, `DeviceError`."""
    import asyncio

    from fieldkit.errors import ConfigError
    from fieldkit.files import write_whole
    from fieldkit.geo import FieldFrame
    from mission.core.walk_text import WalkOptions, walk_text
    from mission.shell.first_fix import first_fix

    size_m, rate_hz, expected, within_m = numbers
    path = Path(given["--antenna"])
    try:
        write_whole(folder / "antenna.toml", path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"--antenna {path}: cannot be read: {error}; 'fieldkit calibrate' writes one"
        ) from error
    receiver = _receiver(given["--receiver"])
    say(f"waiting for a position from {given['--gnss']} ...")
    lat_deg, lon_deg = asyncio.run(first_fix(given["--gnss"], FIRST_FIX_S))
    south_west = FieldFrame(lat_deg, lon_deg).to_geodetic(-size_m / 2, -size_m / 2)
    text = walk_text(
        WalkOptions(
            receiver,
            given["--gnss"],
            "antenna.toml",
            (south_west[0], south_west[1]),
            size_m,
            rate_hz,
            expected,
            within_m,
            background=maps[0],
            cot=maps[1],
        )
    )
    write_whole(folder / "mission.toml", text)
    return folder / "mission.toml"


def _receiver(words: str) -> dict[str, Any]:
    """A receiver's table from `xbee:PORT`, `PORT[,MAP]` of a radio that prints, or a file. Raises `ConfigError`."""
    if words.startswith("xbee:"):
        return {"driver": "xbee", "port": words.removeprefix("xbee:")}
    if words.endswith(".toml"):
        from fieldkit.receiver_file import read_receiver

        return read_receiver(Path(words))
    port, _, line_map = words.partition(",")
    return {"driver": "lines", "port": port, "map": line_map or "json"}
