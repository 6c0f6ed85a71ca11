"""Shadowing that belongs to places: for each source one random field over the ground, the same at every visit.

Normal, with correlation exp(-distance / length), by random Fourier features (Rahimi and Recht, 2007): a sum of waves
whose numbers are drawn from the correlation's spectrum, which in two dimensions is (1 + (k L)^2)^(-3/2).
"""

import numpy as np

from fieldkit.messages import FloatArray

WAVES = 600


class ShadowField:
    """One source's shadowing. Deterministic: the generator's state decides all."""

    def __init__(self, sigma_db: float, length_m: float, rng: np.random.Generator) -> None:
        # The radius by the inverse of its distribution function 1 - (1 + (k L)^2)^(-1/2).
        radius = np.sqrt(1.0 / (1.0 - rng.random(WAVES)) ** 2 - 1.0) / length_m
        angle = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        self._wave = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        self._phase = rng.uniform(0.0, 2.0 * np.pi, WAVES)
        self._scale = sigma_db * np.sqrt(2.0 / WAVES)

    def at(self, place_m: FloatArray) -> FloatArray:
        """(m,) dB at places (m, 2)."""
        return np.asarray(self._scale * np.cos(place_m @ self._wave.T + self._phase).sum(axis=1))


def shadow_fields(
    count: int, sigma_db: float, length_m: float, rng: np.random.Generator
) -> tuple[ShadowField, ...]:
    """One for each source."""
    return tuple(ShadowField(sigma_db, length_m, rng) for _ in range(count))
