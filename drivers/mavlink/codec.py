"""MAVLink 2 frames to messages and back, through pymavlink's generated dialect and nothing else of pymavlink.

`pymavlink.mavutil` is never imported: it switches protocol version, addresses and environment variables of
the whole process behind one's back. The ardupilotmega dialect contains common, so PX4 is understood as well.
"""

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

AUTOPILOT = 1
"""Component id of a vehicle's autopilot (MAV_COMP_ID_AUTOPILOT1)."""
GROUND_STATION = mavlink.MAV_COMP_ID_MISSIONPLANNER
"""Component id of a ground station, 190."""

Message = Any
"""A `MAVLink_message`: pymavlink generates its classes without types."""


class Packer:
    """Messages of one sender to bytes; numbers them."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    def pack(self, message: Message) -> bytes:
        data: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


class Parser:
    """Bytes of one peer to messages. Damage is counted and skipped."""

    def __init__(self) -> None:
        self._mav = mavlink.MAVLink(None)
        self._mav.robust_parsing = True
        self.bad_frames = 0

    def parse(self, data: bytes) -> list[Message]:
        try:
            messages = self._mav.parse_buffer(bytearray(data)) or []
        except (mavlink.MAVError, ValueError, TypeError, IndexError, UnicodeError):
            # A frame whose checksum is right and whose content is not: start afresh behind it.
            self._mav = mavlink.MAVLink(None)
            self._mav.robust_parsing = True
            self.bad_frames += 1
            return []
        good = [message for message in messages if message.get_msgId() >= 0]
        self.bad_frames += len(messages) - len(good)
        return good
