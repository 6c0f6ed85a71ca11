"""What the mode numbers in a HEARTBEAT mean, per firmware: 4 is HOLD on a rover and GUIDED on a copter.

Sources: ArduRover `mode.h`, ArduCopter `mode.h`, PX4 `px4_custom_mode.h`.
"""

from dataclasses import dataclass

from drivers.mavlink.codec import Message, mavlink
from fieldkit.messages import VehicleMode

_COPTERS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_HELICOPTER,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DODECAROTOR,
    mavlink.MAV_TYPE_DECAROTOR,
)
_PX4_LOITER = 4 << 16 | 3 << 24
_PX4_RETURN = 4 << 16 | 5 << 24


@dataclass(frozen=True, slots=True)
class Firmware:
    """A firmware's numbers for the three modes we use: the first of each is the one to ask for."""

    name: str
    guided: tuple[int, ...]
    hold: tuple[int, ...]
    home: tuple[int, ...]

    def meaning(self, custom_mode: int) -> VehicleMode:
        """Our word for a mode number; where guided and hold share one (PX4), `hold`."""
        if custom_mode in self.hold:
            return "hold"
        if custom_mode in self.home:
            return "return"
        return "guided" if custom_mode in self.guided else "other"

    def number(self, mode: VehicleMode) -> int:
        return {"guided": self.guided, "hold": self.hold, "return": self.home}[mode][0]


ROVER = Firmware("ArduRover", guided=(15,), hold=(4,), home=(11, 12))
COPTER = Firmware("ArduCopter", guided=(4,), hold=(17, 5), home=(6, 21))
PX4 = Firmware("PX4", guided=(_PX4_LOITER,), hold=(_PX4_LOITER,), home=(_PX4_RETURN,))


def firmware_of(heartbeat: Message) -> Firmware | None:
    """Which firmware sent this HEARTBEAT; None for one we do not know how to steer."""
    if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_PX4:
        return PX4
    if heartbeat.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA:
        if heartbeat.type in (mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_TYPE_SURFACE_BOAT):
            return ROVER
        if heartbeat.type in _COPTERS:
            return COPTER
    return None


def set_mode(system_id: int, firmware: Firmware, mode: VehicleMode, confirmation: int) -> Message:
    """The command that asks for a mode. PX4 wants its number in two parts."""
    number = firmware.number(mode)
    main, sub = (number >> 16 & 0xFF, number >> 24) if firmware is PX4 else (number, 0)
    flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    command = mavlink.MAV_CMD_DO_SET_MODE
    return mavlink.MAVLink_command_long_message(
        system_id, 1, command, confirmation, flag, main, sub, 0, 0, 0, 0
    )
