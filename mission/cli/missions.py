"""`fieldkit demo | run | replay | report | new | check`. Heavy imports stay inside the commands."""

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from mission.core.mission_file import Mission
    from mission.page.serve import LivePage
    from mission.replay.command import Changes
    from mission.shell.recorder import Follower

PageOption = Annotated[bool, typer.Option("--page/--no-page", help="Serve the live page.")]
HostOption = Annotated[
    str, typer.Option(help="Address the page is served on; 0.0.0.0 for phones in the same network.")
]
PortOption = Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result alone, as JSON, on standard output.")
]

UNCONFIRMED_EXIT = 4
"""Exit code of a mission whose vehicles have not all shown that they hold."""


def _say(text: str) -> None:
    typer.echo(text, err=True)


def _print_json(value: Any) -> None:
    typer.echo(json.dumps(value, indent=2, allow_nan=False, default=str))


def demo(
    seed: Annotated[int, typer.Option(help="Where the transmitters hide, and all other chance.")] = 7,
    out: Annotated[Path, typer.Option(help="Folder that gets a new folder for this run.")] = Path("runs"),
    rate: Annotated[float, typer.Option(min=0.1, max=20.0, help="Mission seconds per wall second.")] = 10.0,
    page: PageOption = False,
    page_host: HostOption = "127.0.0.1",
    page_port: PortOption = 8321,
    as_json: JsonOption = False,
) -> None:
    """Run one whole mission on emulated radios and rovers, through the real drivers.

    Four robots in two pairs look for three hidden transmitters in a field of 10 m x 10 m.

    Example: fieldkit demo --seed 7
    """
    from mission.analysis.report import write_report
    from mission.lab import demo as demonstration
    from mission.shell.terminal import Watch, result_table

    folder = _run_folder(out)
    _say(
        f"calibrating the radios from {demonstration.example_readings().name}, then searching; files go to {folder}"
    )
    prepared = demonstration.prepare(folder, seed)
    with (
        _page(prepared[0], page, page_host, page_port) as shown,
        Watch(quiet=as_json and not sys.stderr.isatty()) as watch,
    ):
        result = demonstration.run(
            folder, seed, rate=rate, on_progress=watch.show, page=shown, prepared=prepared
        )
    write_report(folder / "mission.mcap", folder / "report.html")
    plain = result.plain(seed)
    if as_json:
        _print_json(plain | {"report": str(folder / "report.html")})
        return
    result_table(plain)
    typer.echo(f"\nwritten: {folder}/{{mission.mcap, mission.toml, antenna.toml, report.html}}")
    typer.echo(f"next:    fieldkit replay {folder}/mission.mcap")


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
    page_host: HostOption = "127.0.0.1",
    page_port: PortOption = 8321,
    as_json: JsonOption = False,
) -> None:
    """Run a mission on your own radios and vehicles, with a live page in the browser.

    Enter holds all vehicles, Ctrl-C holds them and closes the recording. Exit code 4: a vehicle has not shown that it
    holds.

    --resume goes on after a crash or power cut: the same belief, the vehicles adopted, nothing re-armed unasked.

    Example: fieldkit run mission.toml
    """
    from fieldkit.errors import ConfigError, FieldkitError
    from fieldkit.files import write_whole
    from fieldkit.recording.reader import open_recording
    from mission.analysis.report import write_report
    from mission.core.mission_file import read_mission
    from mission.replay.command import plain_source
    from mission.replay.replay import resumable
    from mission.shell import setups
    from mission.shell.flight import fly
    from mission.shell.terminal import Watch, sources_table
    from mission.shell.warm_up import warm_up

    past = None if resume is None else open_recording(resume)
    if (past is None) == (mission_file is None):
        raise ConfigError("expected either a mission file or --resume with a recording, which holds its own")
    if past is not None:
        mission = resumable(past)
    elif mission_file is not None:
        mission = read_mission(mission_file)
    setup = setups.live(mission)
    warm_up(mission)
    folder = _run_folder(out)
    write_whole(folder / "mission.toml", mission.text)
    write_whole(folder / mission.file.antenna.file.rsplit("/", 1)[-1], mission.antenna_text)
    _say(f"recording to {folder}/mission.mcap")
    with (
        _page(mission, page, page_host, page_port) as shown,
        Watch(quiet=as_json and not sys.stderr.isatty()) as watch,
    ):
        runner = fly(
            mission, setup, folder / "mission.mcap", watch.show, page=shown, override=override, past=past
        )
    finds = [plain_source(source) for source in runner.kernel.sources()]
    if as_json:
        _print_json(
            runner.result()
            | {
                "sources": finds,
                "recording": str(folder / "mission.mcap"),
                "recording_failure": runner.recorder.failure,
                "report": str(folder / "report.html"),
            }
        )
    else:
        # First of all what was found: nothing that fails below may keep it from the operator.
        typer.echo(f"ended: {runner.end_reason}")
        sources_table(finds)
    if runner.recorder.failure:
        _say(f"NOT ALL IS RECORDED: {runner.recorder.failure}. Note down what stands above")
    try:
        write_report(folder / "mission.mcap", folder / "report.html")
    except (OSError, FieldkitError) as error:
        _say(f"no report was written: {error}; 'fieldkit report {folder}/mission.mcap -o FILE' tries again")
    else:
        _say(f"written: {folder}/{{mission.mcap, mission.toml, report.html}}")
    if runner.unconfirmed:
        names = ", ".join(runner.unconfirmed)
        _say(f"NOT CONFIRMED to hold: {names}. Stop by hand: remote control, or the vehicle's switch")
        raise typer.Exit(UNCONFIRMED_EXIT)


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
    _say(f"listening for {listen_s:g} s ...")
    checks = asyncio.run(before.preflight(mission, setups.live(mission), out, listen_s))
    verdict = worst(checks)
    if as_json:
        _print_json({"verdict": verdict, "checks": [asdict(check) for check in checks]})
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
    from mission.replay.command import Changes, replay_one
    from mission.replay.pace import Pace, line
    from mission.shell.terminal import sources_table

    changed = Changes(antenna, belief, planner, tuple(changes or ()), whatif)
    if page and (speed is None or len(logs) != 1):
        raise ConfigError("--page: shows one recording at a --speed; give both")
    results: list[dict[str, Any]] = []
    worst = 0
    for log in logs:
        pace = None if speed is None else Pace(speed, lambda now: _say(line(now)))
        try:
            with _replay_page(log, changed, page) as followers:
                plain = replay_one(log, changed, until_s=until, on_step=pace, followers=followers)
        except FieldkitError as error:
            if len(logs) == 1:
                raise
            # Exit code 1, "it differs", says more than 2, "it could not be read".
            worst = error.exit_code if worst != 1 else 1
            plain = {"recording": str(log), "identical": False, "error": str(error)}
        results.append(plain)
        if as_json:
            continue
        if "error" in plain:
            typer.echo(f"{log}: {plain['error']}")
            continue
        if plain["missing"]:
            _say(f"note: {log} is not whole: {plain['missing']}")
        typer.echo(
            f"{log}: {plain['events']} events, {plain['duration_s']:.0f} s of mission, {plain['times_real_time']:.0f} "
            f"times real time: {plain['verdict']}\n"
            f"belief {plain['belief_hash'][:16]}  commands {plain['commands_hash'][:16]}"
        )
        if len(logs) == 1:
            sources_table(plain["sources"])
    if as_json:
        _print_json(results[0] if len(logs) == 1 else results)
    if worst:
        raise typer.Exit(worst)


