"""What is wrong with one robot, from what is known of it: the rules of safety, each a reason in words. Pure.

Some keep it from being sent anywhere (`unfit`), others only matter to one that is under way (`astray`). A trouble
says what follows when it lasts: home, where the robot is of no more use out there, or a call for the operator.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fieldkit.geometry.polygons import NOWHERE, KeepOut
from fieldkit.geometry.segments import Place, Way, standing
from fieldkit.messages import Pose, ReceiverState, VehicleState

LONG_AGO_NS = -(2**62)
JUMP_SLACK_M = 0.5
SETTLE_S = 3.0
"""After an implausible position, this long without another one before they are believed again."""
FADING_S = 15.0
"""A vehicle's own failsafe has stopped it by then, whatever it has heard."""
SMOOTH_S = 1.0
SLOW_M_S = 0.15
"""Slower than this is noise in the positions."""
OBEYS_S = 2.5
"""A robot has turned to its new way by then, if its order has got through."""
AHEAD_S = 1.0
"""A position from further in the future than this comes from a clock that is wrong."""


@dataclass(frozen=True, slots=True)
class SafetySettings:
    """Limits no command passes. The fence is the field's rectangle, `fence_margin_m` inside its border.

    `keep_out` holds what lies outside a fence polygon too.
    """

    robots: tuple[str, ...]
    size_east_m: float
    size_north_m: float
    fence_margin_m: float = 0.2
    max_speed_m_s: float = 0.4
    max_leg_m: float = 1_000.0
    pose_timeout_s: float = 2.0
    min_separation_m: float = 0.5
    keep_out: KeepOut = NOWHERE
    overrun_s: float = 3.0
    """Robots hold when the steering loop was silent for longer than this."""
    radio_timeout_s: float = 10.0
    """A robot whose radio is down for longer holds: it learns nothing by driving."""
    radio_return_s: float = 120.0
    """... and after this long goes home."""
    stall_s: float = 15.0
    """A robot that should have moved for this long and has not is stuck."""
    call_after_s: float = 30.0
    """A robot that had to be held for this long needs the operator."""
    battery_reserve_pct: float = 25.0
    battery_pct_per_m: float = 0.0
    """What a metre costs; half as much again is kept for the way home. 0 where it is not known."""

    @property
    def near_m(self) -> float:
        """Robots nearer than this are too near: half the separation of way-points."""
        return 0.5 * self.min_separation_m


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why a robot must not move, and what follows when that lasts."""

    kind: Literal["position", "link", "battery", "radio", "fence", "near", "stuck", "late"]
    """A trouble of another kind lasts from when it began, not from when the robot was first held."""
    reason: str
    then: Literal["operator", "return"] = "operator"
    after_s: float | None = None
    """When it follows; None: after the settings' `call_after_s`."""


