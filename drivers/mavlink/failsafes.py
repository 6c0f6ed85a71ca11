"""What a vehicle does by itself when we, its battery or its position fail: its parameters, judged for one mission.

Green means that it would really stop, or come down, by itself. They are read and judged, never set.
Parameter names and meanings: ardupilot.org/rover/docs/parameters.html, ardupilot.org/copter/docs/parameters.html,
docs.px4.io/main/en/advanced_config/parameter_reference.html.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.mavlink.modes import COPTER, PX4, ROVER, Firmware
from fieldkit.checks import Check, Level
from fieldkit.ports import Demands

LONG_FAILSAFE_S, ENDLESS_FAILSAFE_S = 10.0, 30.0
"""Seconds of silence before a failsafe: from the first on amber, from the second on red."""
FENCE_POLYGON = 4
"""FENCE_TYPE's bit."""
IN_HOLD = 1
"""FS_OPTIONS of a rover: the failsafe acts in Hold as well."""
GOES_ON_WITH_PILOT = 16
"""FS_OPTIONS of a copter: in modes that a pilot flies, and Brake counts as one, the failsafe does nothing."""
BOAT = 2
TURNS_WIDER = 1.05
"""A vehicle may turn wider than its mission reckons with, by rounding."""
TERMINATE = 5
"""BATT_FS_LOW_ACT and BATT_FS_CRT_ACT."""

