"""`fieldkit run | preflight | replay | report | new | check`. Heavy imports stay inside the commands."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    print_json,
    say,
    shown_page,
)

if TYPE_CHECKING:
    from fieldkit.recording.reader import Recording
    from mission.replay.command import Changes
    from mission.shell.recorder import Follower
    from mission.shell.runner import Runner

UNCONFIRMED_EXIT = 4
"""Exit code of a mission whose vehicles have not all shown that they hold."""


@before_the_start()
def run(
    mission_file: Annotated[
        Path | None, typer.Argument(metavar="MISSION.TOML", help="The mission file; not with --resume.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder that gets a new folder for this run.")] = Path("runs"),
    resume: Annotated[
        Path | None, typer.Option(metavar="LOG", help="Go on with the mission of an interrupted recording.")
    ] = None,
    override: Annotated[
        str, typer.Option(help="Why it may start although a vehicle's check is red; goes into the recording.")
    ] = "",
    page: PageOption = True,
    page_host: HostOption = given.PAGE_HOST,
    page_port: PortOption = given.PAGE_PORT,
    as_json: JsonOption = False,
) -> None:
    """Run a mission on your own radios and vehicles, with a live page in the browser.

    Enter holds all vehicles, Ctrl-C holds them and closes the recording. Exit code 4: a vehicle has not shown that it
    holds.

    --resume goes on after a crash or power cut: the same belief, the vehicles adopted, nothing re-armed unasked.

    Example: fieldkit run mission.toml
    """
    from fieldkit.errors import ConfigError
    from fieldkit.recording.reader import open_recording
    from mission.core.mission_file import read_mission
    from mission.replay.replay import resumable
    from mission.shell import setups
    from mission.shell.flight import fly
    from mission.shell.terminal import Watch
    from mission.shell.warm_up import warm_up

    past = None if resume is None else open_recording(resume)
    if (past is None) == (mission_file is None):
        raise ConfigError("expected either a mission file or --resume with a recording, which holds its own")
    if past is not None:
        mission = resumable(past)
    elif mission_file is not None:
        mission = read_mission(mission_file)
    setup = setups.live(mission)
    may_be_shown(page, page_host, page_port)
    say("preparing the engine (compiled once on a new machine, up to a minute) ...")
    warm_up(mission)
    with begun_folder(out, mission) as (folder, on_start):
        log = folder / "mission.mcap"
        say(f"recording to {log}; waiting for {', '.join(mission.kernel.engine.robots)} ...")
        with (
            shown_page(mission, page, page_host, page_port) as shown,
            informed_maps(mission) as others,
            Watch(quiet=as_json and not sys.stderr.isatty()) as watch,
        ):
            runner = fly(
                mission, setup, log, watch.show,
                page=shown, override=override, past=past, others=others, on_start=on_start,
            )  # fmt: skip
    print_flown(runner, folder, as_json=as_json)


def print_flown(runner: "Runner", folder: Path, *, as_json: bool, report: bool = True) -> None:
    """What was found, then the report if wanted, then who does not hold: exit code 4 where somebody does not."""
    from mission.replay.command import plain_source
    from mission.shell.signals import interruptible
    from mission.shell.terminal import sources_table

    finds = [plain_source(source) for source in runner.kernel.sources()]
    if as_json:
        print_json(
            runner.result()
            | {
                "sources": finds,
                "recording": str(folder / "mission.mcap"),
                "recording_failure": runner.recorder.failure,
                **({"report": str(folder / "report.html")} if report else {}),
            }
        )
    else:
        # First of all what was found: nothing that fails below may keep it from the operator.
        typer.echo(f"ended: {runner.end_reason}")
        sources_table(finds, runner.kernel.detections)
        for robot in runner.safety.robots.values():
            if robot.radio_why:
                say(f"{robot.name}: its radio was down at the end: {robot.radio_why}", always=True)
    if runner.recorder.failure:
        say(f"NOT ALL IS RECORDED: {runner.recorder.failure}. Note down what stands above", always=True)
    interruptible()
    if report:
        _write_report(folder)
    if runner.unconfirmed:
        names = ", ".join(runner.unconfirmed)
        by_hand = "Stop by hand: remote control, or the vehicle's switch"
        say(f"NOT CONFIRMED to hold: {names}. {by_hand}", always=True)
        raise typer.Exit(UNCONFIRMED_EXIT)


def _write_report(folder: Path) -> None:
    """The page on a mission just flown; where it cannot be written, how to try again."""
    if why := _no_report(folder):
        again = f"'fieldkit report {folder}/mission.mcap -o FILE' tries again"
        say(f"no report was written: {why}; {again}", always=True)
    else:
        say(f"written: {folder}/{{mission.mcap, mission.toml, report.html}}")
        say(f"to look again: fieldkit dashboard {folder}/mission.mcap")


def _no_report(folder: Path) -> str:
    """Write the report beside the recording; why there is none."""
    try:
        # Whoever presses Ctrl-C twice may do so while these are loaded.
        from fieldkit.errors import FieldkitError
        from fieldkit.recording.reader import open_recording
        from mission.analysis.report import write_report
        from mission.page.embed import embedded

        try:
            recording = open_recording(folder / "mission.mcap")
            write_report(recording, folder / "report.html", embedded(recording))
        except (OSError, FieldkitError) as error:
            return str(error)
    except KeyboardInterrupt:
        return "interrupted"
    return ""


def preflight(
    mission_file: Annotated[Path, typer.Argument(metavar="MISSION.TOML", help="The mission file.")],
    listen_s: Annotated[float, typer.Option(min=1.0, help="How long the radios listen.")] = 10.0,
    out: Annotated[Path, typer.Option(help="Folder that will get the recordings.")] = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """Check radios, vehicles, clocks, fence and failsafes before the start. Nothing is armed, nothing moves.

    Exit code 0: go; 1: there is a red check. A mission with red checks of its vehicles does not start.

    Example: fieldkit preflight mission.toml
    """
    import asyncio
    from dataclasses import asdict

    from fieldkit.checks import worst
    from mission.core.mission_file import read_mission
    from mission.shell import preflight as before
    from mission.shell import setups
    from mission.shell.terminal import checks_table

    mission = read_mission(mission_file)
    say(f"listening for {listen_s:g} s ...")
    checks = asyncio.run(before.preflight(mission, setups.live(mission), out, listen_s))
    verdict = worst(checks)
    if as_json:
        print_json({"verdict": verdict, "checks": [asdict(check) for check in checks]})
    else:
        checks_table(checks)
    raise typer.Exit(verdict == "red")


def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Recordings (mission.mcap).")],
    antenna: Annotated[Path | None, typer.Option(help="What if: another antenna file.")] = None,
    belief: Annotated[str | None, typer.Option(help="What if: another belief.")] = None,
    planner: Annotated[str | None, typer.Option(help="What if: another planner.")] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="TABLE.KEY=VALUE", help="What if: another value in the mission file; repeat."
        ),
    ] = None,
    whatif: Annotated[
        bool, typer.Option("--what-if", help="Compare nothing; just show what comes out.")
    ] = False,
    until: Annotated[
        float | None, typer.Option(min=0.0, help="Stop after this many seconds of the mission.")
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(min=0.01, help="Watch it at this many times real time; default: as fast as it goes."),
    ] = None,
    page: Annotated[bool, typer.Option("--page", help="With --speed: watch it in the live page.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Re-run the engine on recordings: the same belief and commands, or the first event that differs.

    Exit code 1 if anything differs. --belief, --planner, --set, and --antenna with --what-if feed the recorded inbox to
    another engine instead; robots stay on their recorded paths, and the planner's decisions are compared with the
    mission's. With several recordings each is replayed, and the JSON is a list.

    Example: fieldkit replay runs/20260102T030405Z/mission.mcap

    Example: fieldkit replay mission.mcap --set engine.found_probability=0.95
    """
    from fieldkit.errors import ConfigError, FieldkitError
    from fieldkit.recording.reader import open_recording
    from mission.replay.command import Changes, replay_one
    from mission.replay.pace import Pace, line

    changed = Changes(antenna, belief, planner, tuple(changes or ()), whatif)
    single = len(logs) == 1
    if page and (speed is None or not single):
        raise ConfigError("--page: shows one recording at a --speed; give both")
    results: list[dict[str, Any]] = []
    worst = 0
    for log in logs:
        pace = None if speed is None else Pace(speed, lambda now: say(line(now)))
        try:
            recording = open_recording(log)  # which says what is missing, once
            with _replay_page(recording, changed, page) as followers:
                plain = replay_one(recording, changed, until_s=until, on_step=pace, followers=followers)
        except FieldkitError as error:
            if single:
                raise
            # Exit code 1, "it differs", says more than 2, "it could not be read".
            worst = error.exit_code if worst != 1 else 1
            plain = {"recording": str(log), "identical": False, "error": str(error)}
        results.append(plain)
        if not as_json:
            _print_replayed(log, plain, single=single)
    if as_json:
        print_json(results[0] if single else results)
    if worst:
        raise typer.Exit(worst)


