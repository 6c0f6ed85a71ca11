"""The ground on which sources are held for possible: the field, and one longest range beyond its border.

A transmitter outside the field is heard inside as well. A belief that ends at the border explains it by a source at
the border; one that goes on beyond says "outside". Where ranges are much longer than the field the ground's cells are
larger than the field's, as blurred as hearing over such a range is; candidates are refined down to the field's own.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray


@dataclass(frozen=True, slots=True)
class Ground:
    """The ground's own grid, of cells `factor` times as large as the field's, `beyond` of them outside each border."""

    field: Grid
    grid: Grid
    factor: int
    beyond: int
    blurred_m: float
    """Hearing is as blurred as this: points of a source nearer together say no more."""

    def of_field(self, values: FloatArray) -> FloatArray:
        """(..., n_north, n_east of the field) of values (..., n_north, n_east of the ground): that of its cell."""
        rows = self.beyond + np.arange(self.field.n_north) // self.factor
        columns = self.beyond + np.arange(self.field.n_east) // self.factor
        return np.asarray(values[..., rows[:, None], columns[None, :]])

    def has_field(self, points_m: FloatArray, grace_m: float = 0.0) -> NDArray[np.bool_]:
        """(n,) whether points (n, 2) lie in the field, or at most `grace_m` beyond its border.

        Half of what is believed of a source on the border lies beyond it: without grace such a source would be outside
        in every other mission.
        """
        low_m, high_m = self._corners_m()
        return np.asarray(((points_m >= low_m - grace_m) & (points_m <= high_m + grace_m)).all(axis=1))

    def _corners_m(self) -> tuple[FloatArray, FloatArray]:
        """(2,) and (2,): east and north of the field's south-west and north-east corners."""
        low_m = np.array([self.field.west_m, self.field.south_m])
        return low_m, low_m + np.array([self.field.size_east_m, self.field.size_north_m])

    @property
    def sources_a_cell(self) -> float:
        """Share of the field that a cell of the ground is as large as."""
        return self.factor**2 / self.field.n_cells

    def said_of(self, place_m: FloatArray) -> str:
        """Where a place outside the field is, seen from its middle."""
        low_m, high_m = self._corners_m()
        east_m, north_m = place_m - (low_m + high_m) / 2.0
        beyond_m = float(np.hypot(*(np.clip(place_m, low_m, high_m) - place_m)))
        bearing_deg = math.degrees(math.atan2(east_m, north_m)) % 360.0
        digits = 1 if beyond_m < 2.0 else 0
        beyond = f"about {beyond_m:.{digits}f} m beyond its border"
        return f"outside the field, {beyond}, at {bearing_deg:.0f} deg from its middle"


def ground_of(settings: EngineSettings, most_cells: int) -> Ground:
    """The ground of a mission, in no more than so many cells or twice those of the field."""
    field = settings.grid
    margin_m = float(np.max(settings.antenna.nominal_range_m(np.array(settings.power_levels_db))))
    margin_m = min(margin_m, MOST_SIDES * max(field.size_east_m, field.size_north_m))
    factor = 1
    blurred_m = BLURRED * float(np.min(settings.antenna.nominal_range_m(np.array(settings.power_levels_db))))
    while True:
        cell_m = factor * field.cell_m
        beyond = math.ceil(margin_m / cell_m)
        n_east = math.ceil(field.n_east / factor) + 2 * beyond
        n_north = math.ceil(field.n_north / factor) + 2 * beyond
        cells, blurred = n_east * n_north, cell_m + field.cell_m <= blurred_m
        if factor > 64 or cells <= most_cells or (cells <= 2 * field.n_cells and not blurred):
            west_m, south_m = field.west_m - beyond * cell_m, field.south_m - beyond * cell_m
            grid = Grid(n_east * cell_m, n_north * cell_m, cell_m, west_m, south_m)
            return Ground(field, grid, factor, beyond, blurred_m)
        factor += 1


BLURRED = 0.05
"""Ground in cells of this part of the shortest range is as good as ground in smaller ones: hearing is that blurred."""
MOST_SIDES = 2.0
"""No source is sought further outside than so many of the field's longer sides: that is another field."""
