"""What the mode numbers in a HEARTBEAT mean, per firmware: 4 is HOLD on a rover and GUIDED on a copter.

Sources: ArduRover `mode.h`, ArduCopter `mode.h`, PX4 `px4_custom_mode.h`.
"""

import math
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
_PX4_TAKEOFF = 4 << 16 | 2 << 24
_PX4_LOITER = 4 << 16 | 3 << 24
_PX4_RETURN = 4 << 16 | 5 << 24
_PX4_LAND = 4 << 16 | 6 << 24


@dataclass(frozen=True, slots=True)
class Firmware:
    """A firmware's numbers for the modes we use: the first of each is the one to ask for."""

    name: str
    guided: tuple[int, ...]
    hold: tuple[int, ...]
    home: tuple[int, ...]
    land: tuple[int, ...] = ()
    overshoot: float = 1.0
    """How much faster than ordered it gets for a moment: it is ordered that much less, for a limit is a limit."""

    def meaning(self, custom_mode: int) -> VehicleMode:
        """Our word for a mode number; where guided and hold share one (PX4), `hold`."""
        if custom_mode in self.hold:
            return "hold"
        if custom_mode in self.home:
            return "return"
        if custom_mode in self.land:
            return "land"
        return "guided" if custom_mode in self.guided else "other"

    def number(self, mode: VehicleMode) -> int:
        """The number to ask for. `ValueError` where the firmware has no such mode."""
        numbers = {"guided": self.guided, "hold": self.hold, "return": self.home, "land": self.land}
        if not numbers.get(mode):
            raise ValueError(f"{self.name} has no mode for {mode}")
        return numbers[mode][0]


ROVER = Firmware("ArduRover", guided=(15,), hold=(4,), home=(11, 12), overshoot=1.25)
"""Simulated 4.7.0-dev: 1.23 m/s ordered 1.0, 1.88 m/s ordered 1.5, for its speed controller has an integrator."""
COPTER = Firmware("ArduCopter", guided=(4,), hold=(17, 5), home=(6, 21), land=(9,), overshoot=1.05)
"""Simulated 4.7.0-dev: 1.55 m/s ordered 1.5."""
PX4 = Firmware(
    "PX4", guided=(_PX4_LOITER, _PX4_TAKEOFF), hold=(_PX4_LOITER,), home=(_PX4_RETURN,), land=(_PX4_LAND,)
)


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


def flies(heartbeat: Message) -> bool:
    """Whether the sender of this HEARTBEAT leaves the ground."""
    return heartbeat.type in _COPTERS


def stop_here(system_id: int) -> Message:
    """PX4's pause: a reposition to nowhere. Its hold mode alone flies on to the last place it was sent to.

    QGroundControl stops PX4 in this way (PX4FirmwarePlugin::pauseVehicle).
    """
    nowhere = (math.nan,) * 4
    flag = mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
    return mavlink.MAVLink_command_long_message(
        system_id, 1, mavlink.MAV_CMD_DO_REPOSITION, 0, -1, flag, 0, *nowhere
    )


def set_mode(system_id: int, firmware: Firmware, mode: VehicleMode, confirmation: int) -> Message:
    """The command that asks for a mode. PX4 wants its number in two parts."""
    number = firmware.number(mode)
    main, sub = (number >> 16 & 0xFF, number >> 24) if firmware is PX4 else (number, 0)
    flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    command = mavlink.MAV_CMD_DO_SET_MODE
    return mavlink.MAVLink_command_long_message(
        system_id, 1, command, confirmation, flag, main, sub, 0, 0, 0, 0
    )
