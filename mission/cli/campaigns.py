"""`fieldkit compare`, `analyze` and `refit`: many recordings at once. Heavy imports stay inside the commands."""

import json
import os
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

from fieldkit import settings as given
from fieldkit.console import show_table

_JSON = Annotated[bool, typer.Option("--json", help="Print the result alone, as JSON, on standard output.")]


def compare(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Recordings (mission.mcap).")],
    by: Annotated[
        str, typer.Option(help="What to group by: planner, belief, name, robots or seed.")
    ] = given.COMPARED_BY,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write a page (HTML) with the table and plots.")
    ] = None,
    pdf: Annotated[
        Path | None, typer.Option(help="Print that page as PDF; needs Chromium or WeasyPrint.")
    ] = None,
    as_json: _JSON = False,
) -> None:
    """Compare missions: time to find all, distance from the truth where it is known, in one table and plots.

    Example: fieldkit compare runs/*/mission.mcap -o compare.html
    """
    from fieldkit.console import progress
    from fieldkit.errors import ConfigError
    from mission.analysis.compare import GROUPS
    from mission.analysis.compare import compare as compare_them
    from mission.analysis.pdf import write_pdf

    if by not in GROUPS:
        raise ConfigError(f"--by: expected one of {', '.join(GROUPS)}, got '{by}'")
    with tempfile.TemporaryDirectory(prefix="fieldkit-") as made, progress("comparing"):
        page = out or (Path(made) / "compare.html" if pdf else None)
        said = compare_them(logs, page, by)
        if pdf is not None and page is not None:
            write_pdf(page, pdf)
    if as_json:
        typer.echo(json.dumps(said | {"page": None if out is None else str(out)}, indent=2))
        return
    show_table([_of_group(by, group) for group in said["groups"]])
    names = _short([row["recording"] for row in said["missions"]])
    show_table([_of_mission(name, row) for name, row in zip(names, said["missions"], strict=True)])
    if any(group["unfinished"] is None for group in said["groups"]):
        typer.echo(
            "-: the recordings do not say where their sources truly were, as those of a simulation do."
        )
    elif any(group["unfinished"] for group in said["groups"]):
        typer.echo(
            "not all found: missions that ended before every source was found; they have no time to all."
        )
    if out is not None:
        typer.echo(f"written: {out}")
    if pdf is not None:
        typer.echo(f"written: {pdf}")


def analyze(
    folder: Annotated[Path, typer.Argument(help="Folder with recordings anywhere in it.")],
    results: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for the Parquet files; default: FOLDER/analysis."),
    ] = None,
    sql: Annotated[
        str, typer.Option(help="A question over missions, sources, readings, detections; default: a summary.")
    ] = "",
    replay: Annotated[bool, typer.Option("--replay", help="Replay each mission too, and check it.")] = False,
    changes: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="TABLE.KEY=VALUE", help="Replay as a what-if with this changed; repeat."
        ),
    ] = None,
    dask: Annotated[str | None, typer.Option(help="Address of a Dask scheduler to do the work.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes here; default: one a core.")] = None,
    as_json: _JSON = False,
) -> None:
    """Take in hundreds of missions once, as Parquet, and ask questions in SQL.

    What has been taken in is not taken in again, also after an interruption. Exit code 2 where a recording could not
    be read; the others are still there.

    Example: fieldkit analyze runs --sql "select robot, count(*), avg(rss_dbm) from readings group by robot"
    """
    from fieldkit.console import progress
    from fieldkit.extras import need
    from mission.analysis import campaign

    for module in ("pyarrow", "duckdb"):
        need(module, "post")
    to = results or folder / "analysis"
    jobs = campaign.jobs_of(folder, to, replay=replay or bool(changes), keys=tuple(changes or ()))
    with progress("taking in") as report:
        new, refused = campaign.run(
            jobs,
            lambda done, of, text: report(done / max(of, 1), f"taking in: {done} of {of}"),
            workers=workers,
            dask=dask,
        )
    columns, rows = ([], []) if len(refused) == len(jobs) else campaign.ask(to, jobs, sql)
    if as_json:
        answer = [dict(zip(columns, row, strict=True)) for row in rows]
        said = {"recordings": len(jobs), "taken_in_now": new, "refused": refused, "answer": answer}
        typer.echo(json.dumps(said, indent=2, default=str))
    else:
        typer.echo(f"{len(jobs)} recordings, {new - len(refused)} of them taken in now; in {to}")
        if columns:
            show_table([dict(zip(columns, row, strict=True)) for row in rows])
        if columns and not sql:
            typer.echo(
                "not_all_found: missions that ended before every source was found, where the truth is known."
            )
        for each in refused:
            typer.echo(f"not taken in: {each['error']}", err=True)
    if refused:
        raise typer.Exit(2)


