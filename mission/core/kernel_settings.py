"""What the kernel needs beyond the engine's settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fieldkit import settings as given
from fieldkit.engine.settings import EngineSettings


@dataclass(frozen=True, slots=True)
class KernelSettings:
    """The choices of a mission file that the kernel follows."""

    engine: EngineSettings
    belief: str = "intensity"
    planner: str = "infogain"
    association_window_s: float = given.WINDOW_S.default
    association_lateness_s: float = given.LATENESS_S.default
    max_pose_gap_s: float = given.POSE_GAP_S.default
    arrive_m: float = given.ARRIVE_M.default
    """A robot so near to its way-point has arrived."""
    altitude_m: Mapping[str, float] = field(default_factory=dict, hash=False)
    """Robots that fly, and how high."""
    max_duration_s: float = given.MAX_DURATION_S.default
    sources_expected: int | None = None
    """End when this many are found; None where nobody knows."""
    stop_probability_left: float | None = None
    """End when the probability that a source is left falls below this."""
    stop_after_periods: int | None = None
    """End when nothing more was found in so many planning periods in a row: k_max of RWA and PRWA's Algorithm 2."""
    receiver_down_limit_s: float = given.RADIO_TIMEOUT_S.default
    """A robot whose radio is down for longer is not planned for: its team goes on without it."""
    battery_reserve_pct: float = given.BATTERY_RESERVE_PCT.default
    """What must be left when a robot is home again."""
    battery_pct_per_m: float = 0.0
    """What a metre costs; 0 where it is not known: then no path is too long."""
    idle_limit_s: float = given.IDLE_LIMIT_S
    """End when no robot could be steered for this long: somebody has to look."""
