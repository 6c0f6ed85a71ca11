"""Level sets, their components and ridges (PRWA section V.A, RWA section V).

Points of a field, arrays of shape (k, 2), are east and north in metres.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import pdist, squareform

from fieldkit.engine.belief.spog import EIGHT
from fieldkit.engine.grid import Grid
from fieldkit.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Ridge:
    """The longest line segment of one component of the level set."""

    ends_m: FloatArray
    """(2, 2); equal ends where the component is one cell."""
    cells: FloatArray
    """(k, 2) cell centres of the component."""
    flat: NDArray[np.intp]
    """(k,) flat indices of those cells."""
    weight: float
    """Sum of P(C_i^1) over the component: its share of the time (RWA eq 29)."""

    @property
    def length_m(self) -> float:
        return float(np.hypot(*(self.ends_m[1] - self.ends_m[0])))

    @property
    def middle_m(self) -> FloatArray:
        return np.asarray(self.ends_m.mean(axis=0))


def find_ridges(presence: FloatArray, activity: FloatArray, level: float, grid: Grid) -> list[Ridge]:
    """One ridge per 8-connected component of {P(C_i) >= level} (eq 22 and 23), heaviest first."""
    labels, count = ndimage.label(presence >= level, structure=EIGHT)
    ridges = []
    for label in range(1, count + 1):
        rows, columns = np.nonzero(labels == label)
        cells = np.column_stack([grid.east_m[columns], grid.north_m[rows]])
        ridges.append(
            Ridge(
                farthest_pair(cells),
                cells,
                rows * grid.n_east + columns,
                float(activity[rows, columns].sum()),
            )
        )
    return sorted(ridges, key=lambda ridge: -ridge.weight)


def farthest_pair(points_m: FloatArray) -> FloatArray:
    """(2, 2): the two of the points (k, 2) that are farthest apart; twice the same one where there is only one."""
    candidates = points_m
    if len(points_m) > 8:
        try:
            candidates = points_m[ConvexHull(points_m).vertices]
        except QhullError:  # all on one line
            order = np.lexsort((points_m[:, 1], points_m[:, 0]))
            candidates = points_m[order[[0, -1]]]
    if len(candidates) == 1:
        return np.repeat(candidates, 2, axis=0)
    distance = squareform(pdist(candidates))
    first, second = np.unravel_index(int(np.argmax(distance)), distance.shape)
    return np.asarray(candidates[[first, second]])
