"""The digi-xbee library made a passive listener, on a link that survives damage.

What the library does by itself and a listening robot must not (all verified against digi-xbee 1.5):
it asks every unknown 16-bit sender for its address over the air and blocks 4 s for an answer; it spins
for ever on an unplugged port; after one spurious 7E it understands nothing for up to 32 kB; it can miss the wake-up of
a fast reply; it runs callbacks unordered on a pool of 50 threads; some well-formed frames (reception
without data, odd IO samples) kill its reader thread. Here the library does the opening exchange and runs
the reader thread; received frames are taken out of the stream before it handles them, and decoded with its
packet classes in `decode`.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from digi.xbee.comm_interface import XBeeCommunicationInterface
from digi.xbee.devices import XBeeDevice
from digi.xbee.exception import CommunicationException, TimeoutException
from digi.xbee.models.mode import OperatingMode
from digi.xbee.models.protocol import Role
from digi.xbee.packets.base import XBeeAPIPacket
from digi.xbee.packets.common import ATCommPacket
from digi.xbee.reader import PacketListener

from drivers.links import ByteLink, arrival_ns
from drivers.xbee.frames import Deframer
from fieldkit.clock import Clock

logger = logging.getLogger(__name__)

AT_RESPONSE = 0x88
DB = b"DB"
"""Asked without waiting, so its answer is no reply for the library."""
REPLY_TIMEOUT_S = 1.0
"""A module answers an AT command in milliseconds; at 9600 baud the reply itself takes 30 ms."""


class FrameInterface(XBeeCommunicationInterface):  # type: ignore[misc]  # the library is not typed
    """digi-xbee's view of a `ByteLink`. Each frame carries the time at which its first byte was read."""

    def __init__(
        self,
        opener: Callable[[], ByteLink],
        clock: Clock,
        on_frame: Callable[[int, bytes], None],
        on_lost: Callable[[str], None],
    ) -> None:
        self._opener = opener
        self._clock = clock
        self._on_frame = on_frame
        self._on_lost = on_lost
        self._link: ByteLink | None = None
        self._lost = False
        self._last_ns = 0
        self._deframer = Deframer()
        self._replies: deque[bytes] = deque()
        self._timeout = REPLY_TIMEOUT_S

    def open(self) -> None:
        self._link = self._opener()

    def close(self) -> None:
        """Called by us, and by the library when its reader thread dies: then the radio is lost."""
        if isinstance(threading.current_thread(), PacketListener):
            self._lose("the digi-xbee reader stopped")
        link, self._link = self._link, None
        if link is not None:
            link.close()

    @property
    def is_interface_open(self) -> bool:
        return self._link is not None

    @property
    def skipped_bytes(self) -> int:
        return self._deframer.skipped_bytes

    def wait_for_frame(self, operating_mode: OperatingMode) -> bytearray | None:
        """The next command reply, for the library; everything else goes to `on_frame`, in this thread."""
        if not self._replies:
            self._read_on(operating_mode == OperatingMode.ESCAPED_API_MODE)
        return bytearray(self._replies.popleft()) if self._replies else None

    def _read_on(self, escaped: bool) -> None:
        """Read one chunk. Never raises: the library would spin on one error and die silently of another."""
        link = self._link
        if link is None or self._lost:
            time.sleep(0.02)
            return
        try:
            data = link.read()
            t_ns = self._last_ns = max(self._last_ns, arrival_ns(link, self._clock))
        except (OSError, TypeError, AttributeError) as error:  # pyserial: TypeError when closed under a read
            if self._link is not None:
                self._lose(f"the port went away ({error})")
            return
        feed = (
            self._deframer.feed(data, t_ns, escaped=escaped) if data else self._deframer.idle(escaped=escaped)
        )
        for frame_t_ns, frame in feed:
            if frame[3] != AT_RESPONSE or frame[5:7] == DB:
                self._on_frame(frame_t_ns, frame)
            elif len(frame) >= 9 and frame[5:7].isalnum():  # the library dies of a command that is not text
                self._replies.append(frame)

    def _lose(self, reason: str) -> None:
        if not self._lost:
            self._lost = True
            self._on_lost(reason)

    def quit_reading(self) -> None:
        """Nothing to do: a read ends by itself within `links.READ_TIMEOUT_S`."""

    def write_frame(self, frame: bytearray) -> None:
        if self._link is None:
            raise CommunicationException("the link is closed")
        try:
            self._link.write(bytes(frame))
        except OSError as error:
            raise CommunicationException(str(error)) from error

    @property
    def timeout(self) -> float:
        return self._timeout

    @timeout.setter
    def timeout(self, timeout: float) -> None:
        self._timeout = timeout

    def __str__(self) -> str:
        return "fieldkit link"


