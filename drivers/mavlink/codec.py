"""MAVLink 2 frames to messages and back, through pymavlink's generated dialect and nothing else of pymavlink.

`pymavlink.mavutil` is never imported: it switches protocol version, addresses and environment variables of
the whole process behind one's back. The ardupilotmega dialect contains common, so PX4 is understood as well.
"""

from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from drivers.mavlink.signing import SIGNATURE_SIZE, Signer
from drivers.mavlink.wire import V1, V2, checksum

mavlink: Any = ardupilotmega
"""The dialect: every module of ours takes it from here."""
AUTOPILOT = 1
"""Component id of a vehicle's autopilot (MAV_COMP_ID_AUTOPILOT1)."""
GROUND_STATION = mavlink.MAV_COMP_ID_MISSIONPLANNER
"""Component id of a ground station, 190."""

Message = Any
"""A `MAVLink_message`: pymavlink generates its classes without types."""


class Packer:
    """Messages of one sender to bytes; numbers them, and signs them where there is a key."""

    def __init__(self, system_id: int, component_id: int, signer: Signer | None = None) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._signer = signer

    def pack(self, message: Message) -> bytes:
        data: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return data if self._signer is None else self._signer.sign(data, message.crc_extra)


class Parser:
    """Bytes of one peer to messages. Damage is counted and skipped, one byte at a time.

    pymavlink's own reader skips a damaged frame by its declared length and good frames with it, and decodes
    before it verifies. Here frames are found and verified first, and pymavlink decodes them.
    """

    def __init__(self, signer: Signer | None = None) -> None:
        self._mav = mavlink.MAVLink(None)
        self._signer = signer
        self._buffer = bytearray()
        self.bad_frames = 0

    def parse(self, data: bytes) -> list[Message]:
        self._buffer += data
        messages = []
        for frame in self._frames():
            if self._signer is not None and (frame[0] != V2 or not self._signer.accepts(frame)):
                continue
            try:
                messages.append(self._mav.decode(bytearray(frame)))
            except (mavlink.MAVError, ValueError, TypeError, IndexError, UnicodeError):
                self.bad_frames += 1
        return messages

    def _frames(self) -> Iterator[bytes]:
        at = 0
        while at < len(self._buffer):
            if self._buffer[at] not in (V2, V1):
                at += 1
                continue
            size = _size(self._buffer, at)
            if size is None or at + size > len(self._buffer):
                break
            frame = bytes(self._buffer[at : at + size])
            if _is_whole(frame):
                at += size
                yield frame
            else:
                self.bad_frames += 1
                at += 1
        del self._buffer[:at]


def _size(buffer: bytearray, at: int) -> int | None:
    """Length of the frame that may start there, with signature; None: too short to tell."""
    if at + 3 > len(buffer):
        return None
    if buffer[at] == V1:
        return 8 + buffer[at + 1]
    return 12 + buffer[at + 1] + (SIGNATURE_SIZE if buffer[at + 2] & 1 else 0)


def _is_whole(frame: bytes) -> bool:
    """Whether its checksum is right. A message that the dialect does not know cannot be checked, nor used."""
    if frame[0] == V2 and frame[2] & ~1:
        return False
    known = mavlink.mavlink_map.get(frame[5] if frame[0] == V1 else int.from_bytes(frame[7:10], "little"))
    end = (6 if frame[0] == V1 else 10) + frame[1]
    return known is not None and checksum(frame[:end], known.crc_extra) == frame[end : end + 2]
