"""What has been searched: where a source of the reference rate would have been heard by now. Pure."""

from collections.abc import Sequence

import numpy as np

from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray

SIDE = 64
LONGEST_S = 2.0
"""A longer gap between two looks was no listening."""


class Exposure:
    """Seconds that each cell of a coarse grid (n_north, n_east) was within the middle level's nominal range."""

    def __init__(self, engine: EngineSettings) -> None:
        grid = engine.grid
        self.cell_m = max(grid.size_east_m, grid.size_north_m) / SIDE
        n_east = max(1, int(np.ceil(grid.size_east_m / self.cell_m)))
        n_north = max(1, int(np.ceil(grid.size_north_m / self.cell_m)))
        self._east_m = (np.arange(n_east) + 0.5) * self.cell_m
        self._north_m = (np.arange(n_north) + 0.5) * self.cell_m
        self._range_m = float(np.median(engine.antenna.nominal_range_m(np.array(engine.power_levels_db))))
        self._rate_hz = engine.reference_rate_hz
        self._heard_s = np.zeros((n_north, n_east))
        self._last_ns: int | None = None

    def listen(self, places_m: Sequence[tuple[float, float]], now_ns: int) -> None:
        """Robots with a radio that works have been at these places since the last look."""
        passed_s = 0.0 if self._last_ns is None else (now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns
        if not 0.0 < passed_s <= LONGEST_S or not places_m:
            return
        near = np.zeros(self._heard_s.shape, dtype=bool)
        for east_m, north_m in places_m:
            square = (self._east_m[None, :] - east_m) ** 2 + (self._north_m[:, None] - north_m) ** 2
            near |= square <= self._range_m**2
        self._heard_s += passed_s * near

    def searched(self) -> FloatArray:
        """(n_north, n_east) probability that a source of the reference rate there has transmitted meanwhile."""
        return 1.0 - np.exp(-self._rate_hz * self._heard_s)
