"""Limits no command passes: one object a concern, made once from mission.toml.

What the planning kernel keeps as well (battery, radio, heights) is the same object there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

from fieldkit import settings as given
from fieldkit.geometry.polygons import NOWHERE, KeepOut, Polygon


@dataclass(frozen=True, slots=True)
class BatteryLimits:
    """When a robot has to go home for its battery's sake."""

    reserve_pct: float = given.BATTERY_RESERVE_PCT.default
    """What must be left when it is home again."""
    pct_per_m: float = given.BATTERY_PCT_PER_M.default
    """What a metre costs; half as much again is kept for the way home. 0 where it is not known: no path is too long."""
    low_v: float = given.BATTERY_LOW_V.default
    """A robot whose battery has sunk to this goes home; 0: only per cent are watched."""


@dataclass(frozen=True, slots=True)
class RadioLimits:
    """How long a robot may be without its radio."""

    timeout_s: float = given.RADIO_TIMEOUT_S.default
    """After that it holds, and is planned for no more: its team goes on without it."""
    return_s: float = given.RADIO_RETURN_S.default
    """After that it goes home."""


@dataclass(frozen=True, slots=True)
class SafetySettings:
    """Limits no command passes. Defaults and their meaning stand in `fieldkit.settings`.

    The fence is that of `keep_out`, or the field's rectangle where it has none. Way-points stay `fence_margin_m`
    inside it and off closed ground.
    """

    robots: tuple[str, ...]
    size_east_m: float
    size_north_m: float
    fence_margin_m: float = given.FENCE_MARGIN_M.default
    max_speed_m_s: float = given.MAX_SPEED_M_S.default
    max_leg_m: float = given.MAX_LEG_M.default
    pose_timeout_s: float = given.POSE_TIMEOUT_S.default
    min_separation_m: float = given.MIN_SEPARATION_M.default
    vertical_separation_m: float = given.VERTICAL_SEPARATION_M.default
    keep_out: KeepOut = NOWHERE
    overrun_s: float = given.OVERRUN_S.default
    radio: RadioLimits = field(default_factory=RadioLimits)
    stall_s: float = given.STALL_S.default
    call_after_s: float = given.CALL_AFTER_S.default
    battery: BatteryLimits = field(default_factory=BatteryLimits)
    braking_m: float = 0.0
    """How far a robot rolls on after it was ordered to hold."""
    turn_radius_m: float = given.TURN_RADIUS_M.default
    """The circle that robots on wheels turn in; 0: they turn on the spot."""
    altitude_m: Mapping[str, float] = field(default_factory=dict, hash=False)
    """Robots that fly, and how high."""
    on_foot: frozenset[str] = frozenset()
    """Those that are people: they may come near each other, stand, and walk as fast as they like. Robots avoid them."""

    @property
    def near_m(self) -> float:
        """Robots nearer than this are too near: half the separation of way-points."""
        return 0.5 * self.min_separation_m

    def turns_in_m(self, robot: str) -> float:
        """The radius that one robot turns in: what flies turns on the spot, and people do."""
        return 0.0 if robot in self.altitude_m or robot in self.on_foot else self.turn_radius_m

    @property
    def bounds(self) -> KeepOut:
        """What robots must keep out of, fence included, without a margin."""
        return _bounds(self.keep_out, self.size_east_m, self.size_north_m, 0.0)

    @property
    def margins(self) -> KeepOut:
        """The same with the margin that way-points keep."""
        return _bounds(self.keep_out, self.size_east_m, self.size_north_m, self.fence_margin_m)

    @property
    def fence(self) -> KeepOut:
        """The fence alone, with that margin."""
        bare = replace(self.keep_out, polygons=())
        return _bounds(bare, self.size_east_m, self.size_north_m, self.fence_margin_m)

    def closed_too(self, area_m: Polygon) -> "SafetySettings":
        """The same with one more area closed."""
        return replace(self, keep_out=self.keep_out.also(area_m))

    def forbids_closing(self, area_m: Polygon) -> str:
        """Why an area must not be closed while robots are out; empty where it may be."""
        if self.closed_too(area_m).margins.leaves_room:
            return ""
        return "no ground would be left for a robot to be on: nothing was closed. HOLD ALL stops everybody"


@lru_cache(maxsize=64)
def _bounds(keep_out: KeepOut, east_m: float, north_m: float, margin_m: float) -> KeepOut:
    rectangle = ((0.0, 0.0), (east_m, 0.0), (east_m, north_m), (0.0, north_m))
    return replace(keep_out, fence=keep_out.fence or rectangle, margin_m=margin_m)
