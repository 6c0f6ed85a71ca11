"""A device's own clock mapped to mission time, by the messages that were least delayed.

Every message arrives late by the link's delay, so arrival minus boot time is the offset plus a delay that is
never negative: the smallest difference of the last minute is nearest to the truth. A window, because the
device's crystal drifts (20 ppm is 1.2 ms a minute).

A device that froze and goes on has a clock that stood still, which looks like a link that has become slow.
Messages alone cannot distinguish the two: `in_doubt` asks for a round trip, `learn` takes its result.
"""

from collections import deque

BUCKET_NS = 5_000_000_000
BUCKETS = 12
DOUBT_NS = 1_000_000_000
"""So much later than the best of the last minute, time after time, and the clock is in doubt."""
INCONSISTENT = 5
"""Messages in a row that must be late by so much."""
CLOCK_JUMP_NS = 5_000_000_000
"""A device's clock and ours may not part further than this between two messages: else it was set, or started anew."""
STILL_NS = 1_000_000_000
"""Messages that say one time while so much of ours goes by come from a clock that stands still."""


class TimeBase:
    """Offset of one device's clock. Times in nanoseconds."""

    def __init__(self) -> None:
        self._buckets: deque[tuple[int, int]] = deque(maxlen=BUCKETS)
        """(bucket number, smallest difference in it)."""
        self._late = 0

    def heard(self, boot_ns: int, arrival_ns: int) -> int:
        """Mission time at which a message stamped `boot_ns`, now arrived, was made."""
        difference, number = arrival_ns - boot_ns, arrival_ns // BUCKET_NS
        if self._buckets and self._buckets[-1][0] == number:
            self._buckets[-1] = (number, min(difference, self._buckets[-1][1]))
        else:
            self._buckets.append((number, difference))
        smallest = min(smallest for _, smallest in self._buckets)
        self._late = self._late + 1 if difference - smallest > DOUBT_NS else 0
        return boot_ns + smallest

    @property
    def in_doubt(self) -> bool:
        """The last messages were all late by more than `DOUBT_NS`: a slow link, or a clock that stood still."""
        return self._late >= INCONSISTENT

    def learn(self, offset_ns: int, now_ns: int) -> None:
        """A round trip has shown the offset (mission time minus boot time): what was known before is forgotten."""
        self.clear()
        self._buckets.append((now_ns // BUCKET_NS, offset_ns))

    def clear(self) -> None:
        """Forget: the device has restarted."""
        self._buckets.clear()
        self._late = 0


class DeviceStamps:
    """Mission time of what one device stamps: never back, never after its arrival, whatever its clock does."""

    def __init__(self) -> None:
        self._time = TimeBase()
        self._last_ns: tuple[int, int] | None = None
        self._stamp_ns = 0
        self._shown_ns = (0, 0)
        """What the device's clock shows, and when a message first came that said so."""

    def of(self, device_ns: int | None, arrival_ns: int) -> int:
        """Of a message stamped `device_ns`; its arrival where it stamps nothing or its clock stands still.

        A clock that is never set may stand still for good: by it all that is heard belonged to where the first was.
        """
        if device_ns is not None and device_ns != self._shown_ns[0]:
            self._shown_ns = device_ns, arrival_ns
        if device_ns is None or arrival_ns - self._shown_ns[1] > STILL_NS:
            self._stamp_ns = max(arrival_ns, self._stamp_ns)
            return self._stamp_ns
        if self._last_ns is not None:
            apart_ns = (device_ns - self._last_ns[0]) - (arrival_ns - self._last_ns[1])
            if abs(apart_ns) > CLOCK_JUMP_NS:
                self._time.clear()
        self._last_ns = (device_ns, arrival_ns)
        self._stamp_ns = max(min(self._time.heard(device_ns, arrival_ns), arrival_ns), self._stamp_ns)
        return self._stamp_ns
