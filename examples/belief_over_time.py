"""How the belief gathered: at each moment, how much of the field it would take to hold half of it.

    python examples/belief_over_time.py runs/20260102T030405Z/mission.mcap belief.png

A belief is an array (n_north, n_east), row 0 south: the probability that each cell holds a source.
"""

import sys

import numpy as np

import fieldkit
from fieldkit.recording import BeliefGrid


def half_area_m2(grid: BeliefGrid) -> float:
    """The smallest area that holds half of all probability."""
    falling = np.sort(grid.values.ravel())[::-1]
    cells = int(np.searchsorted(np.cumsum(falling), 0.5 * falling.sum())) + 1
    return cells * grid.cell_m**2


def main(path: str, picture: str) -> None:
    """Print the areas, and draw the first, a middle and the last belief."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    log = fieldkit.open_log(path)
    times_s = [(grid.log_time_ns - log.start_ns) * 1e-9 for grid in log.beliefs]
    for t_s, grid in zip(times_s, log.beliefs, strict=True):
        print(f"{t_s:7.1f} s: half of the probability lies in {half_area_m2(grid):6.2f} m²")
    moments_s = (times_s[0], times_s[len(times_s) // 2], times_s[-1])
    figure, axes = plt.subplots(1, 3, figsize=(10, 3.2))
    for each, t_s in zip(axes, moments_s, strict=True):
        grid = log.belief_at(t_s)
        extent = (0.0, grid.values.shape[1] * grid.cell_m, 0.0, grid.values.shape[0] * grid.cell_m)
        each.imshow(np.log10(np.maximum(grid.values, 1e-5)), origin="lower", cmap="Greys", extent=extent)
        each.set_title(f"{t_s:.0f} s")
    figure.savefig(picture, bbox_inches="tight")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
