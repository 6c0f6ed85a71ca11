"""Parameters of one vehicle: all asked at once, the missing ones again; written ones are read back."""

import math
import struct
from collections.abc import Callable, Sequence

from drivers.mavlink.codec import AUTOPILOT, Message, mavlink
from drivers.mavlink.commands import TRIES, WAIT_S
from drivers.mavlink.modes import PX4, Firmware
from drivers.mavlink.plans import Inbox
from fieldkit.clock import Clock

_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_INT8: "b",
    mavlink.MAV_PARAM_TYPE_UINT8: "B",
    mavlink.MAV_PARAM_TYPE_INT16: "h",
    mavlink.MAV_PARAM_TYPE_UINT16: "H",
    mavlink.MAV_PARAM_TYPE_INT32: "i",
    mavlink.MAV_PARAM_TYPE_UINT32: "I",
}

Send = Callable[[Message], None]


def value_of(message: Message, firmware: Firmware | None) -> float:
    """The number in a PARAM_VALUE. PX4 puts the bytes of an integer where ArduPilot puts its value."""
    form = _INTEGERS.get(message.param_type)
    if firmware is not PX4 or form is None:
        return float(message.param_value)
    raw = struct.pack("<f", message.param_value)
    return float(struct.unpack_from(f"<{form}", raw)[0])


async def read(
    send: Send, inbox: Inbox, clock: Clock, system_id: int, firmware: Firmware | None, names: Sequence[str]
) -> dict[str, float | None]:
    """Name to value as the vehicle has it; None where it does not answer: unknown, or a poor link."""
    found: dict[str, float | None] = dict.fromkeys(names)
    # A rehearsal on a fast clock waits as long by the wall: its emulated vehicle has no more of the machine than we.
    hurry = clock.rate if 1.0 < clock.rate < math.inf else 1.0
    for _ in range(math.ceil(TRIES * hurry)):
        missing = {name for name, value in found.items() if value is None}
        for name in missing:
            send(mavlink.MAVLink_param_request_read_message(system_id, AUTOPILOT, name.encode(), -1))
        deadline_s = clock.elapsed_s() + WAIT_S
        while missing and (left_s := deadline_s - clock.elapsed_s()) > 0:
            message = await inbox.next(left_s)
            if message is not None and message.param_id in missing:
                missing.discard(message.param_id)
                found[message.param_id] = value_of(message, firmware)
        if not missing:
            break
    return found


async def write(send: Send, inbox: Inbox, clock: Clock, system_id: int, name: str, value: float) -> bool:
    """Set a parameter (ArduPilot's way: the value as a float); whether the vehicle says that it has it."""
    kind = mavlink.MAV_PARAM_TYPE_REAL32
    for _ in range(TRIES):
        send(mavlink.MAVLink_param_set_message(system_id, AUTOPILOT, name.encode(), value, kind))
        deadline_s = clock.elapsed_s() + WAIT_S
        while (left_s := deadline_s - clock.elapsed_s()) > 0:
            message = await inbox.next(left_s)
            if message is not None and message.param_id == name:
                if abs(message.param_value - value) < 1e-6:
                    return True
                break
    return False
