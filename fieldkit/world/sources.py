"""Transmitters nobody knows about: where they are, how strong, how often they send."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class TransientSource:
    """A transmitter of short packets, mostly a Poisson process. `power_db` is relative to the calibrated one."""

    east_m: float
    north_m: float
    power_db: float
    rate_hz: float
    burst_s: tuple[float, float] | None = None
    """It sends only for the first so many seconds of every so many; None: all the time."""
    beacon: bool = False
    """It sends once every 1 / `rate_hz` seconds, as beacons do, and not as a Poisson process."""

    def sends_at(self, t_s: float) -> bool:
        """Whether it is awake."""
        return self.burst_s is None or t_s % self.burst_s[1] < self.burst_s[0]


def random_sources(
    count: int,
    size_east_m: float,
    size_north_m: float,
    power_levels_db: tuple[float, ...],
    rate_hz: float,
    rng: np.random.Generator,
    *,
    min_separation_m: float = 0.0,
) -> list[TransientSource]:
    """Sources uniformly over the field, each at one of the power levels, at least `min_separation_m` apart."""
    sources: list[TransientSource] = []
    attempts = 0
    while len(sources) < count:
        attempts += 1
        if attempts > 10_000:
            raise ValueError(f"{count} sources do not fit {min_separation_m} m apart in the field")
        east, north = rng.uniform(0.0, size_east_m), rng.uniform(0.0, size_north_m)
        power = float(rng.choice(power_levels_db))
        if all(np.hypot(east - s.east_m, north - s.north_m) >= min_separation_m for s in sources):
            sources.append(TransientSource(float(east), float(north), power, rate_hz))
    return sources


class Transmissions:
    """The sources' packets in order of time, each source's independent of the others'."""

    def __init__(
        self, sources: list[TransientSource], rng: np.random.Generator, start_s: float = 0.0
    ) -> None:
        self.sources = sources
        self._rng = rng
        # Nobody knows where in its period a beacon is.
        self._next_s = [
            start_s + (rng.uniform(0.0, 1.0 / s.rate_hz) if s.beacon else self._gap_s(s)) for s in sources
        ]

    def _gap_s(self, source: TransientSource) -> float:
        mean_s = 1.0 / source.rate_hz
        return mean_s if source.beacon else float(self._rng.exponential(mean_s))

    def until(self, t_s: float) -> list[tuple[float, TransientSource]]:
        """Transmissions not yet given with time <= `t_s`, in order."""
        due: list[tuple[float, TransientSource]] = []
        while self._next_s:
            index = int(np.argmin(self._next_s))
            at_s = self._next_s[index]
            if at_s > t_s:
                break
            due.append((at_s, self.sources[index]))
            self._next_s[index] = at_s + self._gap_s(self.sources[index])
        return due
