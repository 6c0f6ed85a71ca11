"""What is wrong with one robot, from what is known of it: the rules of safety, each a reason in words. Pure.

Some keep it from being sent anywhere (`not_ready`), others only matter to one that is under way
(`under_way_trouble`). A trouble says what follows when it lasts: home, where the robot is of no more use out there, or
a call for the operator.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

from fieldkit.geometry.segments import Place, Segment, standing
from fieldkit.geometry.turns import Path, turning
from fieldkit.messages import Pose, ReceiverState, VehicleState
from mission.safety.limits import SafetySettings

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
"""A robot has turned to its new segment by then, if its order has got through."""
AHEAD_S = 1.0
"""A position from further in the future than this comes from a clock that is wrong."""
OUT_SIGMAS = 3.0
"""A robot may be this many standard deviations of its position outside before it counts as outside."""
COARSE_SHARE = 0.25
"""A position less sure than this share of the field is of no use for the fence or for another robot."""
OUT_S = 1.5
"""... and is, when it has been for so long: one bad position is no reason to stop."""
FAST_SHARE = 1.25
FAST_SLACK_M_S = 0.2
"""Faster than the limit by this share and this much is more than the noise of positions."""
FAST_S = 3.0
FAST_NOISE_M_S = 0.5
"""The noise of positions forgives this much at the most: the less sure they are, the longer speed is averaged."""
SAID_S = 2.0
"""A vehicle's own word on its speed counts for so long."""
ACQUIRE_S = 10.0
"""A vehicle that the operator has asked to be acquired anew may show its old mode for so long."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """Why a robot must not move, and what follows when that lasts."""

    kind: Literal["position", "link", "battery", "radio", "fence", "near", "fast", "stuck", "late"]
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
    target: Segment | None = None
    """Our last word to it was this segment; None: to hold, or nothing."""
    holds_since_ns: int = LONG_AGO_NS
    """When it first said that it holds."""
    ordered: str = ""
    """A standing order that only the operator lifts: "hold", "return", "release" or "withdraw"."""
    radio_down_ns: int | None = None
    radio_why: str = ""
    """What its receiver says of being down."""
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
    fading: Segment | None = None
    """The segment it was on when it was ordered to stop."""
    stopped_ns: int = LONG_AGO_NS
    now_ns: int = 0
    """The last tick."""
    velocity_m_s: Place = (0.0, 0.0)
    """East and north, smoothed over about a second."""
    pace_m_s: Place = (0.0, 0.0)
    """East and north, smoothed over as long as the noise of its positions asks for."""
    says_heading: bool = False
    """Its positions come with a heading: some sources know none, and say 0 throughout."""
    sent_ns: int = LONG_AGO_NS
    """When it was given the segment it is on."""
    ours: bool = False
    """We have sent it somewhere."""
    outside_m: float = 0.0
    """How far outside the bounds it is, beyond what its position may be off; 0 inside."""
    out_ns: int | None = None
    """Since when."""
    set_out_outside_m: float = 0.0
    """How far outside it was when it was sent where it goes."""
    fast_ns: int | None = None
    """Since when it has been faster than the limit."""
    late: str = ""
    """Why the steering loop is late at this tick; empty where it is not."""
    resumed_ns: int = LONG_AGO_NS
    """When the operator last asked for it to go on."""
    has_agent: bool = False
    """A computer of its own steers it on where it is not heard: nothing stops it before the end of its way."""

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
    def seen_to_hold(self) -> bool:
        """It holds, and its position is from then: one from before says not where it came to stand."""
        return self.holds and self.pose is not None and self.pose.t_ns >= self.holds_since_ns

    @property
    def somebody_elses(self) -> bool:
        """Somebody else steers it: it is not ours to stop. Of one that is not heard nobody knows."""
        return self.vehicle is not None and self.vehicle.link_up and self.vehicle.mode == "other"

    def segment(self) -> Segment | None:
        """What is left of its segment; None where its place is not known.

        One that was ordered to stop is taken to drive on until it has been seen since it held, or for `FADING_S`.
        """
        here = self.place_m
        if here is None:
            return None
        drives = self.target
        if drives is None and not self.seen_to_hold and (self.now_ns - self.stopped_ns) * 1e-9 < FADING_S:
            drives = self.fading
        return standing(here) if drives is None else Segment(here, drives.end_m, drives.speed_m_s)

    def segments(self) -> tuple[Segment, ...]:
        """All that it may be doing: one ordered to stop may have stopped already, or drive on."""
        segment, here = self.segment(), self.place_m
        if segment is None or here is None:
            return ()
        return (segment,) if self.moving or segment.length_m == 0 else (segment, standing(here))

    def unseen(self, settings: SafetySettings) -> Segment | None:
        """Where it may be, if its position is old: anywhere on what it can have driven since, until it is seen again.

        None while its position is good, and where it stood when that was lost.
        """
        here, drives = self.place_m, self.target
        if self.pose is None or here is None:
            return None
        if (self.now_ns - self.pose.t_ns) * 1e-9 <= settings.pose_timeout_s:
            return None
        if drives is None and (self.pose.t_ns - self.stopped_ns) * 1e-9 < FADING_S:
            drives = self.fading  # ordered to stop, and not seen to stand
        if drives is None:
            return None
        segment = Segment(here, drives.end_m, drives.speed_m_s)
        if self.has_agent or segment.length_m == 0:
            return segment if segment.length_m else None
        return replace(segment, end_m=segment.at(FADING_S))

    @property
    def strays(self) -> bool:
        """It drives, but not where it was sent: its order has not got through, and it goes on with an older one."""
        segment = self.segment()
        if self.target is None or segment is None or segment.length_m < JUMP_SLACK_M:
            return False
        if (self.now_ns - self.sent_ns) * 1e-9 < OBEYS_S:
            return False
        (east, north), (v_east, v_north) = segment.start_m, self.velocity_m_s
        speed_m_s = math.hypot(v_east, v_north)
        forward_m = v_east * (segment.end_m[0] - east) + v_north * (segment.end_m[1] - north)
        return speed_m_s >= SLOW_M_S and forward_m < 0.5 * speed_m_s * segment.length_m

    def lags(self, within_s: float) -> bool:
        """It was sent on its way no longer ago than that, and does not make half its speed yet."""
        if self.target is None or (self.now_ns - self.sent_ns) * 1e-9 > within_s:
            return False
        return math.hypot(*self.velocity_m_s) < 0.5 * self.target.speed_m_s

    @property
    def heading_deg(self) -> float | None:
        """Where it looks, clockwise from north: as it says, or as it drives; None where neither shows it."""
        if self.pose is not None and self.says_heading:
            return self.pose.heading_deg
        if math.hypot(*self.velocity_m_s) < SLOW_M_S:
            return None
        return math.degrees(math.atan2(*self.velocity_m_s))

    def way(self, segment: Segment, settings: SafetySettings) -> Segment | Path:
        """How it drives `segment`, from where it looks now."""
        return turning(segment, self.heading_deg, settings.turns_in_m(self.name))

    def drift(self, ahead_s: float) -> Segment | None:
        """Where it will be soon, by how it has moved; for those that others steer, or nobody."""
        here = self.place_m
        if here is None:
            return None
        speed_m_s = math.hypot(*self.velocity_m_s)
        if speed_m_s < SLOW_M_S:
            return standing(here)
        east, north = (p + ahead_s * v for p, v in zip(here, self.velocity_m_s, strict=True))
        return Segment(here, (east, north), speed_m_s)

    def see(self, pose: Pose, settings: SafetySettings) -> None:
        """Take in a position. One that is no number is dropped; one out of reach is kept but not trusted."""
        if not all(map(math.isfinite, (pose.east_m, pose.north_m, pose.sigma_m))):
            self.jumped_ns = pose.t_ns
            return
        if self.pose is not None:
            apart_m = math.dist((self.pose.east_m, self.pose.north_m), (pose.east_m, pose.north_m))
            passed_s = max(0.0, (pose.t_ns - self.pose.t_ns) * 1e-9)
            reach_m = JUMP_SLACK_M + 3.0 * settings.max_speed_m_s * passed_s + 6.0 * pose.sigma_m
            if apart_m > reach_m:
                self.jumped_ns = pose.t_ns
                self.velocity_m_s = self.pace_m_s = (0.0, 0.0)
            elif passed_s > 0:
                moved = (pose.east_m - self.pose.east_m, pose.north_m - self.pose.north_m)
                self.velocity_m_s = _smoothed(self.velocity_m_s, moved, passed_s, SMOOTH_S)
                self.pace_m_s = _smoothed(self.pace_m_s, moved, passed_s, _steady_s(pose.sigma_m))
        self.pose = pose
        self.says_heading = self.says_heading or pose.heading_deg != 0.0
        self.home_m = self.home_m or (pose.east_m, pose.north_m)
        self._get_on(pose, settings)
        self._mind_bounds(pose, settings)
        self._mind_speed(pose, settings)

    def _mind_bounds(self, pose: Pose, settings: SafetySettings) -> None:
        """Note how far outside it is, and since when."""
        slack_m = OUT_SIGMAS * max(pose.sigma_m, 0.02)
        self.outside_m = max(0.0, -settings.bounds.clearance_m((pose.east_m, pose.north_m)) - slack_m)
        if self.outside_m == 0.0:
            self.out_ns = None
        elif self.out_ns is None:
            self.out_ns = pose.t_ns

    def drives_m_s(self, pose: Pose) -> float:
        """How fast it is at `pose`, its last: by its positions or by its own word, whichever is more."""
        seen_m_s = math.hypot(*self.pace_m_s) - 3.0 * pose.sigma_m / _steady_s(pose.sigma_m)
        said = self.vehicle
        if said is None or said.speed_m_s is None or abs(pose.t_ns - said.t_ns) * 1e-9 > SAID_S:
            return seen_m_s
        return max(seen_m_s, said.speed_m_s)

    def _mind_speed(self, pose: Pose, settings: SafetySettings) -> None:
        """Note since when it is faster than the limit, by more than its positions may be off."""
        if self.drives_m_s(pose) <= FAST_SHARE * settings.max_speed_m_s + FAST_SLACK_M_S:
            self.fast_ns = None
        elif self.fast_ns is None:
            self.fast_ns = pose.t_ns

    def _get_on(self, pose: Pose, settings: SafetySettings) -> None:
        """Note progress: a fifth of the segment that it should have made in the time for a stall, or almost there."""
        segment = self.segment()
        if self.target is None or segment is None:
            return
        here = segment.start_m
        should_m = max(0.1, 0.2 * min(self.target.speed_m_s * settings.stall_s, segment.length_m))
        if segment.length_m < max(0.5, settings.near_m) or math.dist(here, self.progress_m) >= should_m:
            self.progress_m, self.progress_ns = here, pose.t_ns

    def hear_vehicle(self, state: VehicleState) -> None:
        """Its vehicle says what it does."""
        held, self.vehicle = self.holds, state
        if self.holds and not held:
            self.holds_since_ns = state.t_ns

    def hear(self, state: ReceiverState) -> None:
        """Its radio came up or went down."""
        self.radio_why = "" if state.up else state.reason
        if state.up:
            self.radio_down_ns = None
        elif self.radio_down_ns is None:
            self.radio_down_ns = state.t_ns

    def send(self, segment: Segment, now_ns: int) -> None:
        """It has been given a segment."""
        if self.target is None or math.dist(self.target.end_m, segment.end_m) > 0.01:
            self.progress_m, self.progress_ns = self.place_m or segment.start_m, now_ns
            self.sent_ns, self.set_out_outside_m = now_ns, self.outside_m
        self.target, self.ours = segment, True

    def stop(self) -> None:
        """It has been ordered to hold."""
        if self.target is not None:
            self.fading, self.stopped_ns = self.target, self.now_ns
        self.target = None


def _smoothed(before: Place, moved_m: Place, passed_s: float, over_s: float) -> Place:
    """A velocity with one more step taken in, averaged over about `over_s`."""
    share = passed_s / (passed_s + over_s)
    east, north = (v + share * (d / passed_s - v) for v, d in zip(before, moved_m, strict=True))
    return east, north


def _steady_s(sigma_m: float) -> float:
    """Over so long a speed must be averaged that three deviations of its positions stay below `FAST_NOISE_M_S`."""
    return max(SMOOTH_S, 3.0 * sigma_m / FAST_NOISE_M_S)


def trouble_of(robot: Watched, settings: SafetySettings, now_ns: int) -> Trouble | None:
    """Why this robot must not move; None when it may."""
    return not_ready(robot, settings, now_ns) or (
        under_way_trouble(robot, settings, now_ns) if robot.moving else None
    )


def not_ready(robot: Watched, settings: SafetySettings, now_ns: int) -> Trouble | None:
    """What keeps a robot from being sent anywhere."""
    if reason := position_fault(robot, settings, now_ns):
        return Trouble("position", reason)
    if robot.vehicle is not None and not robot.vehicle.link_up:
        return Trouble("link", f"its link is down: {robot.vehicle.text}".rstrip(": "))
    if reason := low_battery(robot, settings):
        return Trouble("battery", reason, "return", 0.0)
    if robot.radio_down_ns is not None:
        down_s = (now_ns - robot.radio_down_ns) * 1e-9
        if down_s > settings.radio.timeout_s:
            reason = f"its radio is down for {down_s:.0f} s"
            # By its own time: other troubles may come in between.
            return Trouble("radio", reason, "return", 0.0 if down_s >= settings.radio.return_s else math.inf)
    return None


def under_way_trouble(robot: Watched, settings: SafetySettings, now_ns: int) -> Trouble | None:
    """What stops a robot that is under way."""
    pose = robot.pose
    if pose is None:
        return Trouble("position", "its position is unknown")
    if is_out(robot, settings):
        return Trouble(
            "fence",
            f"it is outside the fence or on closed ground, {robot.outside_m:.1f} m deep, at {pose.east_m:.1f} m east, "
            f"{pose.north_m:.1f} m north",
        )
    if robot.name in settings.on_foot:
        return None
    if robot.too_near:
        return Trouble(
            "near", f"it is, or would soon be, nearer than {settings.near_m:.2f} m to another robot"
        )
    if reason := too_fast(robot, settings):
        return Trouble("fast", reason)
    if reason := _stall(robot, settings, now_ns):
        return Trouble("stuck", reason, after_s=0.0)
    return None


def too_fast(robot: Watched, settings: SafetySettings) -> str:
    """Faster than the limit, for a while; empty where it is not."""
    pose = robot.pose
    if robot.fast_ns is None or pose is None or (pose.t_ns - robot.fast_ns) * 1e-9 < FAST_S:
        return ""
    limit_m_s = settings.max_speed_m_s
    return (
        f"it drives {robot.drives_m_s(pose):.1f} m/s where the limit is {limit_m_s:.1f}: it ignores our speed"
    )


def is_out(robot: Watched, settings: SafetySettings) -> bool:
    """Whether it is out of bounds: for a while, or deeper than it can have rolled. One on its way back in is not."""
    pose = robot.pose
    if robot.out_ns is None or pose is None:
        return False
    slack_m = max(pose.sigma_m, 0.02)
    if robot.set_out_outside_m > 0.0 and robot.outside_m <= robot.set_out_outside_m + slack_m:
        return False
    lasted_s = (pose.t_ns - robot.out_ns) * 1e-9
    return lasted_s >= OUT_S or robot.outside_m > settings.braking_m + 0.5


def position_fault(robot: Watched, settings: SafetySettings, now_ns: int) -> str:
    """Why nobody knows where it is; empty where its position can be relied on."""
    if robot.pose is None:
        return "its position is unknown"
    age_s = (now_ns - robot.pose.t_ns) * 1e-9
    if age_s > settings.pose_timeout_s:
        return f"its position is {age_s:.1f} s old (limit {settings.pose_timeout_s:.1f} s)"
    if age_s < -AHEAD_S:
        return f"its position is from {-age_s:.1f} s in the future: a clock is wrong"
    side_m = min(settings.size_east_m, settings.size_north_m)
    if robot.pose.sigma_m > COARSE_SHARE * side_m and robot.name not in settings.on_foot:
        return f"its position is good to {robot.pose.sigma_m:.1f} m only, in a field of {side_m:g} m"
    if (now_ns - robot.jumped_ns) * 1e-9 < SETTLE_S:
        return "its position jumped further than it can drive"
    return ""


def _stall(robot: Watched, settings: SafetySettings, now_ns: int) -> str:
    """Sent somewhere, and for long not got on: a rover that its own fence has stopped says nothing else."""
    segment = robot.segment()
    stood_s = (now_ns - robot.progress_ns) * 1e-9
    if segment is None or stood_s <= settings.stall_s:
        return ""
    return f"it has not moved for {stood_s:.0f} s, {segment.length_m:.1f} m before its way-point: stuck?"


def low_battery(robot: Watched, settings: SafetySettings) -> str:
    """Why its battery sends it home; empty while there is more than the reserve."""
    volts = None if robot.vehicle is None else robot.vehicle.battery_v
    limit_v = settings.battery.low_v
    if limit_v > 0.0 and volts is not None and volts <= limit_v:
        return f"its battery is at {volts:.1f} V, its limit is {limit_v:.1f} V"
    if robot.vehicle is None or robot.vehicle.battery_pct is None:
        return ""
    left_pct, reserve_pct = robot.vehicle.battery_pct, reserve_of(robot, settings)
    if left_pct > reserve_pct:
        return ""
    return f"its battery is at {left_pct:.0f} %, its reserve is {reserve_pct:.0f} %"


def reserve_of(robot: Watched, settings: SafetySettings) -> float:
    """Battery, in percent, that it must keep here: half as much again as the way home costs, or the reserve."""
    here, home = robot.place_m, robot.home_m
    path_m = 0.0 if here is None or home is None else math.dist(here, home)
    return max(settings.battery.reserve_pct, 1.5 * path_m * settings.battery.pct_per_m)
