"""What the emulated autopilot's firmwares differ in: mode numbers, what they accept, what they are called.

ArduRover and ArduCopter as measured on their simulators (4.7.0-dev); PX4 after its documentation
(px4_custom_mode.h, docs.px4.io), not measured. Parameters are those of a vehicle set up as docs/hardware.md says.
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
    starts_in: int = 0
    """The mode after a boot."""
    blind: int = 0
    """The mode it falls into when it does not know where it is."""
    modes_in_two_parts: bool = False
    """DO_SET_MODE gives main and sub mode as two parameters."""
    avoids_fence: bool = False
    """Stops short of its own fence and says nothing."""
    pauses: bool = False
    """Knows DO_PAUSE_CONTINUE."""


_ARDUPILOT = (
    ("FS_GCS_ENABLE", 1.0),
    ("FS_GCS_TIMEOUT", 5.0),
    ("FS_OPTIONS", 0.0),
    ("FS_EKF_ACTION", 1.0),
    ("FRAME_CLASS", 1.0),
    ("FENCE_ENABLE", 0.0),
    ("FENCE_TYPE", 4.0),
    ("FENCE_ACTION", 2.0),
    ("FENCE_MARGIN", 2.0),
    ("BATT_FS_LOW_ACT", 2.0),
    ("BATT_LOW_VOLT", 10.6),
    ("BATT_LOW_MAH", 0.0),
    ("BATT_FS_CRT_ACT", 0.0),
    ("BATT_CRT_VOLT", 0.0),
    ("BATT_CRT_MAH", 0.0),
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
    parameters=(
        *_ARDUPILOT,
        ("FS_ACTION", 2.0),
        ("FS_TIMEOUT", 1.5),
        ("AVOID_ENABLE", 3.0),
        ("WP_SPEED", 0.0),
        ("RTL_SPEED", 0.0),
        ("WP_RADIUS", 2.0),
        ("TURN_RADIUS", 0.9),
    ),
    starts_in=4,
    blind=4,
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
    parameters=(
        *(each for each in _ARDUPILOT if each[0] != "FS_GCS_ENABLE"),
        ("FS_GCS_ENABLE", 5.0),
        ("WPNAV_SPEED", 0.0),
        ("WPNAV_RADIUS", 200.0),
        ("RTL_SPEED", 0.0),
        ("RTL_ALT", 1500.0),
    ),
    starts_in=0,
    blind=9,
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
    parameters=(
        ("NAV_DLL_ACT", 1.0),
        ("COM_DL_LOSS_T", 10.0),
        ("NAV_RCL_ACT", 1.0),
        ("GF_ACTION", 2.0),
        ("COM_LOW_BAT_ACT", 2.0),
        ("RTL_RETURN_ALT", 30.0),
        ("MPC_XY_CRUISE", 0.0),
        ("NAV_ACC_RAD", 0.1),
    ),
    starts_in=px4_mode(4, 3),
    blind=px4_mode(4, 3),
    modes_in_two_parts=True,
)
PROFILES = {profile.name: profile for profile in (ROVER, COPTER, PX4)}