def refit(
    logs: Annotated[list[Path], typer.Argument(help="Recordings of one field, of any day and team.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write the sources with their regions as GeoJSON.")
    ] = None,
    antenna: Annotated[
        Path | None,
        typer.Option(help="The antenna file that holds for all; else the one they were made with."),
    ] = None,
    changes: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="TABLE.KEY=VALUE", help="With this changed in every mission; repeat."),
    ] = None,
    work: Annotated[
        Path | None,
        typer.Option(
            help="Folder for finished pieces, which another run takes as they are; default: OUT.work, where --out is."
        ),
    ] = None,
    dask: Annotated[str | None, typer.Option(help="Address of a Dask scheduler to do the work.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes here; default: one a core.")] = None,
    tiles: Annotated[
        str,
        typer.Option(
            metavar="EASTxNORTH", help="Tiles the ground is parted in; default: as is the least work."
        ),
    ] = "",
    as_json: _JSON = False,
) -> None:
    """Find the sources of a whole campaign: everything heard in many missions, on all days, by one belief.

    A source that no mission heard often enough by itself may be found by all of them together. What has been done is
    not done again, also after an interruption. Exit code 2 where a recording could not be read; the others are in.

    Example: fieldkit refit runs/*/mission.mcap -o campaign.geojson
    """
    from fieldkit.console import progress
    from fieldkit.files import is_stream, write_whole
    from mission.analysis import refit as campaign
    from mission.maps.geojson import collection
    from mission.replay.command import Changes

    beside = (
        out.with_name(out.name + ".work") if out is not None and out.name and not is_stream(out) else None
    )
    by = campaign.Work(work or beside, workers, dask, _tiles(tiles))
    what_if = Changes(antenna=antenna, keys=tuple(changes or ()), what_if=True)
    with progress("taking in") as report:
        done = campaign.refit(logs, what_if, report, by)
    plain = campaign.plain(done)
    if out is not None:
        write_whole(out, json.dumps(collection(done.present()), indent=1))
    _say(plain, out, as_json)
    if plain["refused"]:
        raise typer.Exit(2)


def _say(plain: dict[str, Any], out: Path | None, as_json: bool) -> None:
    """What `fieldkit refit` found, as JSON or in words."""
    from mission.shell.terminal import sources_table

    if as_json:
        typer.echo(json.dumps(plain | {"written": None if out is None else str(out)}, indent=2))
        return
    typer.echo(
        f"{_count(plain['recordings'], 'recording')} in {_count(plain['sessions'], 'session')}, "
        f"{_count(plain['detections'], 'transmission')}; "
        f"metres from {plain['origin_lat_deg']:.7f}, {plain['origin_lon_deg']:.7f}"
    )
    if plain["tiles"] > 1:
        unheard = plain["tiles_nobody_was_near"]
        alone = f"; nobody came near {unheard} of them" if unheard else ""
        typer.echo(f"the ground was parted in {plain['tiles']} tiles{alone}")
    sources_table(plain["sources"], plain["detections"])
    typer.echo(f"the probability that one is left is {plain['probability_left']:.2f}")
    if out is not None:
        typer.echo(f"written: {out}")
    for each in (*plain["refused"], *plain["missing"]):
        typer.echo(f"not all taken in: {each}", err=True)


def _tiles(text: str) -> tuple[int, int] | None:
    """`3x2` as two numbers. Raises `ConfigError`."""
    from fieldkit.errors import ConfigError

    if not text:
        return None
    east, x, north = text.partition("x")
    if not (x and east.isdecimal() and north.isdecimal() and 0 < int(east) * int(north) <= given.MOST_TILES):
        raise ConfigError(
            f"--tiles: expected two numbers as 3x2, at most {given.MOST_TILES} tiles in all, got '{text}'"
        )
    return int(east), int(north)


def _count(number: int, of: str) -> str:
    return f"{number} {of}{'s' * (number != 1)}"


def _of_group(by: str, group: dict[str, Any]) -> dict[str, Any]:
    """A group's line; times are of the missions that found all."""
    return {
        by: group[by],
        "missions": group["missions"],
        "not all\nfound": group["unfinished"],
        "time to all,\ns (worst)": _with_worst(group["median_time_s"], group["worst_time_s"], ".0f"),
        "error,\nm (worst)": _with_worst(group["median_error_m"], group["worst_error_m"], ".2f"),
        "false": group["false_finds"],
    }


def _of_mission(name: str, row: dict[str, Any]) -> dict[str, Any]:
    """A mission's line."""
    of = "" if row["true_sources"] is None else f" of {row['true_sources']}"
    return {
        "recording": name,
        "planner": row["planner"],
        "lasted,\ns": f"{row['duration_s']:.0f}",
        "found": f"{row['found']}{of}",
        "false": row["false_finds"],
        "all\nafter, s": None if row["localised_all_s"] is None else f"{row['localised_all_s']:.0f}",
        "error,\nm (worst)": _with_worst(row["mean_error_m"], row["worst_error_m"], ".2f"),
    }


def _with_worst(usual: float | None, worst: float | None, form: str) -> str | None:
    return None if usual is None or worst is None else f"{usual:{form}} ({worst:{form}})"


def _short(recordings: list[str]) -> list[str]:
    """What tells recordings apart: without the folders that all are in, and without the name that most have."""
    paths = [Path(each).absolute() for each in recordings]
    shared = Path(os.path.commonpath([path.parent.parent for path in paths]))
    names = [path.relative_to(shared) for path in paths]
    return [str(name.parent if name.name == "mission.mcap" else name) for name in names]