@dataclass(slots=True)
class Watched:
    """What is known of one robot."""

    name: str
    pose: Pose | None = None
    vehicle: VehicleState | None = None
    home_m: Place | None = None
    """Where it was first seen."""
    target: Way | None = None
    """Our last word to it was this way; None: to hold, or nothing."""
    ordered: str = ""
    """A standing order that only the operator lifts: "hold", "return", "release" or "withdraw"."""
    radio_down_ns: int | None = None
    jumped_ns: int = LONG_AGO_NS
    held_ns: int = LONG_AGO_NS
    troubled_ns: int | None = None
    """Since when it has had to be held, for the present kind of trouble."""
    trouble: str = ""
    """That kind."""
    called: bool = False
    """The operator has been called about the present trouble."""
    too_near: bool = False
    progress_m: Place = (0.0, 0.0)
    progress_ns: int = LONG_AGO_NS
    """Where and when it was last seen to get on."""
    fading: Way | None = None
    """The way it was on when it was told to stop."""
    stopped_ns: int = LONG_AGO_NS
    now_ns: int = 0
    """The last tick."""
    velocity_m_s: Place = (0.0, 0.0)
    """East and north, smoothed over about a second."""
    sent_ns: int = LONG_AGO_NS
    """When it was given the way it is on."""
    ours: bool = False
    """We have sent it somewhere."""

    @property
    def moving(self) -> bool:
        return self.target is not None

    @property
    def place_m(self) -> Place | None:
        return None if self.pose is None else (self.pose.east_m, self.pose.north_m)

    @property
    def set_out_m(self) -> Place | None:
        """Where it was when it was sent."""
        return None if self.target is None else self.target.start_m

    @property
    def holds(self) -> bool:
        """The vehicle itself says that it holds."""
        return self.vehicle is not None and self.vehicle.mode == "hold" and self.vehicle.link_up

    @property
    def somebody_elses(self) -> bool:
        """Somebody else steers it: it is not ours to stop. Of one that is not heard nobody knows."""
        return self.vehicle is not None and self.vehicle.link_up and self.vehicle.mode == "other"

    def way(self) -> Way | None:
        """What is left of its way; None where its place is not known.

        One that was told to stop is taken to drive on until it says that it holds, or for `FADING_S`.
        """
        here = self.place_m
        if here is None:
            return None
        drives = self.target
        if drives is None and not self.holds and (self.now_ns - self.stopped_ns) * 1e-9 < FADING_S:
            drives = self.fading
        return standing(here) if drives is None else Way(here, drives.end_m, drives.speed_m_s)

    def ways(self) -> tuple[Way, ...]:
        """All that it may be doing: one told to stop may have stopped already, or drive on."""
        way, here = self.way(), self.place_m
        if way is None or here is None:
            return ()
        return (way,) if self.moving or way.length_m == 0 else (way, standing(here))

    def unseen(self, settings: SafetySettings) -> Way | None:
        """Where it may be, if its position is old: anywhere on what it can have driven since, until it is seen again.

        None while its position is good, and where it stood when that was lost.
        """
        here, drives = self.place_m, self.target
        if self.pose is None or here is None:
            return None
        if (self.now_ns - self.pose.t_ns) * 1e-9 <= settings.pose_timeout_s:
            return None
        if drives is None and (self.pose.t_ns - self.stopped_ns) * 1e-9 < FADING_S:
            drives = self.fading  # told to stop, and not seen to stand
        if drives is None:
            return None
        way = Way(here, drives.end_m, drives.speed_m_s)
        return replace(way, end_m=way.at(FADING_S)) if way.length_m else None

    @property
    def strays(self) -> bool:
        """It drives, but not where it was sent: its order has not got through, and it goes on with an older one."""
        way = self.way()
        if self.target is None or way is None or way.length_m < JUMP_SLACK_M:
            return False
        if (self.now_ns - self.sent_ns) * 1e-9 < OBEYS_S:
            return False
        (east, north), (v_east, v_north) = way.start_m, self.velocity_m_s
        speed_m_s = math.hypot(v_east, v_north)
        forward_m = v_east * (way.end_m[0] - east) + v_north * (way.end_m[1] - north)
        return speed_m_s >= SLOW_M_S and forward_m < 0.5 * speed_m_s * way.length_m

    def drift(self, ahead_s: float) -> Way | None:
        """Where it will be soon, by how it has moved; for those that others steer, or nobody."""
        here = self.place_m
        if here is None:
            return None
        speed_m_s = math.hypot(*self.velocity_m_s)
        if speed_m_s < SLOW_M_S:
            return standing(here)
        east, north = (p + ahead_s * v for p, v in zip(here, self.velocity_m_s, strict=True))
        return Way(here, (east, north), speed_m_s)

    def see(self, pose: Pose, settings: SafetySettings) -> None:
        """Take in a position. One that is no number is dropped; one out of reach is kept but not trusted."""
        if not all(map(math.isfinite, (pose.east_m, pose.north_m))):
            self.jumped_ns = pose.t_ns
            return
        if self.pose is not None:
            apart_m = math.dist(self.place_m or (0, 0), (pose.east_m, pose.north_m))
            passed_s = max(0.0, (pose.t_ns - self.pose.t_ns) * 1e-9)
            reach_m = JUMP_SLACK_M + 3.0 * settings.max_speed_m_s * passed_s + 6.0 * pose.sigma_m
            if apart_m > reach_m:
                self.jumped_ns = pose.t_ns
                self.velocity_m_s = (0.0, 0.0)
            elif passed_s > 0:
                share = passed_s / (passed_s + SMOOTH_S)
                moved = (pose.east_m - self.pose.east_m, pose.north_m - self.pose.north_m)
                self.velocity_m_s = tuple(  # type: ignore[assignment]
                    v + share * (d / passed_s - v) for v, d in zip(self.velocity_m_s, moved, strict=True)
                )
        self.pose = pose
        self.home_m = self.home_m or (pose.east_m, pose.north_m)
        self._get_on(pose, settings)

    def _get_on(self, pose: Pose, settings: SafetySettings) -> None:
        """Note progress: a fifth of the way that it should have made in the time for a stall, or almost there."""
        way = self.way()
        if self.target is None or way is None:
            return
        here = way.start_m
        should_m = max(0.1, 0.2 * min(self.target.speed_m_s * settings.stall_s, way.length_m))
        if way.length_m < max(0.5, settings.near_m) or math.dist(here, self.progress_m) >= should_m:
            self.progress_m, self.progress_ns = here, pose.t_ns

    def hear(self, state: ReceiverState) -> None:
        """Its radio came up or went down."""
        if state.up:
            self.radio_down_ns = None
        elif self.radio_down_ns is None:
            self.radio_down_ns = state.t_ns

    def send(self, way: Way, now_ns: int) -> None:
        """It has been given a way."""
        if self.target is None or math.dist(self.target.end_m, way.end_m) > 0.01:
            self.progress_m, self.progress_ns = self.place_m or way.start_m, now_ns
            self.sent_ns = now_ns
        self.target, self.ours = way, True

    def stop(self) -> None:
        """It has been told to hold."""
        if self.target is not None:
            self.fading, self.stopped_ns = self.target, self.now_ns
        self.target = None


