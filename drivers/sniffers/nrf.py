"""Nordic's 802.15.4 sniffer firmware on an nRF52840 (USB 1915:154B): lines of text.

    received: 41881234...  power: -61 lqi: 120 time: 123456789

The hexadecimal ends with the two check bytes; time is microseconds in 32 bits, sometimes printed signed.
Source: Nordic Semiconductor, nrf802154_sniffer.py.
"""

import re
from collections.abc import Iterator

from drivers.sniffers.protocol import Captured, Unwrap32

_LINE = re.compile(rb"received:\s+([0-9a-fA-F]+)\s+power:\s+(-?\d+)\s+lqi:\s+(\d+)\s+time:\s+(-?\d+)\s*$")
MAX_LINE = 600
"""Longest line believed: 127 bytes in hexadecimal, and some prompt around them."""


class NrfText:
    """Finds captured frames between prompts, echoes and half lines."""

    firmware = "Nordic's 802.15.4 sniffer"

    def __init__(self) -> None:
        self.bad_frames = self.recognised = 0
        self._rest = b""
        self._time = Unwrap32()

    def start(self, channel: int) -> list[bytes]:
        # With echo on the shell repeats the next command, which distinguishes it from anything else.
        return [b"shell echo on\r\n", b"sleep\r\n", b"shell echo off\r\n", *self.tune(channel)]

    def tune(self, channel: int) -> list[bytes]:
        return [f"channel {channel}\r\n".encode(), b"receive\r\n"]

    def stop(self) -> bytes:
        return b"sleep\r\n"

    def feed(self, data: bytes) -> Iterator[Captured]:
        text = self._rest + data
        self.recognised += b"sleep" in text or b"~$" in text
        *lines, self._rest = text.split(b"\n")
        if len(self._rest) > MAX_LINE:
            self.bad_frames += 1
            self._rest = b""
        for line in lines:
            if b"received:" in line:
                if (captured := self._captured(line)) is not None:
                    self.recognised += 1
                    yield captured
                else:
                    self.bad_frames += 1

    def idle(self) -> Iterator[Captured]:
        """Nothing: a line's end ends whatever went before."""
        yield from ()

    def _captured(self, line: bytes) -> Captured | None:
        """The last reception on a line: an interrupted one may stand before it."""
        match = _LINE.search(line[line.rindex(b"received:") :].strip())
        if match is None or len(match[1]) % 2 or not 10 <= len(match[1]) <= 254:
            return None
        power, lqi, time = int(match[2]), int(match[3]), int(match[4])
        if not -128 <= power < 0 or lqi > 255 or not -(1 << 31) <= time < 1 << 32:
            return None
        return Captured(float(power), bytes.fromhex(match[1].decode())[:-2], self._time(time), lqi)
