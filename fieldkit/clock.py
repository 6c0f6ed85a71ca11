"""The only file that reads time: real, scaled and virtual clocks.

`now_ns` is UTC mission time in nanoseconds; `elapsed_s` never steps back and is for durations and deadlines.
Both run at the clock's rate: under a clock scaled by 10, `sleep(1.0)` takes a tenth of a second.
"""

import asyncio
import math
import sys
import time
from dataclasses import dataclass, field
from typing import Protocol

from fieldkit.errors import ConfigError


class Clock(Protocol):
    """Time, as the mission sees it."""

    @property
    def rate(self) -> float:
        """Mission seconds per wall second."""
        ...

    def now_ns(self) -> int:
        """UTC, in nanoseconds."""
        ...

    def elapsed_s(self) -> float:
        """Seconds since some fixed moment; monotonic."""
        ...

    async def sleep(self, duration_s: float) -> None:
        """Wait for `duration_s` seconds of mission time."""
        ...


# Linux: clock_gettime(2); `time.monotonic` stands still while the computer sleeps. macOS: clock_gettime(3); Python's
# `time.monotonic` is another clock there than CLOCK_MONOTONIC, which goes on. Windows' goes on.
_GOES_ON: int | None = getattr(
    time, "CLOCK_BOOTTIME", getattr(time, "CLOCK_MONOTONIC", None) if sys.platform == "darwin" else None
)


def _since_boot_ns() -> int:
    """Nanoseconds that never step back, and go on while the computer sleeps."""
    return time.monotonic_ns() if _GOES_ON is None else time.clock_gettime_ns(_GOES_ON)


class RealClock:
    """Wall time, anchored once: a step of the system clock does not move a mission's time stamps.

    It goes on while the computer sleeps, so that whoever wakes up knows how long nobody has steered.
    """

    rate = 1.0

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - _since_boot_ns()

    def now_ns(self) -> int:
        return _since_boot_ns() + self._offset_ns

    def set_back(self, by_s: float) -> None:
        """From now on say so much less: for whoever has found this computer's clock ahead of those it works with."""
        self._offset_ns -= round(by_s * 1e9)

    def elapsed_s(self) -> float:
        return _since_boot_ns() * 1e-9

    async def sleep(self, duration_s: float) -> None:
        await asyncio.sleep(max(0.0, duration_s))


@dataclass(frozen=True, slots=True)
class ScaledClock:
    """Mission time that runs `rate` times as fast as the wall's. Picklable: processes share one time."""

    rate: float
    start_ns: int = field(default_factory=time.time_ns)
    """Mission time at the anchor, UTC."""
    anchor_ns: int = field(default_factory=time.monotonic_ns)
    """Monotonic wall time at the anchor; the same for all processes of one machine."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise ConfigError(f"rate: expected mission seconds per wall second, above 0, got {self.rate}")

    def now_ns(self) -> int:
        return self.start_ns + round((time.monotonic_ns() - self.anchor_ns) * self.rate)

    def elapsed_s(self) -> float:
        return (time.monotonic_ns() - self.anchor_ns) * 1e-9 * self.rate

    async def sleep(self, duration_s: float) -> None:
        await asyncio.sleep(max(0.0, duration_s) / self.rate)


class VirtualClock:
    """Time that moves only when it is set: for simulations and replay in a plain loop."""

    rate = float("inf")

    def __init__(self, start_ns: int = 0) -> None:
        self._start_ns = start_ns
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def elapsed_s(self) -> float:
        return (self._now_ns - self._start_ns) * 1e-9

    def advance_to(self, t_ns: int) -> None:
        """Move on to `t_ns`; moving back is ignored."""
        self._now_ns = max(self._now_ns, t_ns)

    async def sleep(self, duration_s: float) -> None:
        self._now_ns += round(max(0.0, duration_s) * 1e9)
        await asyncio.sleep(0)


def wall_s() -> float:
    """Wall seconds for measuring how long something took; never for deciding what a mission does."""
    return time.perf_counter()


def awake_or_not_s() -> float:
    """Wall seconds that go on while the computer sleeps; for noticing that it has slept."""
    return _since_boot_ns() * 1e-9


def utc_stamp() -> str:
    """The present moment as a sortable name for a folder, UTC: 20260102T030405Z."""
    return time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())


def wall_sleep(duration_s: float) -> None:
    """Block the calling thread; for shells around hardware and child processes, never in an event loop."""
    time.sleep(max(0.0, duration_s))


def cpu_s() -> float:
    """CPU seconds of this process so far, for measuring what something costs."""
    return time.process_time()
