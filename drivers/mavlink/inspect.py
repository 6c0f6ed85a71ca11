"""Is a vehicle fit for a mission? Its failsafes, fence, position, battery, clock and link, read from itself.

Failsafes are what stops a vehicle when everything here has died: they are read, never assumed, and never set.
Parameter names and meanings: ardupilot.org/rover/docs/parameters.html, docs.px4.io/main/en/config/safety.html.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivers.mavlink.modes import COPTER, PX4, ROVER, Firmware
from drivers.mavlink.timesync import ClockOffset
from drivers.mavlink.vehicle import Vehicle
from fieldkit.checks import Check, Level

LONG_FAILSAFE_S = 10.0
LOW_BATTERY_PCT = 50.0
GOOD_EPH = 200
"""HDOP times 100 up to which a fix counts as good."""
EKF_ABSOLUTE = 16
"""EKF_STATUS_REPORT flag: horizontal position, absolute."""
LOSS_AMBER, LOSS_RED = 0.05, 0.5
BOUND_AMBER_MS = 50.0
"""Half a round trip: more than this and receptions need a window wider than 250 ms."""
CLOCK_WRONG_S = 60.0
"""A vehicle's own clock runs up to a second beside GPS time; this much is a computer's that was never set."""

NAMES: dict[Firmware, tuple[str, ...]] = {
    ROVER: (
        "FS_GCS_ENABLE", "FS_ACTION", "FS_GCS_TIMEOUT", "BATT_FS_LOW_ACT", "MAV_GCS_SYSID", "MAV_GCS_SYSID_HI",
        "SYSID_MYGCS",
    ),
    COPTER: (
        "FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "BATT_FS_LOW_ACT", "MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "SYSID_MYGCS",
    ),
    PX4: ("NAV_DLL_ACT", "COM_DL_LOSS_T", "COM_LOW_BAT_ACT"),
}  # fmt: skip
"""What to read. Firmware before ArduPilot 4.7 has SYSID_MYGCS in place of MAV_GCS_SYSID."""

Values = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Rule:
    """One parameter that must not be zero."""

    parameter: str
    level: Level
    what: str
    set_to: str


_RULES: dict[Firmware, tuple[Rule, ...]] = {
    ROVER: (
        Rule("FS_GCS_ENABLE", "red", "drives on when we fall silent", "FS_GCS_ENABLE 1"),
        Rule("FS_ACTION", "red", "does nothing in a failsafe", "FS_ACTION 2 (hold)"),
        Rule("BATT_FS_LOW_ACT", "amber", "does nothing when its battery is low", "BATT_FS_LOW_ACT 1 or 2"),
    ),
    COPTER: (
        Rule("FS_GCS_ENABLE", "red", "flies on when we fall silent", "FS_GCS_ENABLE 1"),
        Rule("BATT_FS_LOW_ACT", "amber", "does nothing when its battery is low", "BATT_FS_LOW_ACT 2"),
    ),
    PX4: (
        Rule("NAV_DLL_ACT", "red", "goes on when we fall silent", "NAV_DLL_ACT 1 (hold)"),
        Rule("COM_LOW_BAT_ACT", "amber", "only warns when its battery is low", "COM_LOW_BAT_ACT 2"),
    ),
}


def failsafes(robot: str, firmware: Firmware, values: Values, own_id: int) -> list[Check]:
    """The vehicle's own failsafes. Red where it would not stop by itself."""
    checks = []
    for rule in _RULES[firmware]:
        value = values.get(rule.parameter)
        if value is None:
            found, level = f"{rule.parameter} cannot be read", rule.level
        elif value == 0:
            found, level = f"{rule.parameter} is 0: {rule.what}", rule.level
        else:
            continue
        checks.append(Check(robot, "failsafe", level, found, f"on the vehicle, set {rule.set_to}"))
    timeout = "COM_DL_LOSS_T" if firmware is PX4 else "FS_GCS_TIMEOUT"
    if (wait_s := values.get(timeout)) is not None and wait_s > LONG_FAILSAFE_S:
        checks.append(
            Check(
                robot, "failsafe", "amber", f"waits {wait_s:g} s before its failsafe", f"set {timeout} to 5"
            )
        )
    checks += _listens_to_us(robot, firmware, values, own_id)
    return checks or [Check(robot, "failsafe", "green", "holds by itself when we fall silent")]


def _listens_to_us(robot: str, firmware: Firmware, values: Values, own_id: int) -> list[Check]:
    """ArduPilot's failsafe watches the heartbeat of one ground station id, or a range of them."""
    if firmware is PX4:
        return []
    low, high = values.get("MAV_GCS_SYSID"), values.get("MAV_GCS_SYSID_HI")
    name = "MAV_GCS_SYSID"
    if low is None:
        low, high, name = values.get("SYSID_MYGCS"), None, "SYSID_MYGCS"
    if low is None:
        return []
    if low == own_id or (high is not None and low <= own_id <= high):
        return []
    found = f"{name} is {low:g}, we are {own_id}: its failsafe does not watch for us"
    return [
        Check(
            robot, "failsafe", "red", found, f"set {name} to {own_id}, or own_system_id in the mission file"
        )
    ]


