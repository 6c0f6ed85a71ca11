"""Frames out of a pcap or pcapng stream as it grows: packets with their link type and time.

Sources: draft-ietf-opsawg-pcap (classic), draft-ietf-opsawg-pcapng. Lengths are bounded; a record that cannot
be believed ends the stream with `CaptureError`, since what follows has no marker to find.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field

MAX_RECORD = 1 << 16
MAX_BLOCK = 1 << 20

_CLASSIC = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
_SECTION = b"\x0a\x0d\x0d\x0a"
_INTERFACE, _SIMPLE, _ENHANCED = 1, 3, 6


class CaptureError(ValueError):
    """The stream is no capture, or is damaged where it has no marker to resynchronise on."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One captured packet. `t_ns` is UTC, 0 where the format gives none."""

    t_ns: int
    link_type: int
    data: bytes


@dataclass
class _Interface:
    link_type: int
    units_per_s: int = 1_000_000


@dataclass
class CaptureReader:
    """Feed it bytes; it gives packets."""

    _buffer: bytearray = field(default_factory=bytearray)
    _order: str = ""
    _classic: tuple[int, int] | None = None
    """(link type, nanoseconds per fraction unit) of a classic capture."""
    _interfaces: list[_Interface] = field(default_factory=list)

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Packets completed by `data`. Raises `CaptureError`."""
        self._buffer += data
        if not self._order and not self._open():
            return
        while True:
            taken, packet = self._classic_record() if self._classic else self._block()
            if not taken:
                return
            del self._buffer[:taken]
            if packet is not None:
                yield packet

    def _open(self) -> bool:
        if len(self._buffer) < 24:
            return False
        magic = bytes(self._buffer[:4])
        if magic in _CLASSIC:
            self._order, unit_ns = _CLASSIC[magic]
            (link_type,) = struct.unpack_from(self._order + "I", self._buffer, 20)
            self._classic = (link_type & 0x0FFFFFFF, unit_ns)
            del self._buffer[:24]
        elif magic == _SECTION:
            self._set_order()
        else:
            raise CaptureError(f"starts with {magic.hex()}: neither pcap nor pcapng")
        return True

    def _set_order(self) -> None:
        mark = bytes(self._buffer[8:12])
        if mark not in (b"\x4d\x3c\x2b\x1a", b"\x1a\x2b\x3c\x4d"):
            raise CaptureError(f"section header with byte order mark {mark.hex()}")
        self._order = "<" if mark[0] == 0x4D else ">"
        self._interfaces.clear()

    def _classic_record(self) -> tuple[int, Packet | None]:
        if len(self._buffer) < 16:
            return 0, None
        assert self._classic is not None
        link_type, unit_ns = self._classic
        seconds, fraction, length, _ = struct.unpack_from(self._order + "IIII", self._buffer)
        if length > MAX_RECORD:
            raise CaptureError(f"a record of {length} bytes")
        if len(self._buffer) < 16 + length:
            return 0, None
        data = bytes(self._buffer[16 : 16 + length])
        return 16 + length, Packet(seconds * 1_000_000_000 + fraction * unit_ns, link_type, data)

    def _block(self) -> tuple[int, Packet | None]:
        if len(self._buffer) < 12:
            return 0, None
        if self._buffer[:4] == _SECTION:
            self._set_order()
        kind, size = struct.unpack_from(self._order + "II", self._buffer)
        if size % 4 or not 12 <= size <= MAX_BLOCK:
            raise CaptureError(f"a block of {size} bytes")
        if len(self._buffer) < size:
            return 0, None
        body = bytes(self._buffer[8 : size - 4])
        packet = None
        if kind == _INTERFACE and len(body) >= 8:
            self._interfaces.append(self._interface(body))
        elif kind == _ENHANCED and len(body) >= 20:
            packet = self._enhanced(body)
        elif kind == _SIMPLE and len(body) >= 4 and self._interfaces:
            packet = Packet(0, self._interfaces[0].link_type, body[4:])
        return size, packet

    def _interface(self, body: bytes) -> _Interface:
        (link_type,) = struct.unpack_from(self._order + "H", body)
        made, at = _Interface(link_type), 8
        while at + 4 <= len(body):
            code, length = struct.unpack_from(self._order + "HH", body, at)
            if code == 9 and length >= 1 and at + 4 < len(body):  # if_tsresol
                value = body[at + 4]
                made.units_per_s = 2 ** min(value & 0x7F, 40) if value & 0x80 else 10 ** min(value, 12)
            if code == 0:
                break
            at += 4 + (length + 3) // 4 * 4
        return made

    def _enhanced(self, body: bytes) -> Packet | None:
        number, high, low, length, _ = struct.unpack_from(self._order + "IIIII", body)
        if number >= len(self._interfaces) or length > len(body) - 20:
            return None
        interface = self._interfaces[number]
        t_ns = (high << 32 | low) * 1_000_000_000 // interface.units_per_s
        return Packet(t_ns, interface.link_type, body[20 : 20 + length])
