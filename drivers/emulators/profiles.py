"""What the emulated autopilot's firmwares differ in: mode numbers, what they accept, what they are called.

ArduRover and ArduCopter as measured on their simulators (4.7.0-dev); PX4 after its documentation
(px4_custom_mode.h, docs.px4.io), not measured. The copter here flies at one height: it drives like a rover.
"""

from dataclasses import dataclass

from drivers.mavlink.codec import mavlink


def px4_mode(main: int, sub: int = 0) -> int:
    """PX4's custom mode: main mode in the third byte, sub mode in the fourth."""
    return main << 16 | sub << 24


@dataclass(frozen=True, slots=True)
class Profile:
    """One firmware."""

    name: str
    vehicle_type: int
    autopilot: int
    manual: int
    hold: int
    auto: int
    home: tuple[int, ...]
    guided: int
    modes: frozenset[int]
    parameters: tuple[tuple[str, float], ...]
    needs_height: bool = False
    """Position targets without a height are dropped without a word."""
    refuses_outside_fence: bool = False
    """DO_REPOSITION beyond an enabled fence is answered FAILED."""
    modes_in_two_parts: bool = False
    """DO_SET_MODE gives main and sub mode as two parameters."""
    avoids_fence: bool = False
    """Stops short of its own fence and says nothing."""
    pauses: bool = False
    """Knows DO_PAUSE_CONTINUE."""


_ARDUPILOT = (
    ("FS_GCS_ENABLE", 1.0),
    ("FS_GCS_TIMEOUT", 5.0),
    ("FENCE_ENABLE", 0.0),
    ("BATT_FS_LOW_ACT", 2.0),
    ("MAV_GCS_SYSID", 245.0),
)
ROVER = Profile(
    "rover",
    mavlink.MAV_TYPE_GROUND_ROVER,
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    manual=0,
    hold=4,
    auto=10,
    home=(11, 12),
    guided=15,
    modes=frozenset({0, 1, 3, 4, 5, 6, 7, 10, 11, 12, 15}),
    parameters=(*_ARDUPILOT, ("FS_ACTION", 2.0), ("AVOID_ENABLE", 3.0)),
    avoids_fence=True,
)
COPTER = Profile(
    "copter",
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    manual=0,
    hold=17,
    auto=3,
    home=(6, 21),
    guided=4,
    modes=frozenset({0, 2, 3, 4, 5, 6, 9, 16, 17, 21}),
    parameters=_ARDUPILOT,
    needs_height=True,
    refuses_outside_fence=True,
    pauses=True,
)
PX4 = Profile(
    "px4",
    mavlink.MAV_TYPE_GROUND_ROVER,
    mavlink.MAV_AUTOPILOT_PX4,
    manual=px4_mode(1),
    hold=px4_mode(4, 3),
    auto=px4_mode(4, 4),
    home=(px4_mode(4, 5),),
    guided=px4_mode(4, 3),
    modes=frozenset({px4_mode(1), px4_mode(3), px4_mode(4, 3), px4_mode(4, 4), px4_mode(4, 5)}),
    parameters=(("NAV_DLL_ACT", 1.0), ("COM_DL_LOSS_T", 10.0), ("COM_LOW_BAT_ACT", 2.0)),
    modes_in_two_parts=True,
)
PROFILES = {profile.name: profile for profile in (ROVER, COPTER, PX4)}
