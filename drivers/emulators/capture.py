"""An 802.15.4 sniffer that writes a capture: TAP packets with received strength, to a file or a live pipe.

Classic pcap (draft-ietf-opsawg-pcap), link type 283; TAP headers as in the specification 1.2.
"""

import contextlib
import os
import struct
from collections.abc import Callable
from pathlib import Path

from drivers.emulators.faults import Rewrite
from drivers.emulators.sniffers import data_frame
from fieldkit import settings as given

TAP = 283
_RSS, _CHANNEL, _LQI = 1, 3, 10


def tap_packet(rss_dbm: float, psdu: bytes, channel: int = given.CHANNEL, lqi: int = 120) -> bytes:
    """Strength, channel and quality before a frame without check bytes."""
    headers = struct.pack("<HHf", _RSS, 4, rss_dbm) + struct.pack("<HHHBx", _CHANNEL, 3, channel, 0)
    headers += struct.pack("<HHB3x", _LQI, 1, lqi)
    return struct.pack("<BBH", 0, 0, 4 + len(headers)) + headers + psdu


def classic_head(link_type: int = TAP) -> bytes:
    """The head of a classic capture with nanoseconds, little-endian."""
    return struct.pack("<IHHiIII", 0xA1B23C4D, 2, 4, 0, 0, 65535, link_type)


def classic_record(t_ns: int, data: bytes) -> bytes:
    """One packet of a classic capture."""
    return struct.pack("<IIII", t_ns // 10**9, t_ns % 10**9, len(data), len(data)) + data


class PipeSniffer:
    """Writes what it hears to a named pipe; `now_ns` is its own clock. Made with `plug`, ended with `unplug`."""

    def __init__(self, path: Path, now_ns: Callable[[], int], channel: int = given.CHANNEL) -> None:
        self.port = str(path)
        self.channel = channel
        self.rewrite: Rewrite | None = None
        """Applied to the next record, once."""
        self._path, self._now_ns = path, now_ns
        self._file = -1
        self._number = 0
        self._held: list[bytes] | None = None

    async def plug(self) -> None:
        """Begin a capture: a pipe, and its head."""
        if not self._path.exists():
            os.mkfifo(self._path)
        # Open for both, so that it can be written before anybody reads.
        self._file = os.open(self._path, os.O_RDWR | os.O_NONBLOCK)
        os.write(self._file, classic_head())

    def unplug(self) -> None:
        """The writer goes; a reader sees the end once it has read everything."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    async def reboot(self) -> None:
        """A new capture in the same pipe."""
        self.unplug()
        await self.plug()

    def pause(self) -> None:
        self._held = []

    def resume(self) -> None:
        held, self._held = self._held or [], None
        for data in held:
            self._write(data)

    def hear(self, rss_dbm: float, sender: int, payload: bytes, *, short_address: bool = False) -> bool:
        """A packet on the air; True if its record is in the pipe."""
        self._number += 1
        psdu = data_frame(sender, payload, self._number, short_address=short_address)
        return self._write(classic_record(self._now_ns(), tap_packet(rss_dbm, psdu, self.channel)))

    def _write(self, data: bytes) -> bool:
        if self._held is not None:
            self._held.append(data)
            return True
        if self.rewrite is not None:
            data, self.rewrite = self.rewrite(data), None
        if self._file < 0:
            return False
        with contextlib.suppress(BlockingIOError):
            return os.write(self._file, data) == len(data)
        return False