def _print_replayed(log: Path, plain: dict[str, Any], *, single: bool) -> None:
    """What came of replaying one recording; `single`: with its sources."""
    from mission.shell.terminal import sources_table

    if "error" in plain:
        typer.echo(f"{log}: {plain['error']}")
        return
    typer.echo(
        f"{log}: {plain['events']} events, {plain['duration_s']:.0f} s of mission, {plain['times_real_time']:.0f} "
        f"times real time: {plain['verdict']}\n"
        f"belief {plain['belief_hash'][:16]}  commands {plain['commands_hash'][:16]}"
    )
    if single:
        sources_table(plain["sources"])


def report(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A recording (mission.mcap).")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Where to write; default: beside the log.")
    ] = None,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Print it as PDF beside the page too; needs Chromium or WeasyPrint.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write one offline HTML page on a recorded mission: map, what was found and how sure, what was heard when.

    The first page is for the person who decides: what was found, how sure, what to do next. Details come after.

    Example: fieldkit report runs/20260102T030405Z/mission.mcap -o report.html
    """
    from fieldkit.console import progress
    from fieldkit.recording.reader import open_recording
    from mission.analysis.report import write_report
    from mission.page.embed import embedded

    target = out or (log / "report.html" if log.is_dir() else log.with_name("report.html"))
    written = [target]
    with progress("writing the report"):
        recording = open_recording(log)
        summary = write_report(recording, target, embedded(recording))
        if pdf:
            from mission.analysis.pdf import write_pdf

            written.append(target.with_suffix(".pdf"))
            write_pdf(target, written[-1])
    if as_json:
        print_json(summary | {"report": str(target)} | ({"pdf": str(written[-1])} if pdf else {}))
    else:
        for each in written:
            typer.echo(f"written: {each}")


def new(
    path: Annotated[
        Path, typer.Argument(metavar="MISSION.TOML", help="The file to write; never overwritten.")
    ],
) -> None:
    """Write a commented mission.toml to start from.

    Example: fieldkit new mission.toml
    """
    from fieldkit.errors import ConfigError
    from fieldkit.files import write_whole
    from mission.core.template import mission_text

    if path.exists():
        raise ConfigError(f"{path}: exists already; choose another name")
    write_whole(path, mission_text(name=path.stem))
    typer.echo(
        f"written: {path}; set the field, the ports and the antenna file in it, then: fieldkit check {path}"
    )


def check(
    mission_file: Annotated[Path, typer.Argument(metavar="MISSION.TOML", help="The mission file.")],
    as_json: JsonOption = False,
) -> None:
    """Say what is wrong with a mission file before anything moves.

    Nothing is opened: for radios and vehicles that answer, plug in and 'fieldkit run'.

    Example: fieldkit check mission.toml
    """
    from mission.core.advice import advise
    from mission.core.mission_file import read_mission
    from mission.maps.background import read_background
    from mission.shell import setups

    mission = read_mission(mission_file)
    setups.live(mission)  # drivers check their own options when they are made
    advice = advise(mission)
    background = read_background(mission)
    if background is not None and background.covered < 0.99:
        advice.append(f"field.background shows {background.covered:.0%} of the field")
    if as_json:
        print_json({"mission": str(mission_file), "ok": True, "advice": advice})
        return
    engine = mission.kernel.engine
    teams = "1 team" if len(engine.teams) == 1 else f"{len(engine.teams)} teams"
    robots = "1 robot" if len(engine.robots) == 1 else f"{len(engine.robots)} robots"
    typer.echo(
        f"{mission_file}: good. {robots} in {teams}, {engine.grid.n_east} x "
        f"{engine.grid.n_north} cells, belief {mission.kernel.belief}, planner {mission.kernel.planner}"
    )
    for line in advice:
        typer.echo(f"note: {line}")


@contextmanager
def _replay_page(
    recording: "Recording", changes: "Changes", wanted: bool
) -> "Iterator[tuple[Follower, ...]]":
    """The page a replay is watched in; nobody follows where it is not wanted."""
    if not wanted:
        yield ()
        return
    from mission.page import serve
    from mission.replay.command import changed_mission

    with serve.live(changed_mission(recording, changes)) as shown:
        say(f"to look, open  {shown.page.address}", always=True)
        yield (shown.follower,)
