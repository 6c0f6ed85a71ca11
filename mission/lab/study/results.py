"""A study's or benchmark's results as files: JSON, every trial as CSV, a plot."""

import json
from pathlib import Path
from typing import Any

from fieldkit.files import write_whole

BULKY = ("times_s", "trials_table", "surveys_table")
"""Parts of a result that hold every trial: for files, not for the screen."""


def save(result: dict[str, Any], folder: Path) -> None:
    """Write result.json, and trials.csv and a plot where the result has what they need."""
    write_whole(folder / "result.json", json.dumps(result, indent=2, default=str))
    if "trials_table" in result:
        from mission.lab.study.experiment import plot, table_csv

        write_whole(folder / "trials.csv", table_csv(result))
        plot(result, folder / "plot.png")
    if "times_s" in result:
        from mission.lab.study.plot import plot_times

        plot_times(result, folder / "times.png")
    if "surveys_table" in result:
        from mission.lab.study.plot import plot_surveys

        plot_surveys(result, folder / "reality.png")


def save_bench(results: dict[str, Any], folder: Path) -> None:
    """Write result.json of benchmarks by name, and the plot of `scale`."""
    write_whole(folder / "result.json", json.dumps(results, indent=2, default=str))
    if "scale" in results:
        from mission.lab.bench_scale import plot_scale

        plot_scale(results["scale"], folder / "scale.png")
