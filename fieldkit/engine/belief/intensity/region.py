"""The smallest set of cells that holds a share of a candidate's posterior of place."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fieldkit.messages import FloatArray

LEAST_CELLS = 0.125
"""An error of the positions of less than this part of a cell is left out."""


def smallest_region(
    points_m: FloatArray, weight: FloatArray, cell_m: float, sigma_m: float, share: float
) -> set[tuple[int, int]]:
    """Cells (row, column) that hold `share` of what points (n, 2), east and north, weigh together.

    `sigma_m` is an error of the positions that is common to all that was heard.
    """
    if sigma_m > LEAST_CELLS * cell_m:
        points_m, weight = _blurred(points_m, weight, cell_m, sigma_m)
    cells, weight = _binned(points_m, weight, cell_m)
    order = np.argsort(-weight, kind="stable")
    needed = int(np.searchsorted(np.cumsum(weight[order]), share)) + 1
    return {(int(row), int(column)) for row, column in cells[order[:needed]]}


def _binned(points_m: FloatArray, weight: FloatArray, cell_m: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Cells (k, 2), row and column, that have points, and what these weigh."""
    at = np.floor(points_m[:, ::-1] / cell_m).astype(np.int64)
    cells, which = np.unique(at, axis=0, return_inverse=True)
    return cells, np.asarray(np.bincount(which.ravel(), weights=weight), dtype=float)


def _blurred(
    points_m: FloatArray, weight: FloatArray, cell_m: float, sigma_m: float
) -> tuple[FloatArray, FloatArray]:
    """Points and weights after a normal error.

    The error is added on parts of cells no larger than itself: what lies at the edge of a cell may as well lie beyond.
    """
    part_m = cell_m / math.ceil(max(1.0, cell_m / sigma_m))
    cells, weight = _binned(points_m, weight, part_m)
    sigma = sigma_m / part_m
    pad = math.ceil(3.0 * sigma)
    low = cells.min(axis=0) - pad
    grid = np.zeros(tuple(cells.max(axis=0) + pad + 1 - low))
    grid[tuple((cells - low).T)] = weight
    grid = gaussian_filter(grid, sigma, mode="constant")
    some = np.argwhere(grid > 1e-9)
    return (some + low + 0.5)[:, ::-1] * part_m, np.asarray(grid[tuple(some.T)] / grid.sum())
