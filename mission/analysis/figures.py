"""One mission as a row of figures: how long, what was found and when, how far off where the truth is known."""

from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.messages import SourceEstimate
from mission.analysis.history import History, read_history

FALSE_CELLS = 2.0
"""A find further than this many cells from every true source is false, as in `fieldkit study`."""


def figures(path: Path) -> dict[str, Any]:
    """The row of a recording; None where a figure cannot be known. Raises `RecordingError` for what is not one."""
    return row_of(read_history(path))


def row_of(history: History) -> dict[str, Any]:
    """See `figures`. `sources` holds a row for each true source, or each find where the truth is not known."""
    kernel = history.mission.kernel
    since = found_since(history)
    sources = _against_truth(history, since) if history.truth else _finds(history, since)
    errors = [row["error_m"] for row in sources if row["error_m"] is not None]
    times = [row["found_after_s"] for row in sources]
    limit_m = FALSE_CELLS * kernel.engine.grid.cell_m
    known = bool(history.truth)
    return {
        "recording": str(history.path),
        "name": history.mission.file.name,
        "belief": kernel.belief,
        "planner": kernel.planner,
        "seed": history.mission.file.seed,
        "robots": len(kernel.engine.robots),
        "duration_s": round(history.duration_s, 1),
        "readings": sum(history.readings.values()),
        "detections": len(history.detections),
        "found": len(history.found),
        "true_sources": len(history.truth) if known else None,
        "false_finds": sum(_off(history, s) > limit_m for s in history.found) if known else None,
        "localised_all_s": max(times) if known and times and None not in times else None,
        "mean_error_m": round(float(np.mean(errors)), 3) if errors else None,
        "worst_error_m": round(max(errors), 3) if errors else None,
        "probability_left": round(history.left[-1][1], 4) if history.left else None,
        "end_reason": history.result["end_reason"] if history.result else "",
        "complete": history.recording.complete,
        "missing": history.recording.missing,
        "sources": sources,
    }


def found_since(history: History) -> dict[int, float]:
    """Each source that was found at the end to the mission time since which it was, for good."""
    since: dict[int, float] = {}
    for t_s, estimates in history.estimates:
        found = {source.ident for source in estimates if source.state == "found"}
        since = {ident: since.get(ident, t_s) for ident in found}
    return since


def _against_truth(history: History, since: dict[int, float]) -> list[dict[str, Any]]:
    """A row for each true source with its nearest find, if that is near enough."""
    limit_m = FALSE_CELLS * history.mission.kernel.engine.grid.cell_m
    rows = []
    for number, truth in enumerate(history.truth):
        place = truth["east_m"], truth["north_m"]
        near = min(history.found, key=lambda s: _distance(s, *place), default=None)
        if near is not None and _distance(near, *place) > limit_m:
            near = None
        rows.append(_row(number, near, since, None if near is None else round(_distance(near, *place), 3)))
    return rows


def _finds(history: History, since: dict[int, float]) -> list[dict[str, Any]]:
    return [_row(source.ident, source, since, None) for source in history.found]


def _row(
    number: int, find: SourceEstimate | None, since: dict[int, float], error_m: float | None
) -> dict[str, Any]:
    return {
        "source": number,
        "found": find is not None,
        "east_m": None if find is None else round(find.east_m, 3),
        "north_m": None if find is None else round(find.north_m, 3),
        "sigma_m": None if find is None else round(float(np.sqrt(np.trace(find.cov_m2) / 2)), 3),
        "error_m": error_m,
        "found_after_s": None if find is None else round(since[find.ident], 1),
    }


def _off(history: History, source: SourceEstimate) -> float:
    return min(_distance(source, t["east_m"], t["north_m"]) for t in history.truth)


def _distance(source: SourceEstimate, east_m: float, north_m: float) -> float:
    return float(np.hypot(source.east_m - east_m, source.north_m - north_m))
