"""XBee API frames out of a byte stream that may be damaged: loses only the frames that are.

Frame: 7E, length (2, big-endian), data, checksum = FF - (sum of data & FF). In escaped mode (AP=2) the bytes
7E 7D 11 13 after the first are sent as 7D, byte ^ 20. Source: Digi 90000982 (XBee 802.15.4), "API operation".
"""

from collections.abc import Iterator

START = 0x7E
ESCAPE = 0x7D
ESCAPED_BYTES = (0x7E, 0x7D, 0x11, 0x13)
MAX_LENGTH = 300
"""Longest data part believed. Real ones stay under 130 (802.15.4) or 280 (900HP); damage claims more."""


def frame(data: bytes, *, escaped: bool = False) -> bytes:
    """A whole frame around `data` (frame type and all that follows)."""
    plain = len(data).to_bytes(2, "big") + data + bytes([0xFF - (sum(data) & 0xFF)])
    return bytes([START]) + (escape(plain) if escaped else plain)


def escape(plain: bytes) -> bytes:
    """The bytes as sent in escaped mode."""
    out = bytearray()
    for byte in plain:
        if byte in ESCAPED_BYTES:
            out += bytes([ESCAPE, byte ^ 0x20])
        else:
            out.append(byte)
    return bytes(out)


class Deframer:
    """Takes bytes as they come, with the time of each chunk, and gives whole frames, unescaped.

    A frame's time is that of the chunk that brought its first byte.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._position = 0
        """Stream position of the first byte in the buffer."""
        self._chunks: list[tuple[int, int]] = []
        """(stream position of the chunk's first byte, its time), oldest first."""
        self._quiet = -1
        """Stream position at which the line was last quiet: where something new begins."""
        self.skipped_bytes = 0
        """Bytes that belonged to no good frame."""

    def feed(self, data: bytes, t_ns: int, *, escaped: bool) -> Iterator[tuple[int, bytes]]:
        """(time, frame) for each frame completed by `data`."""
        if data:
            self._chunks.append((self._position + len(self._buffer), t_ns))
            self._buffer += data
        yield from self._frames(escaped, waiting=True)

    def idle(self, *, escaped: bool) -> Iterator[tuple[int, bytes]]:
        """Frames hidden behind a false start, once the line has gone quiet.

        A spurious 7E makes the codec wait for a length that never comes; what follows it may be a good frame.
        """
        if self._buffer:
            yield from self._frames(escaped, waiting=False)
        self._quiet = self._position + len(self._buffer)

    def _frames(self, escaped: bool, *, waiting: bool) -> Iterator[tuple[int, bytes]]:
        start = 0
        keep: int | None = None
        while (start := self._buffer.find(START, start)) >= 0:
            found = self._at(start, escaped)
            if isinstance(found, tuple):
                data, end = found
                anew = self._quiet - self._position
                if start < anew < end and (begun := self._at(anew, escaped)) is not True:
                    # Half a frame before the silence and half one after it, whose checksum fits by chance.
                    if begun is False and waiting:
                        keep = start
                        break
                    if begun is not False:
                        start = anew
                        continue
                t_ns = self._time_of(self._position + start)
                self.skipped_bytes += start
                self._drop(end)
                start, keep = 0, None
                yield t_ns, data
            elif found:
                start += 1
            elif waiting:
                keep = start
                break
            else:
                keep = start if keep is None else keep
                start += 1
        end = len(self._buffer) if keep is None else keep
        self.skipped_bytes += end
        self._drop(end)

    def _at(self, start: int, escaped: bool) -> tuple[bytes, int] | bool:
        """What starts there; see `_plain_at`."""
        if self._buffer[start] != START:
            return True
        return _escaped_at(self._buffer, start) if escaped else _plain_at(self._buffer, start)

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._position += count
        while len(self._chunks) > 1 and self._chunks[1][0] <= self._position:
            del self._chunks[0]
        if not self._buffer:
            self._chunks.clear()

    def _time_of(self, position: int) -> int:
        t_ns = self._chunks[0][1]
        for begin, chunk_t_ns in self._chunks:
            if begin > position:
                break
            t_ns = chunk_t_ns
        return t_ns


def _plain_at(buffer: bytearray, start: int) -> tuple[bytes, int] | bool:
    """(frame, end) if a good frame starts there; True: it never will; False: too short to tell."""
    if len(buffer) < start + 3:
        return False
    length = buffer[start + 1] << 8 | buffer[start + 2]
    if not 0 < length <= MAX_LENGTH:
        return True
    end = start + 3 + length + 1
    if len(buffer) < end:
        return False
    if sum(buffer[start + 3 : end]) & 0xFF != 0xFF:
        return True
    return bytes(buffer[start:end]), end


def _escaped_at(buffer: bytearray, start: int) -> tuple[bytes, int] | bool:
    """As `_plain_at`; a bare 7E can only be a start, so a frame it cuts off is damaged."""
    plain = bytearray([START])
    index, total = start + 1, 3
    while index < len(buffer):
        byte = buffer[index]
        index += 1
        if byte == START:
            return True
        if byte == ESCAPE:
            if index == len(buffer):
                return False
            if buffer[index] == START:
                return True
            byte = buffer[index] ^ 0x20
            index += 1
        plain.append(byte)
        if len(plain) == 3:
            length = plain[1] << 8 | plain[2]
            if not 0 < length <= MAX_LENGTH:
                return True
            total = 3 + length + 1
        elif len(plain) == total and total > 3:
            return (bytes(plain), index) if sum(plain[3:]) & 0xFF == 0xFF else True
    return False
