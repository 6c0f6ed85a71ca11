"""An error of positions that wanders, as of satellites: the same for all who ask at the same time."""

import numpy as np

from fieldkit.world.shadowing import ShadowField

WANDER_S = 60.0
"""In this time such an error falls to 1/e."""


class Wander:
    """Normal in each coordinate, with correlation exp(-time / `WANDER_S`). The seed decides all."""

    def __init__(self, sigma_m: float, seed: int) -> None:
        self.sigma_m = sigma_m
        rng = np.random.default_rng([seed, 98])
        self._east, self._north = (ShadowField(sigma_m, WANDER_S, rng) for _ in range(2))

    def at(self, t_s: float) -> tuple[float, float]:
        """East and north, in metres."""
        when = np.array([[t_s, 0.0]])
        return float(self._east.at(when)[0]), float(self._north.at(when)[0])
