"""`fieldkit collect`: what the agents of a team recorded, as one recording. Heavy imports stay inside the command."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from mission.cli.options import JsonOption, print_json


def collect(
    out: Annotated[
        Path, typer.Argument(help="The recording to write; must not exist. A folder: its mission.mcap.")
    ],
    places: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOGS_OR_FOLDERS", help="Folders of agents' runs, or with such folders in them."
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Lay the recordings of a team's agents together to the one that a single computer would have made.

    Report, replay and analyze read it as any mission's. What several agents know is taken in once. Exit code 2 where
    something could not be taken in; the rest is.

    Example: fieldkit collect collected.mcap r1/runs r2/runs r3/runs
    """
    from fieldkit.console import progress
    from mission.replay.collect import collect as lay_together

    file = out / "mission.mcap" if out.is_dir() or not out.suffix else out
    with progress("collecting") as report:
        done = lay_together(file, places, report)
    if as_json:
        print_json(asdict(done))
    else:
        typer.echo(
            f"{done.mission}: {done.observations} observations of {len(done.robots)} robots, among them "
            f"{done.orders} operator's orders\nfrom {len(done.journals)} journals; what several know is taken in once"
        )
        for robot, known in done.robots.items():
            own = "" if known["own_journal"] else ", by others' journals alone"
            typer.echo(f"  {robot}: {known['observations']}{own}")
        if done.compared:
            typer.echo(
                f"{done.agreeing} of {done.compared} ended with the belief that these observations give"
            )
        for note in done.notes:
            typer.echo(f"note: {note}", err=True)
        for each in done.refused:
            typer.echo(f"not taken in: {each}", err=True)
        typer.echo(f"written: {file}; 'fieldkit report {file}' makes a page of it")
    if done.refused:
        raise typer.Exit(2)
