"""`fieldkit agent`: one robot's part of a team without a common computer. Heavy imports stay inside the command."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldkit import settings as given
from mission.cli.missions import UNCONFIRMED_EXIT
from mission.cli.options import (
    HostOption,
    JsonOption,
    PortOption,
    before_the_start,
    begun_folder,
    may_be_shown,
    print_json,
    say,
    shown_page,
)

if TYPE_CHECKING:
    from fieldkit.clock import Clock
    from fieldkit.engine.decentralised.card import Card
    from fieldkit.ports import Network
    from mission.core.mission_file import Mission

KEY_FILE = "mission.key"
HOLD_S = 15.0
"""HOLD ALL is said for so long to those that have not shown it."""
BY_HAND = "Stop them by hand, or say it again from nearer to them"


def agent(
    mission_file: Annotated[
        Path, typer.Argument(metavar="MISSION.TOML", help="The mission file, the same on all.")
    ],
    robot: Annotated[str, typer.Option(metavar="NAME", help="The robot whose computer this is.")] = "",
    key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The mission's key; default: mission.key beside the file."),
    ] = None,
    new_key: Annotated[
        bool, typer.Option("--new-key", help="Write a key, to be copied to all robots, and end.")
    ] = False,
    hold: Annotated[
        bool,
        typer.Option(
            "--hold", help="From a computer without a robot: HOLD ALL in reach, say who does, and end."
        ),
    ] = False,
    watch: Annotated[
        bool,
        typer.Option(
            "--watch",
            help="From a computer without a robot: a page with all that robots know, for orders to all.",
        ),
    ] = False,
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="ADDRESS", help="Where another agent listens: tcp/192.168.1.11:7447; repeat."),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ADDRESS",
            help="Where --connect reaches this one: tcp/0.0.0.0:7447; default: any free port; repeat.",
        ),
    ] = None,
    scouting: Annotated[
        bool, typer.Option("--scouting/--no-scouting", help="Look for others by multicast.")
    ] = True,
    contact_m: Annotated[
        float | None,
        typer.Option(
            help="Promise that robots always hear each other within so many metres; default: no promise."
        ),
    ] = None,
    wait_s: Annotated[
        float,
        typer.Option(
            min=given.AGENT_WAIT_S.low,
            max=given.AGENT_WAIT_S.high,
            help="Wait so long at the start for robots that nobody has heard of, then go on without them.",
        ),
    ] = given.AGENT_WAIT_S.default,
    bytes_s: Annotated[
        float,
        typer.Option(
            min=given.AGENT_BYTES_S.low,
            max=given.AGENT_BYTES_S.high,
            help="What this agent sends at the most, a second.",
        ),
    ] = given.AGENT_BYTES_S.default,
    out: Annotated[Path, typer.Option(help="Folder that gets a new folder for this run.")] = Path("runs"),
    override: Annotated[
        str,
        typer.Option(help="Why it may start although its vehicle's check is red; goes into the recording."),
    ] = "",
    anew: Annotated[
        bool,
        typer.Option("--anew", help="Begin a new mission, without what an earlier agent of the robot knew."),
    ] = False,
    page: Annotated[
        bool,
        typer.Option(
            "--page", help="Serve what this robot knows as a page; for a laptop with --page-host 0.0.0.0."
        ),
    ] = False,
    page_host: HostOption = given.PAGE_HOST,
    page_port: PortOption = given.PAGE_PORT,
    as_json: JsonOption = False,
) -> None:
    """Run one robot's part of a mission on its own computer; the robots' agents talk over Zenoh.

    Each robot decides for itself; those in contact decide alike. Enter holds ALL robots in reach, Ctrl-C ends this
    agent alone. An agent that was killed, or ended while others go on, takes up its log when it is started again.
    Exit code 4: the vehicle has not shown that it holds.

    Example: fieldkit agent mission.toml --robot r1 --listen tcp/0.0.0.0:7447

    Example: fieldkit agent mission.toml --robot r2 --connect tcp/192.168.1.11:7447

    Example: fieldkit agent mission.toml --robot r2 --page --page-host 0.0.0.0

    Example: fieldkit agent mission.toml --watch

    Example: fieldkit agent mission.toml --hold
    """
    from fieldkit import plugins
    from fieldkit.clock import RealClock
    from fieldkit.ports import DriverContext
    from mission.cli.missions import print_flown
    from mission.core.mission_file import read_mission
    from mission.shell import setups
    from mission.shell.agent_flight import Options, card_of, fly_agent, interrupted, left
    from mission.shell.alone import alone
    from mission.shell.terminal import Watch
    from mission.shell.warm_up import warm_up

    key_file = key or mission_file.with_name(KEY_FILE)
    if new_key:
        _write_key(key_file)
        return
    mission = read_mission(mission_file)
    clock = RealClock()
    robots = mission.kernel.engine.robots
    _check_whose(robot, robots, hold or watch, both=hold and watch)
    card = card_of(mission, robot or robots[0], clock)
    secret = _secret(key_file, mission_file)
    wires = {"listen": listen or [], "connect": connect or [], "scouting": scouting}
    topic = _topic(secret)
    network = plugins.load("fieldkit.networks", "zenoh")(topic, wires, DriverContext(clock, mission.frame))
    if watch:
        _watch(mission, network, clock, secret, out, bytes_s, page_host, page_port, as_json=as_json)
        return
    if hold:
        _hold(robots, network, card, secret, clock, as_json=as_json)
        return
    setup = setups.of_robot(mission, robot, clock)
    resumed, was_left = (None, None) if anew else (interrupted(out, card, secret), left(out, card, secret))
    options = Options(robot, secret, contact_m, bytes_s, override, wait_s, resumed, was_left)
    may_be_shown(page, page_host, page_port)
    say("preparing the engine (compiled once on a new machine, up to a minute) ...")
    with before_the_start():
        warm_up(mission)
    if mission.kernel.planner == "dprwa":
        say(
            "engine.planner is dprwa: robots out of contact will not meet as planned; 'dprwa-apart' keeps meetings"
        )
    with before_the_start(), alone(robot, topic), begun_folder(out, mission) as (folder, on_start):
        if resumed is not None:
            say(f"goes on with what {robot} knew: {resumed}", always=True)
        say(f"{robot} records to {folder}")
        say(f"looks for others {network.where}")
        with (
            shown_page(mission, page, page_host, page_port, "agent") as shown,
            Watch(quiet=as_json and not sys.stderr.isatty()) as terminal,
        ):
            runner = fly_agent(mission, setup, network, card, options, folder, terminal.show, shown, on_start)
        say(f"written: {folder}")
        say("'fieldkit collect' makes one recording of the folders of all robots")
    # A robot's computer has better to do than to draw.
    print_flown(runner, folder, as_json=as_json, report=False)


def _check_whose(robot: str, robots: tuple[str, ...], none: bool, *, both: bool) -> None:
    """Raises `ConfigError` unless it is said once whose computer this is. `none`: it has no robot."""
    from fieldkit.errors import ConfigError

    if bool(robot) == none or both:
        raise ConfigError(
            f"--robot: which robot's computer is this? There are {', '.join(robots)}; on a computer without one "
            "either --watch or --hold"
        )


def _watch(
    mission: "Mission",
    network: "Network",
    clock: "Clock",
    secret: bytes,
    out: Path,
    bytes_s: float,
    host: str,
    port: int,
    *,
    as_json: bool,
) -> None:
    """The page of a computer without a robot; exit code 4 where somebody is to hold and has not shown it."""
    from mission.replay.command import plain_source
    from mission.shell.terminal import Watch, sources_table
    from mission.shell.warm_up import warm_up
    from mission.shell.watch_flight import watch_team

    may_be_shown(True, host, port)
    say("preparing the engine (compiled once on a new machine, up to a minute) ...")
    with before_the_start():
        warm_up(mission)
    with before_the_start(), begun_folder(out, mission) as (folder, on_start):
        say(f"records to {folder}")
        say(f"looks for robots {network.where}")
        with (
            shown_page(mission, True, host, port, "page") as shown,
            Watch(quiet=as_json and not sys.stderr.isatty()) as terminal,
        ):
            watched = watch_team(
                mission, network, clock, secret, folder,
                bytes_s=bytes_s, on_progress=terminal.show, page=shown, on_start=on_start,
            )  # fmt: skip
    result, finds = watched.result(), [plain_source(source) for source in watched.kernel.sources()]
    if as_json:
        print_json(result | {"sources": finds, "recording": str(folder / "common.mcap")})
    else:
        typer.echo(f"ended: {watched.end_reason}; this ended no robot's agent")
        sources_table(finds, watched.kernel.detections)
    say(f"written: {folder}")
    say("'fieldkit collect' takes the folder in, as a robot's")
    if result["not_handed_on"]:
        say(f"NOBODY HAS GOT: {', '.join(result['not_handed_on'])}", always=True)
    if others := result["not_shown_to_hold"]:
        say(f"NOT CONFIRMED to hold: {', '.join(others)}. {BY_HAND}", always=True)
        raise typer.Exit(UNCONFIRMED_EXIT)


def _hold(
    robots: tuple[str, ...], network: "Network", card: "Card", secret: bytes, clock: "Clock", *, as_json: bool
) -> None:
    """HOLD ALL from a computer without a robot."""
    import asyncio

    from mission.shell.hold_all import hold_all

    say(f"says HOLD ALL until all hold, for {HOLD_S:g} s at the most")
    say(f"looks for robots {network.where}")
    said = asyncio.run(
        hold_all(robots, network, card, secret, clock, HOLD_S, lambda text: say(text, always=True))
    )
    _print_held(said, as_json=as_json)


def _print_held(said: dict[str, str], *, as_json: bool) -> None:
    """Who holds; exit code 4 where somebody has not shown it."""
    if as_json:
        print_json(said)
    else:
        for robot, word in said.items():
            typer.echo(f"{robot} {word}")
    others = [robot for robot, word in said.items() if word != "holds"]
    if others:
        say(f"NOT CONFIRMED to hold: {', '.join(others)}. {BY_HAND}", always=True)
        raise typer.Exit(UNCONFIRMED_EXIT)


def _secret(key_file: Path, mission_file: Path) -> bytes:
    """The mission's key. Raises `ConfigError` where there is none."""
    from fieldkit.engine.decentralised.sealing import parse_key
    from fieldkit.errors import ConfigError

    try:
        return parse_key(key_file.read_text(encoding="ascii"), str(key_file))
    except (OSError, UnicodeDecodeError):
        raise ConfigError(
            f"{key_file}: cannot be read; 'fieldkit agent {mission_file} --new-key' writes one, to be copied to all"
        ) from None


def _topic(secret: bytes) -> str:
    """Where agents of one key meet: nobody learns the key from it."""
    from fieldkit.engine.decentralised.sealing import session_key

    return session_key(secret, "topic").hex()[:12]


def _write_key(path: Path) -> None:
    """A fresh key, for nobody else to read."""
    import os
    import secrets

    from fieldkit.engine.decentralised.sealing import KEY_BYTES
    from fieldkit.errors import ConfigError, NotWritten

    try:
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise ConfigError(
            f"{path}: exists already, and is never overwritten: the other robots may have it"
        ) from None
    except OSError as error:
        raise NotWritten(path, error) from error
    with os.fdopen(file, "w", encoding="ascii") as stream:
        stream.write(secrets.token_hex(KEY_BYTES) + "\n")
    typer.echo(f"written: {path}; copy it, the mission file and the antenna file to all robots")
