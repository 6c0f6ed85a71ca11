"""A sniffer dongle as a `Receiver`: one channel, or several in turn with every dwell in the recording.

Never verified on the devices themselves: written from the firmwares' documents and host tools.
"""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.links import ByteLink, UsbIdentity, arrival_ns, open_link, port_of, usb_identity
from drivers.options import PORT, checked
from drivers.sniffers.ieee802154 import frame_id
from drivers.sniffers.nrf import NrfText
from drivers.sniffers.protocol import CHANNELS, Captured, SnifferProtocol
from drivers.sniffers.ti import TiBinary
from drivers.threaded import ThreadedReceiver
from drivers.timebase import DeviceStamps
from fieldkit import settings as given
from fieldkit.errors import ConfigError, DeviceError, DeviceTimeout
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

logger = logging.getLogger(__name__)

COMMAND_GAP_S = 0.02
"""Wall time between commands: the firmwares read them one at a time."""
ANSWER_S = 2.0
"""Wall time within which a dongle must answer something when it is started."""
ASK_AGAIN_S = 30.0
"""Wall time of silence after which it is started again: it may have restarted and forgotten its task.

Starting takes 0.1 s, in which it hears nothing.
"""


@dataclass(frozen=True, slots=True)
class SnifferOptions:
    """What a mission file says of a sniffer dongle."""

    port: str = field(metadata=PORT)
    channel: int = given.CHANNEL
    channels: list[int] | None = None
    """Listen on these in turn, `dwell_s` each, in place of `channel`."""
    dwell_s: float = 1.0
    """Mission time on each channel. A transmission on another channel meanwhile is not heard."""
    baud: int = 921600
    saturation_dbm: float | None = None

    def order(self) -> list[int]:
        return list(self.channels) if self.channels else [self.channel]


def open_nrf(robot: str, options: Mapping[str, Any], around: DriverContext) -> "SnifferReceiver":
    """Nordic's sniffer firmware, not opened yet. Raises `ConfigError`."""
    return _make(robot, options, around, "nRF sniffer", NrfText)


def open_ti(robot: str, options: Mapping[str, Any], around: DriverContext) -> "SnifferReceiver":
    """TI's sniffer firmware, not opened yet. Raises `ConfigError`."""
    return _make(robot, options, around, "TI sniffer", TiBinary)


def _make(
    robot: str,
    given: Mapping[str, Any],
    around: DriverContext,
    name: str,
    protocol: Callable[[], SnifferProtocol],
) -> "SnifferReceiver":
    where = f"receiver of {robot} ({name})"
    options = checked(SnifferOptions, given, where)
    for channel in options.order():
        if isinstance(channel, bool) or channel not in CHANNELS:
            raise ConfigError(f"{where}: option 'channel': expected 11 to 26, got {channel!r}")
    if options.dwell_s <= 0:
        raise ConfigError(f"{where}: option 'dwell_s': expected a positive number, got {options.dwell_s:g}")
    return SnifferReceiver(robot, f"{name} of {robot}", options, around, protocol)


