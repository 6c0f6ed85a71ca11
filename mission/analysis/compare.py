"""Several missions side by side: one table, how many sources were found when, how far off they were."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from fieldkit import __version__
from fieldkit import settings as given
from fieldkit.files import write_whole
from fieldkit.look import paper_css, svg
from mission.analysis.figures import figures

GROUPS = ("planner", "belief", "name", "robots", "seed")


def compare(logs: Sequence[Path], out: Path | None, by: str = given.COMPARED_BY) -> dict[str, Any]:
    """Figures of each recording, and of each group by `by`; the page is written to `out` unless that is None.

    Raises `RecordingError` for what is no recording: then no page is written.
    """
    rows = [figures(log) for log in logs]
    groups = summarise(rows, by)
    if out is not None:
        write_whole(out, _page(rows, groups, by))
    return {"missions": rows, "groups": groups, "by": by}


def summarise(rows: Sequence[dict[str, Any]], by: str) -> list[dict[str, Any]]:
    """One row a group: how many missions, how often all was found, times and errors.

    Times are of the missions that found all true sources; `unfinished` counts the others. None where the truth is
    not known.
    """
    grouped: dict[Any, list[dict[str, Any]]] = defaultdict(list)
    for row in rows:
        grouped[row[by]].append(row)
    found = []
    for name, group in sorted(grouped.items(), key=lambda item: str(item[0])):
        known = [row for row in group if row["true_sources"] is not None]
        times = [row["localised_all_s"] for row in known if row["localised_all_s"] is not None]
        errors = [s["error_m"] for row in known for s in row["sources"] if s["error_m"] is not None]
        found.append(
            {
                by: name,
                "missions": len(group),
                "median_time_s": float(np.median(times)) if times else None,
                "worst_time_s": max(times, default=None),
                "unfinished": len(known) - len(times) if known else None,
                "median_error_m": round(float(np.median(errors)), 3) if errors else None,
                "worst_error_m": max(errors, default=None),
                "false_finds": sum(row["false_finds"] for row in known) if known else None,
                "mean_duration_s": round(float(np.mean([row["duration_s"] for row in group])), 1),
            }
        )
    return found


def _page(rows: Sequence[dict[str, Any]], groups: Sequence[dict[str, Any]], by: str) -> str:
    from mission.analysis.plots import errors_by_group, found_by_time

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template("compare.html.j2").render(
        version=__version__,
        css=paper_css(),
        rows=rows,
        groups=groups,
        by=by,
        times=svg(found_by_time(rows, by)),
        errors=svg(errors_by_group(rows, by)) if any(r["mean_error_m"] is not None for r in rows) else "",
    )
