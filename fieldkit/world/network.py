"""A simulated radio network between robots: range, loss, delay, repetition and cuts. Pure; time is given.

What is sent reaches whoever is in range at that moment, each with its own luck. It stands in for a real network in
tests and studies of robots without a common computer.
"""

import heapq
import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Air:
    """What the network is like."""

    range_m: float = math.inf
    loss: float = 0.0
    """Probability that one receiver misses a message."""
    delay_s: float = 0.05
    jitter_s: float = 0.0
    """Further delay, anything up to this: messages overtake each other."""
    repeated: float = 0.0
    """Probability that a message arrives once more, later."""
    cut_s: tuple[float, float] = (math.inf, math.inf)
    """From when to when the network is in two."""
    apart: frozenset[str] = frozenset()
    """The members of one half meanwhile."""


@dataclass
class Network:
    """Messages under way. Everything random comes from `rng`."""

    air: Air
    rng: np.random.Generator
    carried: Counter[str] = field(default_factory=Counter)
    """Bytes that each member has sent; a message counts once, however many hear it."""
    _way: list[tuple[float, int, str, bytes]] = field(default_factory=list)
    _number: int = 0

    def send(self, now_s: float, sender: str, data: bytes, places_m: Mapping[str, Place]) -> None:
        """Send to all in range; `places_m` says where every member is."""
        self.carried[sender] += len(data)
        air = self.air
        for name, place in places_m.items():
            if name == sender or math.dist(place, places_m[sender]) > air.range_m:
                continue
            if air.cut_s[0] <= now_s < air.cut_s[1] and (name in air.apart) != (sender in air.apart):
                continue
            if self.rng.random() < air.loss:
                continue
            self._put(now_s + air.delay_s + air.jitter_s * self.rng.random(), name, data)
            if self.rng.random() < air.repeated:
                self._put(now_s + air.delay_s + 1.0 + self.rng.random(), name, data)

    def arrived(self, now_s: float) -> list[tuple[str, bytes]]:
        """Receiver and message of all that has come by now, in the order in which it came."""
        came = []
        while self._way and self._way[0][0] <= now_s:
            _, _, name, data = heapq.heappop(self._way)
            came.append((name, data))
        return came

    def _put(self, at_s: float, name: str, data: bytes) -> None:
        self._number += 1
        heapq.heappush(self._way, (at_s, self._number, name, data))
