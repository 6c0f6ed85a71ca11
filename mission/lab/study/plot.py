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