def condition(vehicle: Vehicle, now_s: float, max_age_s: float = 2.0) -> list[Check]:
    """Position, readiness to arm, battery and link, from what it says by itself. Of two nothing else is told."""
    name = vehicle.robot
    if vehicle.doubles:
        remedy = "give each its own MAV_SYSID (SYSID_THISMAV before 4.7)"
        return [Check(name, "identity", "red", f"two vehicles answer to id {vehicle.system_id}", remedy)]
    firmware = vehicle.firmware.name if vehicle.firmware is not None else "an unknown firmware"
    level: Level = "green" if vehicle.firmware is not None else "red"
    return [
        Check(name, "identity", level, f"system {vehicle.system_id}, {firmware}"),
        _position(vehicle, now_s, max_age_s),
        _estimator(vehicle),
        _readiness(vehicle),
        _battery(vehicle),
        _link(vehicle),
    ]


def _position(vehicle: Vehicle, now_s: float, max_age_s: float) -> Check:
    name, age_s = vehicle.robot, now_s - vehicle.position_s
    fix, eph = vehicle.gps_fix, vehicle.gps_eph
    if not math.isfinite(age_s) or age_s > max_age_s:
        return Check(
            name, "position", "red", "no position", "wait for a GPS fix; is the antenna free to the sky?"
        )
    words = (
        f"fix {fix}, HDOP {eph / 100:.1f}" if fix is not None and eph is not None else "without GPS details"
    )
    if fix is not None and fix < 3:
        return Check(name, "position", "red", words, "wait for a 3-D fix")
    if eph is not None and eph > GOOD_EPH:
        return Check(name, "position", "amber", words, "wait for a better fix, or give it a freer sky")
    return Check(name, "position", "green", words)


def _estimator(vehicle: Vehicle) -> Check:
    if vehicle.ekf_flags is None:
        return Check(vehicle.robot, "EKF", "amber", "does not say", "ask its firmware for EKF_STATUS_REPORT")
    if not vehicle.ekf_flags & EKF_ABSOLUTE:
        return Check(vehicle.robot, "EKF", "red", "has no absolute position", "let it stand until it has")
    return Check(vehicle.robot, "EKF", "green", "knows where it is")


def _readiness(vehicle: Vehicle) -> Check:
    if vehicle.healthy_to_arm is False:
        words = next((text for _, text in reversed(vehicle.texts) if "arm" in text.lower()), "")
        return Check(
            vehicle.robot, "arming", "red", words or "its pre-arm checks fail", "mend what the vehicle names"
        )
    return Check(vehicle.robot, "arming", "green", "armed" if vehicle.armed else "ready to arm")


def _battery(vehicle: Vehicle) -> Check:
    if vehicle.battery_pct is None:
        return Check(vehicle.robot, "battery", "amber", "unknown", "set up its battery monitor")
    level: Level = "green" if vehicle.battery_pct >= LOW_BATTERY_PCT else "amber"
    remedy = "" if level == "green" else "charge or change it"
    return Check(vehicle.robot, "battery", level, f"{vehicle.battery_pct:.0f} %", remedy)


def _link(vehicle: Vehicle) -> Check:
    if not vehicle.link_up:
        return Check(
            vehicle.robot,
            "link",
            "red",
            "no heartbeat",
            "is it on, does it send to the address in the mission file?",
        )
    loss = vehicle.loss
    level: Level = "red" if loss > LOSS_RED else "amber" if loss > LOSS_AMBER else "green"
    return Check(
        vehicle.robot,
        "link",
        level,
        f"{loss:.0%} of its frames are lost",
        "" if level == "green" else "nearer, or a better antenna",
    )


def clock(robot: str, offset: ClockOffset | None) -> Check:
    """How well its clock is known."""
    if offset is None:
        return Check(
            robot, "clock", "amber", "does not answer TIMESYNC", "its poses are stamped when they arrive"
        )
    bound_ms = offset.bound_ns * 1e-6
    level: Level = "green" if bound_ms <= BOUND_AMBER_MS else "amber"
    remedy = "" if level == "green" else "a faster link, or a wider association.window_s"
    return Check(robot, "clock", level, f"known within {bound_ms:.1f} ms", remedy)


def time_of_day(vehicle: Vehicle, signs: bool) -> list[Check]:
    """Our clock against the time that the vehicle has from its GPS, where it says so.

    Signed frames from the future are taken, and from then on none that are older: on a signed link that is red.
    """
    ahead_s = vehicle.utc_ahead_s
    if ahead_s is None:
        return []
    if abs(ahead_s) <= CLOCK_WRONG_S:
        return [Check(vehicle.robot, "time of day", "green", "this computer's clock agrees with its GPS")]
    way = "ahead of" if ahead_s > 0 else "behind"
    found = f"this computer's clock is {abs(ahead_s):,.0f} s {way} its GPS time"
    remedy = "set the clock of this computer"
    if signs:
        remedy += ": signing from the future locks other ground stations out, from the past ourselves"
    return [Check(vehicle.robot, "time of day", "red" if signs else "amber", found, remedy)]


def signing(robot: str, signed: ClockOffset | None, unsigned: ClockOffset | None) -> Check:
    """Whether the vehicle takes signed frames alone, from how it answered TIMESYNC both ways."""
    if unsigned is not None:
        remedy = "set up signing on this port of the vehicle; on USB (SERIAL0) ArduPilot always takes both"
        found = "obeys unsigned frames too: anybody in reach can steer it"
        return Check(robot, "signing", "amber", found, remedy)
    if signed is None:
        return Check(robot, "signing", "amber", "cannot be told: it does not answer TIMESYNC")
    return Check(robot, "signing", "green", "answers signed frames alone")
