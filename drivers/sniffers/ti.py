"""TI's packet sniffer firmware on CC1352 / CC2652 (LaunchPad, Sonoff dongle, CatSniffer): binary.

    40 53 | info | length, 2, little-endian | payload | (checksum, not always sent) | 40 45
    data, info C0: payload = time us, 6, little-endian | MAC frame | RSSI dBm, signed | status (80: good)

Found by length, never by the end marker: a payload may contain 40 45. Source: SmartRF Packet Sniffer 2 user
guide, and CatSniffer-Tools for what their firmware leaves out.
"""

from collections.abc import Iterator

from drivers.sniffers.protocol import Captured

START, END = b"\x40\x53", b"\x40\x45"
PING, START_CAPTURE, STOP_CAPTURE, SET_FREQUENCY, SET_PHY = 0x40, 0x41, 0x42, 0x45, 0x47
DATA = 0xC0
CHECK_GOOD = 0x80
PHY_802154 = 0x12
MAX_PAYLOAD = 300
SHORTEST_DATA = 6 + 2 + 2


def command(number: int, data: bytes = b"") -> bytes:
    """A command as sent: the checksum is the sum of everything between the start and itself."""
    body = bytes([number]) + len(data).to_bytes(2, "little") + data
    return START + body + bytes([sum(body) & 0xFF]) + END


def frequency(channel: int) -> bytes:
    """A channel's centre, MHz and fraction: 2405 MHz and 5 MHz a channel from 11 up."""
    return (2405 + 5 * (channel - 11)).to_bytes(2, "little") + bytes(2)


class TiBinary:
    """Finds captured frames by length, and resynchronises on the next start marker that makes sense."""

    firmware = "TI's packet sniffer"

    def __init__(self) -> None:
        self.bad_frames = self.recognised = 0
        self._buffer = bytearray()

    def start(self, channel: int) -> list[bytes]:
        ready = [command(PING), command(STOP_CAPTURE), command(SET_PHY, bytes([PHY_802154]))]
        return ready + self.tune(channel)

    def tune(self, channel: int) -> list[bytes]:
        return [command(SET_FREQUENCY, frequency(channel)), command(START_CAPTURE)]

    def stop(self) -> bytes:
        return command(STOP_CAPTURE)

    def feed(self, data: bytes) -> Iterator[Captured]:
        self._buffer += data
        yield from self._packets(waiting=True)

    def idle(self) -> Iterator[Captured]:
        if self._buffer:
            yield from self._packets(waiting=False)

    def _packets(self, *, waiting: bool) -> Iterator[Captured]:
        while (begin := self._buffer.find(START)) >= 0:
            del self._buffer[:begin]
            size = self._size()
            if size is None and waiting:
                return
            if not size:
                self.bad_frames += 1
                del self._buffer[:2]
                continue
            info, length = self._buffer[2], int.from_bytes(self._buffer[3:5], "little")
            payload = bytes(self._buffer[5 : 5 + length])
            del self._buffer[:size]
            self.recognised += 1
            if info == DATA and (captured := self._captured(payload)) is not None:
                yield captured
        # Half a start marker may be all there is.
        del self._buffer[: -1 if self._buffer.endswith(START[:1]) else None]

    def _size(self) -> int | None:
        """Bytes of the packet at the start of the buffer; 0: it is none; None: too short to tell."""
        if len(self._buffer) < 5:
            return None
        length = int.from_bytes(self._buffer[3:5], "little")
        if length > MAX_PAYLOAD or not self._buffer[2] & 0x80:
            return 0
        end = 5 + length
        if len(self._buffer) < end + 2:
            return None
        if self._buffer[end : end + 2] == END:
            return end + 2
        if len(self._buffer) < end + 3:
            return None
        return end + 3 if self._buffer[end + 1 : end + 3] == END else 0

    def _captured(self, payload: bytes) -> Captured | None:
        if len(payload) < SHORTEST_DATA or not payload[-1] & CHECK_GOOD:
            self.bad_frames += 1
            return None
        rss_dbm = int.from_bytes(payload[-2:-1], "big", signed=True)
        if rss_dbm >= 0:
            self.bad_frames += 1
            return None
        return Captured(float(rss_dbm), payload[6:-2], int.from_bytes(payload[:6], "little"))
