"""A person on foot who follows advice, mostly; and what their body does to a radio that they carry in front."""

import math
from dataclasses import dataclass, field

import numpy as np

from fieldkit.messages import FloatArray

WALKING_M_S = 1.2
IGNORES = 1.0 / 3.0
"""Share of hints that a person does not follow."""
NEW_HINT_M = 3.0
"""Advice that moves by less is the same hint."""
ARRIVED_M = 1.0
EDGE_M = 1e-6
"""Along a border nobody has left the field."""


@dataclass
class Walker:
    """Kinematic state in the field frame; heading clockwise from north. Turns at once, walks straight."""

    east_m: float
    north_m: float
    rng: np.random.Generator
    speed_m_s: float = WALKING_M_S
    ignores: float = IGNORES
    """Share of hints that are not followed: then the person walks on as they please, until the next hint."""
    size_m: tuple[float, float] = (math.inf, math.inf)
    """The field: nobody walks out of it of their own accord."""
    heading_deg: float = 0.0
    _hint_m: tuple[float, float] | None = field(default=None, init=False)
    _ignored: bool = field(default=False, init=False)

    def advise(self, place_m: tuple[float, float] | None) -> None:
        """The present advice; None: stay."""
        if place_m is not None and (self._hint_m is None or math.dist(place_m, self._hint_m) > NEW_HINT_M):
            self._ignored = bool(self.rng.random() < self.ignores)
            if self._ignored:
                self.heading_deg = float(self.rng.uniform(0.0, 360.0))
        self._hint_m = place_m

    def step(self, dt_s: float) -> None:
        """Walk on by `dt_s`."""
        if self._hint_m is None:
            return
        step_m = self.speed_m_s * dt_s
        if not self._ignored:
            east, north = self._hint_m[0] - self.east_m, self._hint_m[1] - self.north_m
            left_m = math.hypot(east, north)
            if left_m <= ARRIVED_M:
                return
            self.heading_deg = math.degrees(math.atan2(east, north)) % 360.0
            step_m = min(step_m, left_m)
        heading = math.radians(self.heading_deg)
        east, north = self.east_m + step_m * math.sin(heading), self.north_m + step_m * math.cos(heading)
        if not (-EDGE_M <= east <= self.size_m[0] and -EDGE_M <= north <= self.size_m[1]):
            self.heading_deg = (self.heading_deg + 180.0) % 360.0
            return
        self.east_m, self.north_m = east, north


def body_loss_db(off_front_deg: FloatArray, behind_db: float) -> FloatArray:
    """What a body takes from a signal that comes `off_front_deg` from where the person looks."""
    return np.asarray(behind_db * 0.5 * (1.0 - np.cos(np.radians(off_front_deg))))


@dataclass
class WanderingError:
    """A satellite receiver's error: it stays for a while, and drifts (first-order Gauss-Markov)."""

    sigma_m: float
    lasts_s: float
    rng: np.random.Generator
    off_m: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.off_m = self.rng.normal(0.0, self.sigma_m, 2)

    def step(self, dt_s: float) -> None:
        """Drift on by `dt_s`."""
        kept = math.exp(-dt_s / self.lasts_s)
        self.off_m = kept * self.off_m + math.sqrt(1.0 - kept**2) * self.rng.normal(0.0, self.sigma_m, 2)
