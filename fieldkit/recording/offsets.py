"""How far two recordings' clocks are apart, estimated from transmissions that both heard.

Readings that carry a frame's address and sequence number are matched by it. Others are matched by their rhythm:
packets come at irregular moments, so the right offset makes many of them coincide and a wrong one hardly any.
"""

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from fieldkit.messages import FloatArray, RssReading

WINDOW_S = 0.1
"""Receptions this near are one transmission."""
MAX_OFFSET_S = 600.0
MIN_SHARED = 5
SURE_RATIO = 2.0
"""The best offset must make this many times as many readings coincide as any other that is apart from it."""


@dataclass(frozen=True, slots=True)
class Offset:
    """`seconds` to add to the second recording's times to get the first's."""

    seconds: float
    sigma_s: float
    """Standard error, from the scatter of the shared receptions."""
    shared: int
    """Receptions it rests on."""
    by: str
    """`frames` (address and number), `rhythm`, or `given`."""

    @property
    def nanoseconds(self) -> int:
        """`seconds` as times are counted."""
        return round(self.seconds * 1e9)


def estimate_offset(first: list[RssReading], second: list[RssReading]) -> Offset | None:
    """The offset of `second`'s clock against `first`'s; None where what both heard does not decide it."""
    return _by_frames(first, second) or _by_rhythm(_times_ns(first), _times_ns(second))


def _times_ns(readings: list[RssReading]) -> np.ndarray:
    return np.sort(np.array([reading.t_ns for reading in readings], dtype=np.int64))


def _by_frames(first: list[RssReading], second: list[RssReading]) -> Offset | None:
    """Frames that each heard once, so that a number that comes round again misleads nobody."""
    seen: tuple[dict[str, list[int]], dict[str, list[int]]] = (defaultdict(list), defaultdict(list))
    for times, readings in zip(seen, (first, second), strict=True):
        for reading in readings:
            if reading.frame_id:
                times[reading.frame_id].append(reading.t_ns)
    apart = [
        (mine[0] - seen[1][frame][0]) * 1e-9
        for frame, mine in seen[0].items()
        if len(mine) == 1 and len(seen[1].get(frame, ())) == 1
    ]
    return _agreed(np.array(apart), "frames")


def _by_rhythm(one_ns: np.ndarray, other_ns: np.ndarray) -> Offset | None:
    if len(one_ns) < MIN_SHARED or len(other_ns) < MIN_SHARED:
        return None
    apart = (one_ns[:, None] - other_ns[None, :]).ravel() * 1e-9
    apart = np.sort(apart[np.abs(apart) <= MAX_OFFSET_S])
    if not len(apart):
        return None
    # How many differences lie within a window that starts at each: the fullest window is the offset.
    within = np.searchsorted(apart, apart + WINDOW_S, side="right") - np.arange(len(apart))
    best = int(np.argmax(within))
    elsewhere = np.abs(apart - apart[best]) > 2.0 * WINDOW_S
    runner_up = int(within[elsewhere].max(initial=0))
    if within[best] < max(MIN_SHARED, SURE_RATIO * runner_up):
        return None
    return _agreed(apart[best : best + int(within[best])], "rhythm")


def _agreed(apart_s: FloatArray, by: str) -> Offset | None:
    """The middle of differences that agree with each other; None where too few do."""
    if len(apart_s) < MIN_SHARED:
        return None
    middle = float(np.median(apart_s))
    near = apart_s[np.abs(apart_s - middle) <= WINDOW_S]
    if len(near) < max(MIN_SHARED, 0.5 * len(apart_s)):
        return None
    sigma_s = float(np.std(near, ddof=1)) / math.sqrt(len(near))
    return Offset(float(np.median(near)), sigma_s, len(near), by)
