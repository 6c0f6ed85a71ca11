"""What a sniffer's serial protocol has to say: commands to send, captured frames to find in the bytes."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

CHANNELS = range(11, 27)
"""802.15.4 in the 2.4 GHz band."""


@dataclass(frozen=True, slots=True)
class Captured:
    """One captured frame."""

    rss_dbm: float
    psdu: bytes
    """The MAC frame without its check bytes."""
    device_us: int
    """The dongle's own time of reception, unwrapped: microseconds since some moment."""
    lqi: int | None = None


class SnifferProtocol(Protocol):
    """One firmware's language. Keeps the state of the byte stream; no clock, no wire."""

    firmware: str
    """What it is called, in errors."""
    bad_frames: int
    recognised: int
    """Things heard that only this firmware says: proof of life."""

    def start(self, channel: int) -> list[bytes]:
        """Commands that make it listen on a channel, each sent on its own. It answers some of them."""
        ...

    def tune(self, channel: int) -> list[bytes]:
        """Commands that make a started and stopped one listen on another channel."""
        ...

    def stop(self) -> bytes:
        """The command that makes it stop."""
        ...

    def feed(self, data: bytes) -> Iterator[Captured]:
        """Frames completed by `data`."""
        ...

    def idle(self) -> Iterator[Captured]:
        """Frames hidden behind a false start, once the line has gone quiet."""
        ...


class Unwrap32:
    """A 32-bit microsecond counter (it wraps every 71.6 minutes, some print it signed) made endless."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._base = 0

    def __call__(self, value: int) -> int:
        value &= 0xFFFFFFFF
        if self._last is not None and value < self._last and self._last - value > 1 << 31:
            self._base += 1 << 32
        self._last = value
        return self._base + value
