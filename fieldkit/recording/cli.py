"""`fieldkit log`: look into recordings, mend, merge, redact and export them. Heavy imports stay inside the commands."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    help="Look into recordings; export, merge, redact and mend them.",
    no_args_is_help=True,
    rich_markup_mode=None,
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


@app.command(name="list")
def list_logs(
    paths: Annotated[
        list[Path] | None, typer.Argument(help="Recordings, or folders with recordings anywhere in them.")
    ] = None,
    as_json: _JSON = False,
) -> None:
    """List recordings, one a line: how long, how many readings, how it ended, whether anything is missing.

    Files that are no recordings are named at the end; the exit code is then 2.

    Example: fieldkit log list runs
    """
    from fieldkit.errors import DataError, RecordingError
    from fieldkit.recording.reader import is_later_part, open_recording

    given = paths or [Path("runs")]
    for path in given:
        if not path.exists():
            raise DataError(f"{path}: no such file or folder")
    files = [
        file
        for path in given
        for file in (sorted(path.rglob("*.mcap")) if path.is_dir() else [path])
        if path == file or not is_later_part(file)
    ]
    rows: list[dict[str, Any]] = []
    refused: list[str] = []
    for file in files:
        try:
            said = open_recording(file).summary()
        except RecordingError as error:
            refused.append(str(error))
            continue
        rows.append(
            {key: said[key] for key in ("recording", "duration_s", "bytes", "complete", "missing", "counts")}
        )
    if as_json:
        typer.echo(json.dumps({"recordings": rows, "refused": refused}))
    else:
        if not rows and not refused:
            typer.echo(f"no recordings in {', '.join(map(str, given))}")
        for row in rows:
            counts = row["counts"]
            state = "complete" if row["complete"] else f"NOT complete: {row['missing']}"
            typer.echo(
                f"{row['recording']}: {row['duration_s']:7.1f} s {row['bytes'] / 1e6:7.1f} MB "
                f"{counts.get('/in/reading', 0):6d} readings  {state}"
            )
        for text in refused:
            typer.echo(text, err=True)
    if refused:
        raise typer.Exit(2)


@app.command()
def export(
    log: _LOG,
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            help="A file ending in .csv .parquet .geojson .kml .gpx .zip (for TAK), or a folder.",
        ),
    ],
    what: Annotated[
        str,
        typer.Option(
            help="Tables, with commas between: readings, poses, detections, sources, belief, vehicles, receivers, "
            "commands, plans, notes. Default: all but the belief; on maps poses and sources."
        ),
    ] = "",
    form: Annotated[str, typer.Option("--format", help="For a folder: csv or parquet.")] = "",
    from_s: Annotated[
        float | None, typer.Option("--from", help="From this second of the mission on.")
    ] = None,
    to_s: Annotated[float | None, typer.Option("--to", help="Up to this second of the mission.")] = None,
    as_json: _JSON = False,
) -> None:
    """Write readings, poses, detections, sources or the belief as files other programs read.

    Example: fieldkit log export mission.mcap --what readings -o readings.csv
    """
    from fieldkit.console import progress
    from fieldkit.recording.export import export as write_files
    from fieldkit.recording.log import open_log

    names = tuple(name.strip() for name in what.split(",") if name.strip())
    with progress("exporting"):
        written = write_files(open_log(log), out, names, form=form, from_s=from_s, to_s=to_s)
    if as_json:
        typer.echo(json.dumps({"recording": str(log), "written": [str(path) for path in written]}))
        return
    for path in written:
        typer.echo(f"written: {path}")


@app.command()
def merge(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            help="Recordings of robots that logged apart, and position logs (.tlog .bin .gpx .csv)."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="The recording to write; must not exist.")],
    offset: Annotated[
        list[str] | None,
        typer.Option(
            help="NAME=SECONDS to add to one input's times; default: estimated from shared receptions."
        ),
    ] = None,
    as_json: _JSON = False,
) -> None:
    """Merge recordings of robots that logged apart into one, on the first one's clock.

    Example: fieldkit log merge r1.mcap r2.mcap r2-flight.tlog -o all.mcap
    """
    from fieldkit.errors import ConfigError
    from fieldkit.recording.merge import merge as merge_them

    given: dict[str, float] = {}
    for text in offset or []:
        name, _, seconds = text.rpartition("=")
        try:
            given[name] = float(seconds)
        except ValueError:
            raise ConfigError(f"--offset: expected NAME=SECONDS, got '{text}'") from None
        if not any(name in (str(path), path.name, path.stem) for path in inputs):
            raise ConfigError(f"--offset: none of the inputs is called '{name}'")
    done = merge_them(inputs, out, given_s=given)
    offsets = {
        name: {"seconds": round(o.seconds, 6), "sigma_s": round(o.sigma_s, 6), "shared": o.shared, "by": o.by}
        for name, o in done.offsets.items()
    }
    if as_json:
        said = {"recording": str(out), "offsets": offsets, "events": done.events, "robots": done.robots}
        typer.echo(json.dumps(said | {"missing": done.missing}))
        return
    typer.echo(f"{out}: {done.events} events of {', '.join(done.robots)}")
    for name, o in offsets.items():
        basis = (
            "as given"
            if o["by"] == "given"
            else f"± {o['sigma_s']:.3f} s, {o['shared']} shared, by {o['by']}"
        )
        typer.echo(f"  {name}: {o['seconds']:+.3f} s ({basis})")
    for text in done.missing:
        typer.echo(f"  missing: {text}")


@app.command()
def redact(
    log: _LOG,
    out: Annotated[Path, typer.Option("--out", "-o", help="The recording to write; must not exist.")],
    keep_place: Annotated[bool, typer.Option(help="Keep the field's place on Earth.")] = False,
    as_json: _JSON = False,
) -> None:
    """Write a recording that may be shown to others; it replays to the same belief and commands.

    Left out or changed: raw bytes, radio addresses, ports, device texts, the field's latitude and longitude.

    Example: fieldkit log redact mission.mcap -o to-share.mcap
    """
    from fieldkit.recording.redact import redact as write_redacted

    count = write_redacted(log, out, keep_place=keep_place)
    if as_json:
        typer.echo(json.dumps({"recording": str(out), **count}))
        return
    typer.echo(
        f"{out}: " + ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in count.items()) + " redacted"
    )


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


@app.command()
def layout(
    out: Annotated[Path, typer.Option("--out", "-o", help="Where to write it.")] = Path(
        "fieldkit-layout.json"
    ),
) -> None:
    """Write the Lichtblick layout: map, belief, tracks, sources, levels. Open a recording, import it, done.

    Example: fieldkit log layout -o fieldkit-layout.json
    """
    from importlib import resources

    from fieldkit.files import write_whole

    write_whole(
        out, (resources.files("fieldkit.recording") / "lichtblick-layout.json").read_text(encoding="utf-8")
    )
    typer.echo(f"written: {out}; in Lichtblick: Layouts, Import from file")
