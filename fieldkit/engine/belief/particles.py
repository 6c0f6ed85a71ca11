"""A particle filter over the places of all sources of a network at once (CSMA-PF section IV.A).

A particle is one guess of where all m sources are. Sampling importance sampling as printed, with two changes without
which it starves: eq 4's indicator becomes a Gaussian in dB (an indicator kills every particle at the first reading
that is rounded otherwise), and after resampling particles are shaken a little (roughening).
When a source is found the others' coordinates are drawn afresh; keeping them, as one may read the paper, strands the
filter in one trial of ten.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fieldkit.engine.likelihood.csma_loops import reading_likelihood
from fieldkit.messages import FloatArray


@dataclass(frozen=True, slots=True)
class Strength:
    """How strong a source is received, linear: scale * r^-exponent * gain(bearing)."""

    scale: float
    exponent: float
    gain: FloatArray = field(repr=False)
    """(k,) linear gain at evenly spaced angles counter-clockwise off the antenna's front."""
    sigma_db: float
    nearest_m: float = 1.0


class ParticleFilter:
    """n particles of m sources in a field of size (east, north). Deterministic given its generator."""

    def __init__(
        self,
        size_m: tuple[float, float],
        sources: int,
        strength: Strength,
        rng: np.random.Generator,
        particles: int = 5000,
        roughness_m: float = 0.5,
    ) -> None:
        if sources < 1 or particles < 2:
            raise ValueError(f"expected at least 1 source and 2 particles, got {sources} and {particles}")
        self.size_m, self.strength, self.roughness_m = size_m, strength, roughness_m
        self._rng = rng
        self.place = rng.uniform((0.0, 0.0), size_m, (particles, sources, 2))
        """(n, m, 2)"""
        self.weight = np.full(particles, 1.0 / particles)
        self.found: list[tuple[float, float]] = []
        """Places of identified sources, which stand first in every particle."""

    @property
    def sources(self) -> int:
        result: int = self.place.shape[1]
        return result

    def update(self, robot: tuple[float, float, float], z: float, p: float, q: float) -> None:
        """Take in a reading z (linear) of a robot at x, y and heading (counter-clockwise from x); p, q as in eq 12."""
        likelihood = np.empty(len(self.weight))
        s = self.strength
        reading_likelihood(
            self.place,
            np.array(robot),
            s.scale,
            s.exponent,
            s.gain,
            z,
            p,
            q,
            s.sigma_db,
            s.nearest_m,
            likelihood,
        )
        weight = self.weight * (likelihood + 1e-12 * max(float(likelihood.max()), 1e-300))
        total = float(weight.sum())
        if total <= 0.0 or not np.isfinite(total):  # no particle can have sent it: it says nothing
            return
        self.weight = weight / total
        if 1.0 / float(np.square(self.weight).sum()) < 0.5 * len(self.weight):
            self._resample()

    def _resample(self) -> None:
        """Systematic resampling, then roughening of what is not identified."""
        n = len(self.weight)
        at = (self._rng.random() + np.arange(n)) / n
        chosen = np.searchsorted(np.cumsum(self.weight), at).clip(max=n - 1)
        self.place = np.ascontiguousarray(self.place[chosen])
        self.weight = np.full(n, 1.0 / n)
        free = self.place[:, len(self.found) :]
        free += self._rng.normal(0.0, self.roughness_m, free.shape)
        np.clip(free, 0.0, self.size_m, out=free)

    def density(self, cells: tuple[int, int], smooth_cells: float = 1.0) -> FloatArray:
        """(n_north, n_east) expected number of unidentified sources in each cell of a grid over the field."""
        free = self.place[:, len(self.found) :].reshape(-1, 2)
        weight = np.repeat(self.weight, self.sources - len(self.found))
        column = np.minimum((free[:, 0] * (cells[1] / self.size_m[0])).astype(int), cells[1] - 1)
        row = np.minimum((free[:, 1] * (cells[0] / self.size_m[1])).astype(int), cells[0] - 1)
        flat = np.bincount(row * cells[1] + column, weights=weight, minlength=cells[0] * cells[1])
        counts = flat.reshape(cells).astype(float)
        return np.asarray(ndimage.gaussian_filter(counts, smooth_cells, mode="constant"))

    def most_probable(self, cell_m: float) -> tuple[float, float]:
        """Where an unidentified source most probably is: the middle of the densest cell."""
        cells = (max(1, round(self.size_m[1] / cell_m)), max(1, round(self.size_m[0] / cell_m)))
        density = self.density(cells)
        row, column = np.unravel_index(int(np.argmax(density)), density.shape)
        return (
            float((column + 0.5) * self.size_m[0] / cells[1]),
            float((row + 0.5) * self.size_m[1] / cells[0]),
        )

    def probability_near(self, place_m: tuple[float, float], radius_m: float) -> float:
        """P(an unidentified source lies within `radius_m` of the place)."""
        free = self.place[:, len(self.found) :]
        near: NDArray[np.bool_] = np.hypot(free[..., 0] - place_m[0], free[..., 1] - place_m[1]) <= radius_m
        return float(self.weight[near.any(axis=1)].sum())

    def identify(self, place_m: tuple[float, float]) -> None:
        """Take a source for found at the place; where the others are is asked anew."""
        self.found.append(place_m)
        n, k = len(self.weight), len(self.found)
        self.place[:, :k] = np.array(self.found)
        self.place[:, k:] = self._rng.uniform((0.0, 0.0), self.size_m, (n, self.sources - k, 2))
        self.weight = np.full(n, 1.0 / n)

    @property
    def all_found(self) -> bool:
        return len(self.found) == self.sources
