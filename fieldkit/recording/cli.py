"""`fieldkit log`: look into a recording, and mend one."""

import json
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="Look into recordings and mend damaged ones.", no_args_is_help=True, rich_markup_mode=None
)

_LOG = Annotated[Path, typer.Argument(help="The recording: a mission.mcap.", show_default=False)]
_JSON = Annotated[bool, typer.Option("--json", help="Print the result alone, as JSON.")]


@app.command()
def info(log: _LOG, as_json: _JSON = False) -> None:
    """Say what a recording holds, and whether anything is missing.

    Example: fieldkit log info runs/20260102T030405Z/mission.mcap
    """
    from fieldkit.recording.reader import open_recording

    said = open_recording(log).summary()
    if as_json:
        typer.echo(json.dumps(said))
        return
    state = "complete" if said["complete"] else f"NOT complete: {said['missing']}"
    typer.echo(
        f"{log}: {said['duration_s']:.1f} s, {said['bytes']} bytes, fieldkit {said['fieldkit']}, {state}"
    )
    for topic, count in said["counts"].items():
        typer.echo(f"  {count:9d}  {topic}")


@app.command()
def recover(
    log: _LOG,
    out: Annotated[Path, typer.Option("--out", "-o", help="The whole file to write; must not exist.")],
    as_json: _JSON = False,
) -> None:
    """Write everything intact in a cut or damaged recording to a new, verified one.

    Example: fieldkit log recover mission.mcap -o mission-recovered.mcap
    """
    from fieldkit.recording.reader import open_recording
    from fieldkit.recording.salvage import recover as write_whole_one

    problems = write_whole_one(log, out)
    counts = open_recording(out).summary()["counts"]
    if as_json:
        typer.echo(json.dumps({"recording": str(out), "missing": problems, "counts": counts}))
        return
    typer.echo(f"{out}: {sum(counts.values())} messages, whole and verified")
    for problem in problems:
        typer.echo(f"  missing: {problem}")