def report(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A recording (mission.mcap).")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Where to write; default: beside the log.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write one offline HTML page on a recorded mission: map, what was found and how sure, what was heard when.

    Example: fieldkit report runs/20260102T030405Z/mission.mcap -o report.html
    """
    from mission.analysis.report import write_report

    target = out or log.with_name("report.html")
    summary = write_report(log, target)
    if as_json:
        _print_json(summary | {"report": str(target)})
    else:
        typer.echo(f"written: {target}")


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
    from mission.shell import setups

    mission = read_mission(mission_file)
    setups.live(mission)  # drivers check their own options when they are made
    advice = advise(mission)
    if as_json:
        _print_json({"mission": str(mission_file), "ok": True, "advice": advice})
        return
    engine = mission.kernel.engine
    typer.echo(
        f"{mission_file}: good. {len(engine.robots)} robots in {len(engine.teams)} teams, {engine.grid.n_east} x "
        f"{engine.grid.n_north} cells, belief {mission.kernel.belief}, planner {mission.kernel.planner}"
    )
    for line in advice:
        typer.echo(f"note: {line}")


def bench(
    name: Annotated[str, typer.Argument(help="Which benchmark, or all.")] = "all",
) -> None:
    """Measure the figures the documentation quotes, as JSON.

    Example: fieldkit bench spog
    """
    from fieldkit import plugins

    wanted = (
        [n for n in plugins.names("fieldkit.benchmarks") if not n.endswith("-long")]
        if name == "all"
        else [name]
    )
    results = {}
    for each in wanted:
        _say(f"measuring {each} ...")
        results[each] = plugins.load("fieldkit.benchmarks", each)()
    _print_json(results)


def study(
    name: Annotated[str, typer.Argument(help="Which study: trust, calibration, ...")],
    trials: Annotated[int, typer.Option(min=1, help="Trials of each scenario.")] = 100,
    seed: Annotated[int, typer.Option(help="Of the first trial; the others count up.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="Folder for results and plot; a killed study goes on where it was.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; all cores if not given.")] = None,
    dask: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on the Dask cluster of this scheduler.")
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder of data sets, for a study of real readings (reality).")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run many simulated trials and measure: time, false finds, coverage.

    Example: fieldkit study prwa-fig5a --trials 20 --out studies/fig5a
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    from fieldkit import plugins
    from mission.lab.study.options import supported
    from mission.lab.study.results import BULKY, save
    from mission.shell.terminal import study_table

    run_study = plugins.load("fieldkit.studies", name)
    how = supported(
        run_study,
        name,
        workers=workers,
        dask=dask,
        data=data,
        kept=None if out is None else out / "trials.jsonl",
    )
    columns = (TextColumn("{task.description}"), BarColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("starting", total=1.0)
        result = run_study(
            trials, seed, lambda share, text: bar.update(task, completed=share, description=text), **how
        )
    if out is not None:
        save(result, out)
    if as_json:
        _print_json({key: value for key, value in result.items() if key not in BULKY})
        return
    study_table(result)


def dashboard(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A recording (mission.mcap).")],
    page_host: HostOption = "127.0.0.1",
    page_port: PortOption = 8322,
) -> None:
    """Show a recording on the page that the live mission had, with a time to go to and a speed to play at.

    Example: fieldkit dashboard runs/20260102T030405Z/mission.mcap
    """
    from fieldkit.clock import wall_sleep
    from fieldkit.recording.reader import open_recording
    from mission.page import serve

    _say(f"reading {log} ...")
    with serve.past(open_recording(log), host=page_host, port=page_port) as page:
        _say(f"open {page.address}   (Ctrl-C ends it)")
        while True:
            wall_sleep(0.5)


@contextmanager
def _replay_page(log: Path, changes: "Changes", wanted: bool) -> "Iterator[tuple[Follower, ...]]":
    """The page a replay is watched in; nobody follows where it is not wanted."""
    if not wanted:
        yield ()
        return
    from fieldkit.recording.reader import open_recording
    from mission.page import serve
    from mission.replay.command import changed_mission

    with serve.live(changed_mission(open_recording(log), changes)) as shown:
        _say(f"to look, open  {shown.page.address}")
        yield (shown.follower,)


@contextmanager
def _page(mission: "Mission", wanted: bool, host: str, port: int) -> "Iterator[LivePage | None]":
    """The live page, and where to find it, on standard error."""
    if not wanted:
        yield None
        return
    from mission.page import serve
    from mission.shell.keyboard import HELP

    with serve.live(mission, host=host, port=port) as shown:
        _say(f"to look and command, open  {shown.page.command_address}")
        _say(f"only to look:              {shown.page.address}")
        if sys.stdin is not None and sys.stdin.isatty():
            _say(HELP)
        yield shown


def _run_folder(out: Path) -> Path:
    """A folder of its own for this run, named by the time (UTC)."""
    from fieldkit.clock import utc_stamp

    stamp = utc_stamp()
    for suffix in ("", *(f"-{n}" for n in range(2, 1000))):
        folder = out / f"{stamp}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            from fieldkit.errors import ConfigError

            raise ConfigError(f"{out}: cannot make a folder there: {error.strerror}") from error
        return folder
    raise AssertionError("a thousand runs within one second")
