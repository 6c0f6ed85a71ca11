"""A pcap or pcapng capture of 802.15.4, from a file or a live pipe, as a `Receiver`."""

import logging
import math
import os
import select
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.links import READ_TIMEOUT_S
from drivers.options import REMEDY, checked
from drivers.sniffers.capture import CaptureError, CaptureReader, Packet
from drivers.sniffers.ieee802154 import frame_id
from drivers.sniffers.strength import (
    TAP,
    WITH_FCS,
    WITHOUT_FCS,
    Strength,
    from_status_bytes,
    from_tap,
    has_real_fcs,
)
from drivers.threaded import ThreadedReceiver
from fieldkit.errors import DeviceError
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

logger = logging.getLogger(__name__)

FIRST_WAIT_S = 5.0
AGAIN_WAIT_S = 0.3
"""Wall time in which a pipe must show its first bytes, at first and when it is opened again."""
CLOCK_BACK_NS = 1_000_000
"""Packets of one capture may be this much out of order."""
LOOK_AT = 5
"""Packets of type 195 looked at before deciding that their check bytes are real."""


@dataclass(frozen=True, slots=True)
class PcapOptions:
    """What a mission file says of a capture."""

    port: str = field(metadata={REMEDY: 'write which capture, as in port = "capture.pcap", or a named pipe'})
    """Path of a capture file or a named pipe."""
    channel: int | None = None
    """Channel of the capture, where its packets do not say."""
    saturation_dbm: float | None = None


def open_capture(robot: str, options: Mapping[str, Any], around: DriverContext) -> "PcapReceiver":
    """A capture as a receiver, not opened yet. Raises `ConfigError`."""
    return PcapReceiver(robot, checked(PcapOptions, options, f"receiver of {robot} (pcap)"), around)


class PcapReceiver(ThreadedReceiver):
    """Readings carry the capture's own times. Down at a file's end, and when a pipe's writer goes."""

    def __init__(self, robot: str, options: PcapOptions, around: DriverContext) -> None:
        super().__init__(robot, f"capture of {robot}", around)
        self._options = options
        self._file: int | None = None
        self._is_pipe = False
        self._pending: list[Packet] = []
        self._damage = ""
        self._last_ns = 0
        self._went_back = False
        self.without_strength = 0
        """Packets that say nothing of their strength."""
        self.malformed = 0

    def _open_device(self, first: bool) -> str:
        path = Path(self._options.port)
        try:
            self._is_pipe = path.is_fifo()
            self._file = os.open(
                path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
            )
        except OSError as error:
            raise DeviceError(
                f"{self._name}: {path}: {error.strerror}; expected a capture file or a pipe"
            ) from error
        try:
            self._begin(FIRST_WAIT_S if first else AGAIN_WAIT_S)
        except DeviceError:
            self._close_device()
            raise
        self._read_by(self._read)
        return f"capture {path.name}"

    def _begin(self, wait_s: float) -> None:
        """Read the head: a pipe nobody writes to, or another kind of file, is no receiver that is up."""
        self._reader = CaptureReader()
        self._real_fcs = self._looked = 0
        deadline_s = time.monotonic() + wait_s
        while not (head := self._chunk()):
            if not self._is_pipe or time.monotonic() > deadline_s or self._closed:
                nobody = "nobody writes to this pipe" if self._is_pipe else "the file is empty"
                raise DeviceError(f"{self._name}: {self._options.port}: {nobody}")
            if head is not None:
                time.sleep(READ_TIMEOUT_S)
        self._pending, self._damage = [], ""
        try:
            for packet in self._reader.feed(head):
                self._pending.append(packet)
        except CaptureError as error:
            if not self._pending:
                raise DeviceError(f"{self._name}: {self._options.port}: {error}") from error
            self._damage = f"not readable any further: {error}"

    def _close_device(self) -> None:
        self._stop_reading()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    # What follows runs in the reader thread.

    def _read(self) -> None:
        for packet in self._pending:
            self._take(packet)
        if self._damage:
            self._end(self._damage)
            return
        while self._running.is_set():
            if (data := self._chunk()) is None:
                continue
            if not data:
                self._end("the capture has ended")
                return
            try:
                for packet in self._reader.feed(data):
                    self._take(packet)
            except CaptureError as error:
                self._end(f"not readable any further: {error}")
                return

    def _chunk(self) -> bytes | None:
        """What is there to read: None for nothing yet, empty at the end."""
        assert self._file is not None
        if self._is_pipe and not select.select([self._file], [], [], READ_TIMEOUT_S)[0]:
            return None
        try:
            return os.read(self._file, 65536)
        except BlockingIOError:
            return None

    def _end(self, reason: str) -> None:
        """Down for good: a file does not come back; a pipe is opened again for its next writer."""
        if self._is_pipe:
            self._on_lost(reason)
        else:
            self._put(ReceiverState(self._clock.now_ns(), self.robot, False, reason), always=True)

    def _take(self, packet: Packet) -> None:
        strength = self._strength(packet)
        if strength is None:
            self.malformed += 1
            return
        rss_dbm = strength.rss_dbm
        if rss_dbm is None or not math.isfinite(rss_dbm) or not -200.0 < rss_dbm < 0.0:
            self.without_strength += 1
            if self.without_strength == 1:
                logger.warning(
                    "%s: packets without received strength (link type %d)", self._name, packet.link_type
                )
            return
        sender = frame_id(strength.psdu)
        if sender is None and strength.psdu[:1] and strength.psdu[0] & 7 == 2:
            return  # an acknowledgement
        ceiling = self._options.saturation_dbm
        self._give(
            RssReading(
                t_ns=self._in_order(packet.t_ns or self._clock.now_ns()),
                robot=self.robot,
                rss_dbm=rss_dbm,
                via="tap" if packet.link_type == TAP else "sniffer",
                channel=strength.channel if strength.channel is not None else self._options.channel,
                frame_id=sender,
                lqi=strength.lqi,
                saturated=ceiling is not None and rss_dbm >= ceiling,
            )
        )

    def _in_order(self, t_ns: int) -> int:
        """The packet's time, or the last one's where the capture's clock has gone back; that is said."""
        back_ns = self._last_ns - t_ns
        if back_ns > CLOCK_BACK_NS and not self._went_back:
            words = f"the capture's clock went back by {back_ns * 1e-9:.1f} s: times stand still until it has caught up"
            self._put(ReceiverState(self._last_ns, self.robot, True, words))
        self._went_back = back_ns > CLOCK_BACK_NS
        self._last_ns = max(self._last_ns, t_ns)
        return self._last_ns

    def _strength(self, packet: Packet) -> Strength | None:
        if packet.link_type == TAP:
            return from_tap(packet.data)
        if packet.link_type == WITHOUT_FCS:
            return Strength(None, packet.data)
        if packet.link_type != WITH_FCS:
            return None
        # One true check sequence among the first few packets says that there are no status bytes.
        if self._looked < LOOK_AT:
            self._looked += 1
            self._real_fcs += has_real_fcs(packet.data)
        return Strength(None, packet.data[:-2]) if self._real_fcs else from_status_bytes(packet.data)
