"""A device's own clock mapped to mission time, by the messages that were least delayed.

Every message arrives late by the link's delay, so arrival minus boot time is the offset plus a delay that is
never negative: the smallest difference of the last minute is nearest to the truth. A window, because the
device's crystal drifts (20 ppm is 1.2 ms a minute).
"""

from collections import deque

BUCKET_NS = 5_000_000_000
BUCKETS = 12


class TimeBase:
    """Offset of one device's clock. Times in nanoseconds."""

    def __init__(self) -> None:
        self._buckets: deque[tuple[int, int]] = deque(maxlen=BUCKETS)
        """(bucket number, smallest difference in it)."""

    def heard(self, boot_ns: int, arrival_ns: int) -> int:
        """Mission time at which a message stamped `boot_ns`, now arrived, was made."""
        difference, number = arrival_ns - boot_ns, arrival_ns // BUCKET_NS
        if self._buckets and self._buckets[-1][0] == number:
            self._buckets[-1] = (number, min(difference, self._buckets[-1][1]))
        else:
            self._buckets.append((number, difference))
        return boot_ns + min(smallest for _, smallest in self._buckets)

    def clear(self) -> None:
        """Forget: the device has restarted."""
        self._buckets.clear()
