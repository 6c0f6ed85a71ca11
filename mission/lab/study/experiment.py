"""An experiment of a paper: methods along one axis, the same seeds for all, summarised with nothing left out.

A trial that does not end within the limit is censored: it is counted, takes part in the mean with the limit, and stands
beside the mean of those that ended.
"""

import csv
import io
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mission.lab.study.pool import Progress, having, run_trials


@dataclass(frozen=True, slots=True)
class Job:
    """One trial: picklable, and named by its repr."""

    study: str
    method: str
    x: float
    seed: int


@dataclass(frozen=True, slots=True)
class Experiment:
    """What is varied and what is measured. `trial` gives plain values, among them `value` (None: censored)."""

    name: str
    title: str
    x_label: str
    y_label: str
    methods: tuple[str, ...]
    xs: tuple[float, ...]
    trial: Callable[[Job], dict[str, Any]]
    cap: float | None = None
    """The limit at which a trial is censored."""

    def jobs(self, trials: int, seed: int) -> list[Job]:
        """The same seeds for every method and every x."""
        return [
            Job(self.name, method, x, seed + k)
            for x in self.xs
            for method in self.methods
            for k in range(trials)
        ]


def run(
    experiment: Experiment, trials: int, seed: int, progress: Progress, *, only: str = "", **how: Any
) -> dict[str, Any]:
    """Trials and their summary, of the points whose name ("method, x") contains `only` (see `having`).

    `how` goes to `run_trials` (workers, kept, dask). Raises `ConfigError` where no point has that name.
    """
    names = having(only, (key(method, x) for x in experiment.xs for method in experiment.methods))
    jobs = [job for job in experiment.jobs(trials, seed) if key(job.method, job.x) in names]
    rows = run_trials(experiment.trial, jobs, progress, **how)
    grouped: dict[str, list[dict[str, Any]]] = {}
    for job, row in zip(jobs, rows, strict=True):
        grouped.setdefault(key(job.method, job.x), []).append(row)
    return {
        "study": experiment.name,
        "title": experiment.title,
        "trials": trials,
        "seed": seed,
        "x_label": experiment.x_label,
        "y_label": experiment.y_label,
        "methods": [method for method in experiment.methods if any(job.method == method for job in jobs)],
        "xs": [x for x in experiment.xs if any(job.x == x for job in jobs)],
        "scenarios": {name: summarise(group, experiment.cap) for name, group in grouped.items()},
        "trials_table": [
            {"method": job.method, "x": job.x, "seed": job.seed, **row}
            for job, row in zip(jobs, rows, strict=True)
        ],
        **throughput(rows),
    }


def key(method: str, x: float) -> str:
    """The name of a scenario."""
    return f"{method}, {x:g}"


def summarise(rows: list[dict[str, Any]], cap: float | None) -> dict[str, Any]:
    """Mean, deviation and median of `value` over trials that ended, the censored ones counted; means of the rest."""
    ended = np.array([row["value"] for row in rows if row["value"] is not None], dtype=float)
    censored = sum(row["value"] is None for row in rows)
    summary: dict[str, Any] = {
        "trials": len(rows),
        "mean": float(ended.mean()) if ended.size else None,
        "std": float(ended.std(ddof=1)) if ended.size > 1 else None,
        "median": float(np.median(ended)) if ended.size else None,
        "censored": censored,
    }
    if cap is not None:
        summary["mean_with_censored"] = float((ended.sum() + censored * cap) / len(rows))
    for name in rows[0]:
        if name not in ("value", "wall_s", "simulated_s") and isinstance(rows[0][name], int | float):
            summary[f"mean_{name}"] = float(np.mean([row[name] for row in rows]))
    return summary


def throughput(rows: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Simulated seconds a second of one core, where trials say what they took."""
    timed = [row for row in rows if "wall_s" in row and "simulated_s" in row]
    wall = sum(row["wall_s"] for row in timed)
    return {"simulated_s_per_s": sum(row["simulated_s"] for row in timed) / wall} if wall > 0.0 else {}


def table_csv(result: dict[str, Any]) -> str:
    """Every trial as a line of CSV."""
    rows = result["trials_table"]
    names = list(
        dict.fromkeys(name for row in rows for name, value in row.items() if not isinstance(value, list))
    )
    text = io.StringIO()
    writer = csv.DictWriter(text, names, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def plot(result: dict[str, Any], path: Path) -> None:
    """Mean (censored trials at the limit) and standard error against x; hollow where some are censored.

    Methods named "panel; line" stand in panels of their own.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels: dict[str, list[str]] = {}
    for method in result["methods"]:
        panels.setdefault(method.rpartition("; ")[0], []).append(method)
    columns = min(3, len(panels))
    rows = -(-len(panels) // columns)
    figure, grid = plt.subplots(
        rows, columns, figsize=(7.2 if columns == 1 else 4.4 * columns, 4.2 * rows), squeeze=False
    )
    for axes, (panel, methods) in zip(grid.flat, panels.items(), strict=False):
        for method in methods:
            _line(axes, result, method)
        axes.set(xlabel=result["x_label"], ylabel=result["y_label"], title=panel or result["title"])
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)


def _line(axes: Any, result: dict[str, Any], method: str) -> None:
    points = []
    for x in result["xs"]:
        row = result["scenarios"].get(key(method, x))
        if row is None:
            continue
        mean = row.get("mean_with_censored", row["mean"])
        if mean is not None:
            points.append((x, mean, (row["std"] or 0.0) / np.sqrt(row["trials"]), row["censored"]))
    if not points:
        return
    xs, means, errors, censored = (np.array(column) for column in zip(*points, strict=True))
    line = axes.errorbar(
        xs, means, errors, marker="o", ms=4, lw=1.3, capsize=2, label=method.rpartition("; ")[2]
    )
    hollow = censored > 0
    axes.plot(xs[hollow], means[hollow], "o", ms=6, mfc="white", mec=line[0].get_color(), ls="none")
