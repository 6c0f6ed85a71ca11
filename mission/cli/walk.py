"""`fieldkit walk`: a person with a radio, a satellite receiver and a page. Heavy imports stay inside the command."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldkit import settings as given
from mission.cli.options import (
    HostOption,
    JsonOption,
    PageOption,
    PortOption,
    before_the_start,
    begun_folder,
    informed_maps,
    may_be_shown,
    may_hold_runs,
    say,
    shown_page,
    stay_open,
)

if TYPE_CHECKING:
    from mission.core.mission_file import Mission
    from mission.core.walk_text import WalkOptions

FIRST_FIX_S = 120.0
IN_THE_FILE = {
    "receiver": "[[robot]] receiver",
    "gnss": "[[positions]] robots",
    "antenna": "[antenna] file",
    "name": "[[robot]] name",
    "size_m": "[field] size_east_m and size_north_m",
    "rate_hz": "[sources] rate_hz",
    "sources": "[end] sources_found",
    "within_m": "[engine] found_within_m",
    "cot": "[maps] cot",
    "background": "[field] background",
}
"""Where a mission file says what these options say without one."""


@before_the_start()
def walk(
    context: typer.Context,
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
        str, typer.Option(help="The satellite receiver: gpsd://HOST, DEVICE[:BAUD], udp://HOST:PORT.")
    ] = "",
    antenna: Annotated[Path | None, typer.Option(help="The antenna file of 'fieldkit calibrate'.")] = None,
    name: Annotated[
        str, typer.Option(help="What to call whoever walks, here and on other people's maps.")
    ] = given.WALKER,
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
    from fieldkit.errors import ConfigError
    from fieldkit.receiver_file import receiver_of
    from mission.cli.missions import print_flown
    from mission.core.mission_file import read_mission
    from mission.core.walk_text import WalkOptions
    from mission.maps.background import read_background
    from mission.shell import setups
    from mission.shell.flight import fly
    from mission.shell.terminal import Watch
    from mission.shell.warm_up import warm_up

    if mission_file is not None:
        _nothing_twice(context, mission_file)
        mission = read_mission(mission_file)
        if not mission.safety.on_foot:
            raise ConfigError(
                f"{mission_file}: robot: nobody walks; give a robot "
                'vehicle = { driver = "person", address = "page" }'
            )
        may_be_shown(page, page_host, page_port)
    else:
        if not name.strip():
            raise ConfigError(f"--name: expected what to call whoever walks, got '{name}'; or leave it out")
        _all_there(receiver, gnss, antenna, background)
        may_hold_runs(out)
        may_be_shown(page, page_host, page_port)
        picture = "" if background is None else str(background.resolve())
        options = WalkOptions(
            receiver_of(receiver), gnss, Path(antenna or "").name, (0.0, 0.0), size_m, rate_hz, float(sources),
            within_m, person=name, background=picture, cot=tuple(cot or ()),
        )  # fmt: skip
        mission = _round_here(options, Path(antenna or "").parent)
    read_background(mission)  # before the walk: a map of elsewhere is of no use in the field
    setup = setups.live(mission)
    say("preparing the engine (compiled once on a new machine, up to a minute) ...")
    warm_up(mission)
    with (
        begun_folder(out, mission) as (folder, on_start),
        shown_page(mission, page, page_host, page_port) as shown,
    ):
        log = folder / "mission.mcap"
        say(f"recording to {log}; waiting for {', '.join(mission.kernel.engine.robots)} ...")
        with informed_maps(mission) as others, Watch(quiet=as_json and not sys.stderr.isatty()) as watch:
            runner = fly(mission, setup, log, watch.show, page=shown, others=others, on_start=on_start)
        print_flown(runner, folder, as_json=as_json)
        stay_open(shown, runner)


def _nothing_twice(context: typer.Context, mission_file: Path) -> None:
    """Raises `ConfigError` for an option that the mission file would silently outdo."""
    from fieldkit.errors import ConfigError

    for option, key in IN_THE_FILE.items():
        source = context.get_parameter_source(option)
        if source is not None and source.name == "COMMANDLINE":
            raise ConfigError(
                f"--{option.replace('_', '-')}: with a mission file that is {key} in {mission_file}; "
                "write it there, or walk without a file"
            )


def _all_there(receiver: str, gnss: str, antenna: Path | None, background: Path | None) -> None:
    """Raises `ConfigError` for what is missing, before anybody waits for a position."""
    from fieldkit.errors import ConfigError
    from mission.maps.background import looks_like_a_map

    given = {"--receiver": receiver, "--gnss": gnss, "--antenna": antenna}
    if missing := [name for name, value in given.items() if not value]:
        raise ConfigError(
            f"expected a mission file, or --receiver, --gnss and --antenna; missing: {', '.join(missing)}. "
            "'fieldkit demo --walk lora' shows a walk without any device"
        )
    if antenna is not None and not antenna.is_file():
        why = "it is a folder" if antenna.is_dir() else "no such file"
        raise ConfigError(f"--antenna {antenna}: cannot be read: {why}; 'fieldkit calibrate' writes one")
    if background is not None:
        looks_like_a_map(background, f"--background {background}")


def _round_here(options: "WalkOptions", beside: Path) -> "Mission":
    """The mission of a field round the first position, its antenna file in the folder `beside`.

    Whatever can be wrong is said before anybody waits for that position. Raises `ConfigError`, `DeviceError`.
    """
    import asyncio

    from fieldkit.geo import FieldFrame
    from mission.core.mission_file import mission_of
    from mission.core.walk_text import walk_text
    from mission.shell import setups
    from mission.shell.first_fix import first_fix, must_open

    where = beside / "(options)"
    setup = setups.live(mission_of(walk_text(options), where))
    for receiver in setup.receivers:
        must_open(receiver, str(options.receiver["port"]))
    say(f"waiting for a position from {options.gnss} ...")
    lat_deg, lon_deg = asyncio.run(first_fix(options.gnss, FIRST_FIX_S))
    half_m = options.size_m / 2
    origin_deg = FieldFrame(lat_deg, lon_deg).to_geodetic(-half_m, -half_m)[:2]
    return mission_of(walk_text(replace(options, origin_deg=origin_deg)), where)
