"""Is a vehicle fit for a mission? Its position, readiness to arm, battery, clock and link, from what it says.

What it does by itself when something fails is judged in `failsafes`.
"""

import math

from drivers.mavlink.timesync import ClockOffset
from drivers.mavlink.vehicle import Vehicle
from fieldkit.checks import Check, Level

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


def condition(
    vehicle: Vehicle, now_s: float, asked_s: float = math.inf, max_age_s: float = 2.0
) -> list[Check]:
    """Position, readiness to arm, battery and link, from what it says by itself. Of two nothing else is reported.

    `asked_s` is when it was asked why it would not arm.
    """
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
        _readiness(vehicle, asked_s),
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


def _readiness(vehicle: Vehicle, asked_s: float) -> Check:
    name = vehicle.robot
    if vehicle.heartbeats == 0:
        return Check(name, "arming", "red", "never heard", "is it on, does it send to this address?")
    said = dict.fromkeys(text for t_s, text, _ in vehicle.texts if t_s >= asked_s and "PreArm" in text)
    if vehicle.healthy_to_arm is False or said:  # a simulator's bit was set before it would have armed
        words = "; ".join(said) or "its pre-arm checks fail, and it does not say why"
        return Check(name, "arming", "red", words, "mend what the vehicle names")
    if vehicle.armed:
        return Check(name, "arming", "green", "armed")
    if vehicle.healthy_to_arm is None:
        return Check(name, "arming", "amber", "does not say whether it would arm", "wait, and check again")
    return Check(name, "arming", "green", "ready to arm")


def _battery(vehicle: Vehicle) -> Check:
    if vehicle.battery_pct is None:
        return Check(vehicle.robot, "battery", "amber", "unknown", "set up its battery monitor")
    level: Level = "green" if vehicle.battery_pct >= LOW_BATTERY_PCT else "amber"
    remedy = "" if level == "green" else "charge or change it"
    volts = "" if vehicle.battery_v is None else f", {vehicle.battery_v:.1f} V"
    return Check(vehicle.robot, "battery", level, f"{vehicle.battery_pct:.0f} %{volts}", remedy)


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
        return Check(robot, "signing", "amber", "cannot be determined: it does not answer TIMESYNC")
    return Check(robot, "signing", "green", "answers signed frames alone")