_BATTERY = (
    "BATT_FS_LOW_ACT",
    "BATT_LOW_VOLT",
    "BATT_LOW_MAH",
    "BATT_FS_CRT_ACT",
    "BATT_CRT_VOLT",
    "BATT_CRT_MAH",
)
_FENCE = ("FENCE_ENABLE", "FENCE_TYPE", "FENCE_ACTION", "FENCE_MARGIN")
_GROUND = ("FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "FS_OPTIONS", "FS_EKF_ACTION", "FRAME_CLASS")
_STATION = ("MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "SYSID_MYGCS")
NAMES: dict[Firmware, tuple[str, ...]] = {
    ROVER: (
        *_GROUND, "FS_ACTION", "FS_TIMEOUT", *_FENCE, *_BATTERY, "WP_SPEED", "RTL_SPEED", "WP_RADIUS", "TURN_RADIUS",
        *_STATION,
    ),
    COPTER: (*_GROUND, *_FENCE, *_BATTERY, "WPNAV_SPEED", "WPNAV_RADIUS", "RTL_SPEED", "RTL_ALT", *_STATION),
    PX4: (
        "NAV_DLL_ACT", "COM_DL_LOSS_T", "NAV_RCL_ACT", "GF_ACTION", "COM_LOW_BAT_ACT", "RTL_RETURN_ALT",
        "MPC_XY_CRUISE",
    ),
}  # fmt: skip
"""What to read. Firmware before ArduPilot 4.7 has SYSID_MYGCS in place of MAV_GCS_SYSID."""

Values = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class _Judge:
    """Makes checks of one vehicle."""

    robot: str
    values: Values

    def __getitem__(self, name: str) -> float:
        """A parameter's value; 0 where it is not there."""
        return self.values.get(name) or 0.0

    def check(self, name: str, level: Level, found: str, set_to: str = "") -> Check:
        return Check(self.robot, name, level, found, f"on the vehicle, set {set_to}" if set_to else "")

    def unread(self, name: str, parameter: str, level: Level, set_to: str) -> list[Check]:
        if self.values.get(parameter) is not None:
            return []
        return [self.check(name, level, f"{parameter} cannot be read", set_to)]


def judge(robot: str, firmware: Firmware, values: Values, own_id: int, demands: Demands) -> list[Check]:
    """Failsafe, battery, fence and speed, each green or with what to set."""
    if all(value is None for value in values.values()):
        remedy = (
            "does it want signed frames (signing_key in the mission file)? does the link carry both ways?"
        )
        return [Check(robot, "failsafe", "red", "is heard, and answers nothing that we ask", remedy)]
    judge = _Judge(robot, values)
    silent = {ROVER: _rover, COPTER: _copter, PX4: _px4}[firmware](judge)
    silent += _listens_to_us(judge, firmware, own_id)
    if not any(check.level != "green" for check in silent):
        words = "stops by itself when we fall silent"
        silent = [judge.check("failsafe", "green", silent[0].found if silent else words)]
    return [
        *silent,
        *_battery(judge, firmware),
        *_fence(judge, firmware, demands),
        *_speed(judge, firmware, demands),
        *_turning(judge, firmware, demands),
    ]


def _rover(judge: _Judge) -> list[Check]:
    name, act = "failsafe", judge["FS_ACTION"]
    checks = judge.unread(name, "FS_GCS_ENABLE", "red", "FS_GCS_ENABLE 1")
    checks += judge.unread(name, "FS_ACTION", "red", "FS_ACTION 2 (hold)")
    if not checks and not judge["FS_GCS_ENABLE"]:
        checks.append(
            judge.check(name, "red", "FS_GCS_ENABLE is 0: drives on when we fall silent", "FS_GCS_ENABLE 1")
        )
    if act == 0 and judge.values.get("FS_ACTION") is not None:
        checks.append(
            judge.check(name, "red", "FS_ACTION is 0: does nothing in a failsafe", "FS_ACTION 2 (hold)")
        )
    elif act in (1, 3, 4):
        found = (
            f"FS_ACTION is {act:g}: drives home by itself at {_home_speed(judge):g} m/s when we fall silent"
        )
        if int(judge["FS_OPTIONS"]) & IN_HOLD:
            found += ", also out of Hold (FS_OPTIONS 1)"
        checks.append(judge.check(name, "amber", found, "FS_ACTION 2 (hold)"))
    elif act == 5:
        checks.append(
            judge.check(name, "amber", "FS_ACTION is 5: disarms and rolls out", "FS_ACTION 2 (hold)")
        )
    checks += _delay(judge, judge["FS_GCS_TIMEOUT"] + judge["FS_TIMEOUT"], "FS_GCS_TIMEOUT 5, FS_TIMEOUT 1.5")
    if judge.values.get("FS_EKF_ACTION") in (0.0, 2.0):
        found = f"FS_EKF_ACTION is {judge['FS_EKF_ACTION']:g}: drives on when it does not know where it is"
        checks.append(judge.check(name, "amber", found, "FS_EKF_ACTION 1 (hold)"))
    if judge["FRAME_CLASS"] == BOAT:
        checks.append(
            judge.check(name, "amber", "FRAME_CLASS is 2: a boat drifts in Hold", "FS_ACTION 6 (loiter)")
        )
    return checks


def _home_speed(judge: _Judge) -> float:
    return judge["RTL_SPEED"] or judge["WP_SPEED"]


def _copter(judge: _Judge) -> list[Check]:
    name, act = "failsafe", judge["FS_GCS_ENABLE"]
    checks = judge.unread(name, "FS_GCS_ENABLE", "red", "FS_GCS_ENABLE 5 (land)")
    if not checks and act == 0:
        found = "FS_GCS_ENABLE is 0: flies on when we fall silent"
        checks.append(judge.check(name, "red", found, "FS_GCS_ENABLE 5 (land)"))
    elif act in (1, 2, 3, 6):
        found = (
            f"FS_GCS_ENABLE is {act:g}: flies home at {judge['RTL_ALT'] / 100:g} m by itself when we fall silent, "
            "whoever else does"
        )
        checks.append(
            judge.check(name, "amber", found, "FS_GCS_ENABLE 5 (land), or RTL_ALT of its own for each")
        )
    if act and int(judge["FS_OPTIONS"]) & GOES_ON_WITH_PILOT:
        found = (
            "FS_OPTIONS has 16: held (in Brake) it hovers on when we fall silent, until its battery is empty"
        )
        checks.append(judge.check(name, "amber", found, f"FS_OPTIONS {int(judge['FS_OPTIONS']) & ~16}"))
    checks += _delay(judge, judge["FS_GCS_TIMEOUT"], "FS_GCS_TIMEOUT 5")
    if judge.values.get("FS_EKF_ACTION") == 0:
        found = "FS_EKF_ACTION is 0: flies on when it does not know where it is"
        checks.append(judge.check(name, "amber", found, "FS_EKF_ACTION 1 (land)"))
    if judge.values.get("FRAME_CLASS") == 0:
        checks.append(
            judge.check(name, "red", "FRAME_CLASS is 0: it has no frame", "FRAME_CLASS, FRAME_TYPE")
        )
    if not checks:
        checks.append(judge.check(name, "green", "lands by itself when we fall silent"))
    return checks


def _px4(judge: _Judge) -> list[Check]:
    name, act = "failsafe", judge["NAV_DLL_ACT"]
    checks = judge.unread(name, "NAV_DLL_ACT", "red", "NAV_DLL_ACT 1 (hold)")
    if not checks and act == 0:
        found = "NAV_DLL_ACT is 0: goes on when we fall silent"
        checks.append(judge.check(name, "red", found, "NAV_DLL_ACT 1 (hold)"))
    elif act == 2:
        found = f"NAV_DLL_ACT is 2: goes home by itself (RTL_RETURN_ALT {judge['RTL_RETURN_ALT']:g} m)"
        checks.append(judge.check(name, "amber", found, "NAV_DLL_ACT 1 (hold) or 3 (land)"))
    elif act >= 5:
        found = f"NAV_DLL_ACT is {act:g}: it cuts its motors when we fall silent"
        checks.append(judge.check(name, "amber", found, "NAV_DLL_ACT 1 (hold) or 3 (land)"))
    if judge.values.get("NAV_RCL_ACT") == 0:
        checks.append(
            judge.check(name, "amber", "NAV_RCL_ACT is 0: a lost remote control is ignored", "NAV_RCL_ACT 1")
        )
    return [*checks, *_delay(judge, judge["COM_DL_LOSS_T"], "COM_DL_LOSS_T 5")]


def _delay(judge: _Judge, wait_s: float, set_to: str) -> list[Check]:
    if wait_s <= LONG_FAILSAFE_S:
        return []
    level: Level = "red" if wait_s > ENDLESS_FAILSAFE_S else "amber"
    return [judge.check("failsafe", level, f"waits {wait_s:g} s before its failsafe", set_to)]


def _battery(judge: _Judge, firmware: Firmware) -> list[Check]:
    """A vehicle that acts on an empty battery only acts when it knows what empty is."""
    name = "battery failsafe"
    if firmware is PX4:
        if not judge["COM_LOW_BAT_ACT"]:
            found = "COM_LOW_BAT_ACT is 0: only warns when its battery is low"
            return [judge.check(name, "amber", found, "COM_LOW_BAT_ACT 2")]
        return [judge.check(name, "green", f"COM_LOW_BAT_ACT {judge['COM_LOW_BAT_ACT']:g}")]
    low = (judge["BATT_LOW_VOLT"], judge["BATT_LOW_MAH"])
    if not judge["BATT_FS_LOW_ACT"]:
        unread = judge.values.get("BATT_FS_LOW_ACT") is None
        found = "BATT_FS_LOW_ACT " + (
            "cannot be read" if unread else "is 0: does nothing when its battery is low"
        )
        return [judge.check(name, "amber", found, "BATT_FS_LOW_ACT 2 and BATT_LOW_VOLT")]
    if low == (0.0, 0.0):
        found = "BATT_LOW_VOLT and BATT_LOW_MAH are 0: never finds its battery low"
        return [judge.check(name, "amber", found, "BATT_LOW_VOLT (3.5 V a lithium cell)")]
    if not _is_lower(judge["BATT_CRT_VOLT"], low[0]) or not _is_lower(judge["BATT_CRT_MAH"], low[1]):
        found = (
            f"critical ({judge['BATT_CRT_VOLT']:g} V, {judge['BATT_CRT_MAH']:g} mAh) is not below low "
            f"({low[0]:g} V, {low[1]:g} mAh): it refuses to arm"
        )
        return [judge.check(name, "red", found, "BATT_CRT_VOLT and BATT_CRT_MAH lower, or 0")]
    for own, limit in (("BATT_FS_LOW_ACT", "low"), ("BATT_FS_CRT_ACT", "critical")):
        if judge[own] == TERMINATE:
            found = f"{own} is {TERMINATE}: it cuts its motors when its battery is {limit}"
            return [judge.check(name, "amber", found, f"{own} 2")]
    limits = [f"{low[0]:g} V"] if low[0] else []
    limits += [f"{low[1]:g} mAh left"] if low[1] else []
    return [judge.check(name, "green", f"acts at {' or '.join(limits)}")]


def _is_lower(critical: float, low: float) -> bool:
    """ArduPilot's own rule before arming; a limit of 0 is none."""
    return not critical or not low or critical < low


def _fence(judge: _Judge, firmware: Firmware, demands: Demands) -> list[Check]:
    """What it does at a fence of its own; which fence that is, is judged apart."""
    level: Level = "red" if demands.put_fence else "amber"
    if firmware is PX4:
        act = judge["GF_ACTION"]
        if act > 1:
            return [judge.check("fence action", "green", f"GF_ACTION {act:g}")]
        return [
            judge.check(
                "fence action", level, f"GF_ACTION is {act:g}: only warns at its fence", "GF_ACTION 2"
            )
        ]
    if not judge["FENCE_ENABLE"] and not demands.put_fence:
        found = "FENCE_ENABLE is 0: has no fence of its own"
        return [judge.check("fence action", "amber", found, "FENCE_ENABLE 1, or safety.vehicle_fence = true")]
    checks = []
    if not judge["FENCE_ACTION"]:
        found = "FENCE_ACTION is 0: only reports that it leaves its fence"
        checks.append(judge.check("fence action", level, found, "FENCE_ACTION 2"))
    if not int(judge["FENCE_TYPE"]) & FENCE_POLYGON:
        found = f"FENCE_TYPE is {judge['FENCE_TYPE']:g}: does not look at a polygon"
        checks.append(judge.check("fence action", level, found, f"FENCE_TYPE {int(judge['FENCE_TYPE']) | 4}"))
    found = f"FENCE_ACTION {judge['FENCE_ACTION']:g}, margin {judge['FENCE_MARGIN']:g} m"
    return checks or [judge.check("fence action", "green", found)]


def _turning(judge: _Judge, firmware: Firmware, demands: Demands) -> list[Check]:
    """Whether it turns wider than the mission reckons with: it swings to the side before it is on its way."""
    turns_in_m = judge["TURN_RADIUS"] if firmware is ROVER else 0.0
    if demands.turn_radius_m is None or turns_in_m <= TURNS_WIDER * demands.turn_radius_m:
        return []
    found = f"TURN_RADIUS is {turns_in_m:g} m; the mission reckons with {demands.turn_radius_m:.2g} m"
    remedy = f"safety.turn_radius_m = {turns_in_m:g} in the mission file"
    return [Check(judge.robot, "turning", "amber", found, remedy)]


def _speed(judge: _Judge, firmware: Firmware, demands: Demands) -> list[Check]:
    """How fast it goes where we do not order it: in the first moment of each leg, and on its own way home."""
    limit = demands.max_speed_m_s
    scale = 0.01 if firmware is COPTER else 1.0
    own = "WPNAV_SPEED" if firmware is COPTER else "MPC_XY_CRUISE" if firmware is PX4 else "WP_SPEED"
    speeds = {name: scale * judge[name] for name in (own, "RTL_SPEED") if judge[name]}
    fast = {name: speed for name, speed in speeds.items() if speed > limit * 1.001}
    if fast:
        named = ", ".join(f"{name} {speed / scale:g}" for name, speed in fast.items())
        found = f"{named}: by itself it goes at up to {max(fast.values()):g} m/s; the mission's limit is {limit:g}"
        return [judge.check("speed", "amber", found, f"{' and '.join(fast)} {limit / scale:g}")]
    return [
        judge.check(
            "speed", "green", ", ".join(f"{n} {v / scale:g}" for n, v in speeds.items()) or "not known"
        )
    ]


def _listens_to_us(judge: _Judge, firmware: Firmware, own_id: int) -> list[Check]:
    """ArduPilot's failsafe watches the heartbeat of one ground station id, or a range of them."""
    if firmware is PX4:
        return []
    low, high, name = judge.values.get("MAV_GCS_SYSID"), judge.values.get("MAV_GCS_SYSID_HI"), "MAV_GCS_SYSID"
    if low is None:
        low, high, name = judge.values.get("SYSID_MYGCS"), None, "SYSID_MYGCS"
    if low is None or low == own_id or (high is not None and low <= own_id <= high):
        return []
    found = f"{name} is {low:g}, we are {own_id}: its failsafe does not watch for us"
    remedy = f"set {name} to {own_id}, or own_system_id in the mission file"
    return [Check(judge.robot, "failsafe", "red", found, remedy)]
