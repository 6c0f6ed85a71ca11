"""`fieldkit demo | bench | study`: the laboratory's commands. Heavy imports stay inside them."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from fieldkit import settings as given
from fieldkit.errors import ConfigError
from mission.cli.options import (
    HostOption,
    JsonOption,
    PageOption,
    PortOption,
    may_be_shown,
    print_json,
    run_folder,
    say,
    shown_page,
    stay_open,
)


def demo(
    seed: Annotated[int, typer.Option(min=0, help="Where the transmitters hide, and all other chance.")] = 7,
    walk: Annotated[
        str,
        typer.Option(
            metavar="KIND",
            help="A person walks instead: xbee, ble, wifi, lora, meshtastic, wildlife, json or yagi.",
        ),
    ] = "",
    drone: Annotated[bool, typer.Option("--drone", help="One drone with a sniffer dongle instead.")] = False,
    out: Annotated[Path, typer.Option(help="Folder that gets a new folder for this run.")] = Path("runs"),
    rate: Annotated[
        float,
        typer.Option(min=0.1, max=20.0, help="Mission seconds per wall second; a walk takes twice as many."),
    ] = 10.0,
    page: PageOption = False,
    page_host: HostOption = given.PAGE_HOST,
    page_port: PortOption = given.PAGE_PORT,
    as_json: JsonOption = False,
) -> None:
    """Run one whole mission on emulated radios and rovers, through the real drivers.

    Four robots in two pairs look for three hidden transmitters in a field of 10 m x 10 m.

    Example: fieldkit demo --seed 7
    """
    if walk and drone:
        raise ConfigError("--walk and --drone are two demos; give one of them")
    may_be_shown(page, page_host, page_port)
    if walk or drone:
        _small_demo("" if drone else walk, seed, out, rate, (page, page_host, page_port), as_json)
        return
    from fieldkit.recording.reader import open_recording
    from mission.analysis.report import write_report
    from mission.lab import demo as demonstration
    from mission.page.embed import embedded
    from mission.shell.terminal import Watch, result_table

    folder = run_folder(out)
    say(
        f"calibrating the radios from {demonstration.example_readings().name}, then searching; files go to {folder}"
    )
    prepared = demonstration.prepare(folder, seed)
    with shown_page(prepared[0], page, page_host, page_port) as shown:
        with Watch(quiet=as_json and not sys.stderr.isatty()) as watch:
            result = demonstration.run(
                folder, seed, rate=rate, on_progress=watch.show, page=shown, prepared=prepared
            )
        recorded = folder / "mission.mcap"
        recording = open_recording(recorded)
        write_report(recording, folder / "report.html", embedded(recording))
        plain = result.plain(seed)
        if as_json:
            print_json(plain | {"report": str(folder / "report.html")})
            return
        result_table(plain)
        typer.echo(f"\nwritten: {folder}/{{mission.mcap, mission.toml, antenna.toml, report.html}}")
        typer.echo(f"next:    fieldkit replay {recorded}")
        stay_open(shown, result.runner)


def _small_demo(
    kind: str, seed: int, out: Path, rate: float, shown: tuple[bool, str, int], as_json: bool
) -> None:
    """One person, or without a kind one drone; one radio, one hidden transmitter."""
    from mission.cli.missions import print_flown
    from mission.lab.drone_demo import demo_drone
    from mission.lab.walk_demo import demo_walk
    from mission.shell.flight import fly
    from mission.shell.terminal import Watch
    from mission.shell.warm_up import warm_up

    folder = run_folder(out)
    made = demo_walk(folder, kind, seed, 2.0 * rate, say) if kind else demo_drone(folder, seed, rate)
    with made as (mission, setup, truth):
        say("preparing the engine (compiled once on a new machine, up to a minute) ...")
        warm_up(mission)
        with shown_page(mission, *shown) as page:
            with Watch(quiet=as_json and not sys.stderr.isatty()) as watch:
                runner = fly(
                    mission,
                    setup,
                    folder / "mission.mcap",
                    watch.show,
                    truth=truth,
                    extra={"demo": True},
                    page=page,
                )
            print_flown(runner, folder, as_json=as_json)
            if as_json:
                return
            places = ", ".join(f"{s.east_m:.1f} m east, {s.north_m:.1f} m north" for s in truth)
            typer.echo(f"it was hidden at {places}")
            stay_open(page, runner)


def bench(
    name: Annotated[str, typer.Argument(help="Which benchmark, or all.")] = "all",
    out: Annotated[
        Path | None, typer.Option(help="Folder for result.json, and for a plot where there is one.")
    ] = None,
) -> None:
    """Measure the figures the documentation quotes, as JSON.

    Example: fieldkit bench spog
    """
    from fieldkit import plugins
    from mission.lab.study.results import save_bench

    wanted = (
        [n for n in plugins.names("fieldkit.benchmarks") if not n.endswith("-long")]
        if name == "all"
        else [name]
    )
    results = {}
    for each in wanted:
        say(f"measuring {each} ...")
        results[each] = plugins.load("fieldkit.benchmarks", each)()
    if out is not None:
        save_bench(results, out)
    print_json(results)


def study(
    name: Annotated[str, typer.Argument(help="Which study: trust, calibration, ...")],
    trials: Annotated[
        int, typer.Option("--trials", "--missions", min=1, help="Trials (missions) of each scenario.")
    ] = 100,
    only: Annotated[
        str | None, typer.Option(metavar="WORDS", help="Only the scenarios whose name has these words.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the first trial; the others count up.")] = 0,
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
    from fieldkit import plugins
    from fieldkit.console import progress
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
        only=only,
        kept=None if out is None else out / "trials.jsonl",
    )
    with progress("starting") as report:
        result = run_study(trials, seed, report, **how)
    if out is not None:
        save(result, out)
    if as_json:
        print_json({key: value for key, value in result.items() if key not in BULKY})
        return
    study_table(result)