class SnifferReceiver(ThreadedReceiver):
    """Entering starts the capture; closing stops it."""

    def __init__(
        self,
        robot: str,
        name: str,
        options: SnifferOptions,
        around: DriverContext,
        protocol: Callable[[], SnifferProtocol],
    ) -> None:
        super().__init__(robot, name, around)
        self._options = options
        self._make_protocol = protocol
        self._order = options.order()
        self._link: ByteLink | None = None
        self._port = options.port
        self._usb: UsbIdentity | None = None

    def _open_device(self, first: bool) -> str:
        # Plugged in again, a dongle may get another name; only that very dongle is asked anything.
        if not first and self._usb is not None:
            self._port = port_of(self._usb) or self._options.port
        link = self._watch(open_link(self._port, self._options.baud, self._name, self._tap))
        self._protocol, self._stamps = self._make_protocol(), DeviceStamps()
        self._turn, self._channel = 0, self._order[0]
        try:
            self._send(link, self._protocol.start(self._order[0]))
            self._expect_answer(link)
        except DeviceError:
            link.close()
            raise
        except OSError as error:
            link.close()
            raise DeviceError(f"{self._name}: {self._port} takes no commands: {error}") from error
        self._link = link
        self._usb = self._usb or usb_identity(self._port)
        self._read_by(self._read, link)
        channels = ", ".join(str(channel) for channel in self._order)
        return f"{self._name.split(' of ')[0]} on channel {channels}"

    def _close_device(self) -> None:
        self._stop_reading()
        link, self._link = self._link, None
        if link is not None:
            try:
                link.write(self._protocol.stop())
            except OSError:
                logger.debug("%s: gone before it could be stopped", self._name)
            link.close()

    def _send(self, link: ByteLink, commands: list[bytes]) -> None:
        for each in commands:
            link.write(each)
            time.sleep(COMMAND_GAP_S)

    def _expect_answer(self, link: ByteLink) -> None:
        """Wait for a sign of this firmware. Raises `DeviceTimeout` telling another firmware from none."""
        deadline_s, got = time.monotonic() + ANSWER_S, False
        while not self._protocol.recognised and time.monotonic() < deadline_s and not self._closed:
            data = link.read()
            got = got or bool(data)
            for _ in self._protocol.feed(data):
                pass  # captured before it was announced that it listens
        if self._protocol.recognised:
            return
        where = f"{self._port} at {self._options.baud} baud"
        firmware = self._protocol.firmware
        raise DeviceTimeout(
            f"{self._name}: what answers on {where} is not {firmware} firmware; write that firmware to it, "
            "correct `baud`, or choose the driver for what it is"
            if got
            else f"{self._name}: nothing answers on {where}; is this the dongle with {firmware} firmware, "
            "and is `baud` right?"
        )

    # What follows runs in the reader thread.

    def _read(self, link: ByteLink) -> None:
        since_s = self._clock.elapsed_s()
        self._heard_s, self._asked = time.monotonic(), False
        while self._running.is_set():
            try:
                self._take_all(link)
                if not self._alive(link):
                    self._on_lost("the dongle does not answer any more")
                    return
                if len(self._order) > 1 and self._clock.elapsed_s() - since_s > self._options.dwell_s:
                    since_s = self._clock.elapsed_s()
                    self._hop(link)
            except (
                OSError,
                TypeError,
                AttributeError,
            ) as error:  # pyserial: TypeError when closed under a read
                self._on_lost(f"the port went away ({error})")
                return

    def _take_all(self, link: ByteLink) -> None:
        data = link.read()
        t_ns = arrival_ns(link, self._clock)
        if data:
            self._heard_s, self._asked = time.monotonic(), False
        for captured in self._protocol.feed(data) if data else self._protocol.idle():
            self._take(captured, t_ns)

    def _alive(self, link: ByteLink) -> bool:
        """Ask after a long silence; False where even that is not answered."""
        silent_s = time.monotonic() - self._heard_s
        if silent_s > ASK_AGAIN_S and not self._asked:
            self._asked = True
            self._send(link, self._protocol.start(self._channel))
        return silent_s < ASK_AGAIN_S + ANSWER_S

    def _hop(self, link: ByteLink) -> None:
        """Stop, take what was still captured on the old channel, and go on on the next."""
        self._send(link, [self._protocol.stop()])
        self._take_all(link)
        self._turn = (self._turn + 1) % len(self._order)
        self._channel = self._order[self._turn]
        self._send(link, self._protocol.tune(self._channel))
        self._put(ReceiverState(self._clock.now_ns(), self.robot, True, f"now on channel {self._channel}"))

    def _take(self, captured: Captured, t_ns: int) -> None:
        sender = frame_id(captured.psdu)
        if sender is None and captured.psdu[:1] and captured.psdu[0] & 7 == 2:
            return  # an acknowledgement: names nobody, and follows a frame that was heard by itself
        ceiling = self._options.saturation_dbm
        self._give(
            RssReading(
                # USB delivers in bursts; the dongle stamps each frame.
                t_ns=self._stamps.of(captured.device_us * 1000, t_ns),
                robot=self.robot,
                rss_dbm=captured.rss_dbm,
                via="sniffer",
                channel=self._channel,
                frame_id=sender,
                lqi=captured.lqi,
                saturated=ceiling is not None and captured.rss_dbm >= ceiling,
            )
        )
