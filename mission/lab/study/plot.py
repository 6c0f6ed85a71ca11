"""A study's distribution of times as a picture."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np


def plot_times(result: dict[str, Any], path: Path) -> None:
    """Share of missions that had found all sources, over time, one line a scenario that can finish."""
    figure, axes = plt.subplots(figsize=(7.2, 4.2))
    for name, times in result["times_s"].items():
        done = np.sort([t for t in times if t is not None])
        if done.size:
            axes.step(
                np.r_[0, done], np.r_[0, np.arange(1, done.size + 1) / len(times)], where="post", label=name
            )
    axes.set(xlabel="mission time, s", ylabel="share of missions with all sources found", ylim=(0, 1.02))
    axes.set_xlim(left=0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)


def plot_surveys(result: dict[str, Any], path: Path) -> None:
    """Stated against actual coverage, and errors against what was stated and against the baselines."""
    figure, (curve, errors) = plt.subplots(1, 2, figsize=(10.4, 4.2))
    shares = [float(share) for share in result["calibration_curve"]]
    curve.plot([0, 1], [0, 1], color="0.7", lw=1)
    curve.plot(shares, list(result["calibration_curve"].values()), marker="o", ms=4)
    curve.set(
        xlabel="stated share of the region", ylabel="share of truths inside", xlim=(0, 1), ylim=(0, 1.02)
    )
    rows = result["surveys_table"]
    names = ["error_m", *result["all"].get("baselines", {})]
    for name in names:
        values = np.sort([row[name] for row in rows if name in row])
        label = "fieldkit" if name == "error_m" else name.replace("_", " ")
        errors.step(
            values,
            (np.arange(values.size) + 1) / values.size,
            where="post",
            label=label,
            lw=2 if name == "error_m" else 1,
        )
    errors.set(xscale="log", xlabel="error, m", ylabel="share of surveys", ylim=(0, 1.02))
    for axes in (curve, errors):
        axes.grid(alpha=0.3)
    errors.legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)