def trouble_of(robot: Watched, settings: SafetySettings, now_ns: int) -> Trouble | None:
    """Why this robot must not move; None when it may."""
    return unfit(robot, settings, now_ns) or (astray(robot, settings, now_ns) if robot.moving else None)


def unfit(robot: Watched, settings: SafetySettings, now_ns: int) -> Trouble | None:
    """What keeps a robot from being sent anywhere."""
    if reason := _position_fault(robot, settings, now_ns):
        return Trouble("position", reason)
    if robot.vehicle is not None and not robot.vehicle.link_up:
        return Trouble("link", f"its link is down: {robot.vehicle.text}".rstrip(": "))
    if reason := low_battery(robot, settings):
        return Trouble("battery", reason, "return", 0.0)
    if robot.radio_down_ns is not None:
        down_s = (now_ns - robot.radio_down_ns) * 1e-9
        if down_s > settings.radio_timeout_s:
            reason = f"its radio is down for {down_s:.0f} s"
            # By its own time: other troubles may come in between.
            return Trouble("radio", reason, "return", 0.0 if down_s >= settings.radio_return_s else math.inf)
    return None


def astray(robot: Watched, settings: SafetySettings, now_ns: int) -> Trouble | None:
    """What stops a robot that is under way."""
    pose = robot.pose
    if pose is None:
        return Trouble("position", "its position is unknown")
    # One that set out from outside is on its way in.
    if _outside(robot.place_m, pose, settings) and not _outside(robot.set_out_m, pose, settings):
        return Trouble(
            "fence",
            f"it is outside the fence, at {pose.east_m:.1f} m east, {pose.north_m:.1f} m north",
            after_s=0.0,
        )
    if settings.keep_out.contains(np.array([[pose.east_m, pose.north_m]]))[0]:
        return Trouble("fence", "it has entered ground it must keep out of", after_s=0.0)
    if robot.too_near:
        return Trouble(
            "near", f"it is, or would soon be, nearer than {settings.near_m:.2f} m to another robot"
        )
    if reason := _stall(robot, settings, now_ns):
        return Trouble("stuck", reason, after_s=0.0)
    return None


def _position_fault(robot: Watched, settings: SafetySettings, now_ns: int) -> str:
    if robot.pose is None:
        return "its position is unknown"
    age_s = (now_ns - robot.pose.t_ns) * 1e-9
    if age_s > settings.pose_timeout_s:
        return f"its position is {age_s:.1f} s old (limit {settings.pose_timeout_s:.1f} s)"
    if age_s < -AHEAD_S:
        return f"its position is from {-age_s:.1f} s in the future: a clock is wrong"
    if (now_ns - robot.jumped_ns) * 1e-9 < SETTLE_S:
        return "its position jumped further than it can drive"
    return ""


def _outside(place: Place | None, pose: Pose, settings: SafetySettings) -> bool:
    slack_m = 3.0 * max(pose.sigma_m, 0.02)
    east_m, north_m = place or (0.0, 0.0)
    return not (
        -slack_m <= east_m <= settings.size_east_m + slack_m
        and -slack_m <= north_m <= settings.size_north_m + slack_m
    )


def _stall(robot: Watched, settings: SafetySettings, now_ns: int) -> str:
    """Sent somewhere, and for long not got on: a rover that its own fence has stopped says nothing else."""
    way = robot.way()
    stood_s = (now_ns - robot.progress_ns) * 1e-9
    if way is None or stood_s <= settings.stall_s:
        return ""
    return f"it has not moved for {stood_s:.0f} s, {way.length_m:.1f} m before its way-point: stuck?"


def low_battery(robot: Watched, settings: SafetySettings) -> str:
    """Why its battery sends it home; empty while there is more than the reserve."""
    if robot.vehicle is None or robot.vehicle.battery_pct is None:
        return ""
    left_pct, reserve_pct = robot.vehicle.battery_pct, reserve_of(robot, settings)
    if left_pct > reserve_pct:
        return ""
    return f"its battery is at {left_pct:.0f} %, its reserve is {reserve_pct:.0f} %"


def reserve_of(robot: Watched, settings: SafetySettings) -> float:
    """Battery, in percent, that it must keep here: half as much again as the way home costs, or the least reserve."""
    here, home = robot.place_m, robot.home_m
    way_m = 0.0 if here is None or home is None else math.dist(here, home)
    return max(settings.battery_reserve_pct, 1.5 * way_m * settings.battery_pct_per_m)
