"""What goes over a vehicle link, byte for byte, for the recording; a signing key never.

A key is on the wire in one message only, SETUP_SIGNING (256), which this package does not send. Should another station
send it over a link of ours, the bytes it came in are left out, and what follows on the same link until a message
could have ended.
"""

import re
from collections.abc import Callable

from drivers.mavlink.transport import OnData, Peer, Transport

_KEY = re.compile(rb"\xfd.{6}\x00\x01\x00", re.DOTALL)
"""The head of a MAVLink 2 frame of message 256: magic, six bytes, the number in three, lowest first."""
_HEAD, _LONGEST = 10, 280
"""Bytes of the head, and of the longest MAVLink 2 frame (mavlink.io, packet serialization)."""


class TappedTransport:
    """A transport whose bytes are copied to `tap` with the name of their direction: `NAME/in`, `NAME/out`."""

    def __init__(self, transport: Transport, name: str, tap: Callable[[str, bytes], None]) -> None:
        self._transport, self._name, self._tap = transport, name, tap
        self._left_out = {"in": 0, "out": 0}
        self._tail = {"in": b"", "out": b""}

    @property
    def dropped(self) -> int:
        """Frames that could not leave."""
        return self._transport.dropped

    @property
    def default_peer(self) -> Peer | None:
        """As the transport's own."""
        return self._transport.default_peer

    async def open(self, on_data: OnData) -> None:
        """Open it; every chunk is copied before it is handed on."""

        def copied(data: bytes, peer: Peer) -> None:
            self._copy("in", data)
            on_data(data, peer)

        await self._transport.open(copied)

    def send(self, data: bytes, peer: Peer) -> None:
        """Send, and report it."""
        self._copy("out", data)
        self._transport.send(data, peer)

    async def close(self) -> None:
        """Close it."""
        await self._transport.close()

    def _copy(self, way: str, data: bytes) -> None:
        # A stream may cut a frame's head in two: look at the end of what came before as well.
        if _KEY.search(self._tail[way] + data):
            self._left_out[way] = _LONGEST
        elif self._left_out[way] > 0:
            self._left_out[way] -= len(data)
        else:
            self._tap(f"{self._name}/{way}", data)
        self._tail[way] = (self._tail[way] + data)[-(_HEAD - 1) :]