class _AtOnce(list[Any]):
    """Stands in for the library's event object: calls in the reader thread instead of on the pool."""

    def __call__(self, packet: XBeeAPIPacket) -> None:
        for function in self:
            function(packet)


class ListenOnly(XBeeDevice):  # type: ignore[misc]  # the library is not typed
    """An XBee that is asked for its settings while opening, and only listened to from then on."""

    def __init__(self, interface: FrameInterface) -> None:
        self._waiting: dict[int, deque[XBeeAPIPacket]] = {}
        self._answered = threading.Condition()
        super().__init__(comm_iface=interface, _sync_ops_timeout=REPLY_TIMEOUT_S)

    def _init_network(self) -> None:
        """No network model: with one, the library queries unknown senders over the air."""

    def _determine_role(self) -> Role:
        """Not asked: a ZigBee module that refuses the question is otherwise set to AO=3 and made to transmit."""
        return Role.UNKNOWN

    def get_xbee_device_callbacks(self) -> _AtOnce:
        return _AtOnce([self._take])

    def _take(self, packet: XBeeAPIPacket) -> None:
        with self._answered:
            if packet.needs_id() and packet.frame_id in self._waiting:
                self._waiting[packet.frame_id].append(packet)
                self._answered.notify_all()

    def _send_packet_sync_and_get_response(
        self, packet_to_send: XBeeAPIPacket, timeout: float | None = None
    ) -> Any:
        """Send and wait, registered before sending: a reply faster than our waiting is not missed."""
        replies: deque[XBeeAPIPacket] = deque()
        with self._answered:
            self._waiting[packet_to_send.frame_id] = replies
        try:
            self._packet_sender.send_packet(packet_to_send)
            with self._answered:
                if not self._answered.wait_for(
                    lambda: bool(replies), REPLY_TIMEOUT_S if timeout is None else timeout
                ):
                    raise TimeoutException("Response not received in the configured timeout.")
                return replies.popleft()
        finally:
            with self._answered:
                self._waiting.pop(packet_to_send.frame_id, None)

    def ask_db(self, number: int) -> None:
        """Ask for the last packet's strength and do not wait: the answer comes as a frame. Transmits nothing."""
        self._packet_sender.send_packet(ATCommPacket(number, DB.decode()))

    def scan_energy(self, parameter: bytes, timeout_s: float) -> bytes:
        """The answer to ED, when the scan is over. Transmits nothing. Raises the library's errors."""
        packet = ATCommPacket(self.get_next_frame_id(), "ED", parameter=bytearray(parameter))
        reply = self._send_packet_sync_and_get_response(packet, timeout_s)
        return bytes(reply.command_value or b"")

    def _determine_operating_mode(self) -> OperatingMode:
        """API mode 1 or 2 as the module says; UNKNOWN if silent. Asked twice: the first may meet noise."""
        for _ in range(2):
            try:
                return OperatingMode.get(self.get_parameter("AP", apply=False)[0])
            except TimeoutException:
                continue
        return OperatingMode.UNKNOWN
