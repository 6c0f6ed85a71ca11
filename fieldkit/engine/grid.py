"""The search field as cells: arrays over it have shape (n_north, n_east), row 0 south."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fieldkit.messages import FloatArray


@dataclass(frozen=True)
class Grid:
    """A rectangle of square cells; its south-west corner is the origin of the field frame where not said otherwise."""

    size_east_m: float
    size_north_m: float
    cell_m: float
    west_m: float = 0.0
    south_m: float = 0.0
    """Of the south-west corner."""

    @cached_property
    def n_east(self) -> int:
        return max(1, math.ceil(self.size_east_m / self.cell_m - 1e-9))

    @cached_property
    def n_north(self) -> int:
        return max(1, math.ceil(self.size_north_m / self.cell_m - 1e-9))

    @property
    def shape(self) -> tuple[int, int]:
        return self.n_north, self.n_east

    @property
    def n_cells(self) -> int:
        return self.n_north * self.n_east

    @cached_property
    def east_m(self) -> FloatArray:
        """(n_east,) cell centres."""
        return np.asarray(self.west_m + (np.arange(self.n_east) + 0.5) * self.cell_m, dtype=float)

    @cached_property
    def north_m(self) -> FloatArray:
        """(n_north,) cell centres."""
        return np.asarray(self.south_m + (np.arange(self.n_north) + 0.5) * self.cell_m, dtype=float)

    @cached_property
    def centres_m(self) -> FloatArray:
        """(n_cells, 2) east, north of every cell centre, in flat order: index = row * n_east + column."""
        north, east = np.meshgrid(self.north_m, self.east_m, indexing="ij")
        return np.column_stack([east.ravel(), north.ravel()])

    def cell_of(self, east_m: float, north_m: float) -> tuple[int, int]:
        """(row, column) of the cell that holds a point; points outside belong to the nearest cell."""
        row = min(self.n_north - 1, max(0, math.floor((north_m - self.south_m) / self.cell_m)))
        column = min(self.n_east - 1, max(0, math.floor((east_m - self.west_m) / self.cell_m)))
        return row, column

    def contains(self, east_m: float, north_m: float, margin_m: float = 0.0) -> bool:
        """Whether a point lies in the field, `margin_m` inside its border."""
        return (
            margin_m <= east_m - self.west_m <= self.size_east_m - margin_m
            and margin_m <= north_m - self.south_m <= self.size_north_m - margin_m
        )

    def box_around(self, points_m: FloatArray, radius_m: float) -> tuple[int, int, int, int]:
        """(row0, row1, column0, column1), half open: the cells within `radius_m` of the box round points (k, 2)."""
        low = points_m.min(axis=0) - radius_m
        high = points_m.max(axis=0) + radius_m
        row0, column0 = self.cell_of(low[0], low[1])
        row1, column1 = self.cell_of(high[0], high[1])
        return row0, row1 + 1, column0, column1 + 1
