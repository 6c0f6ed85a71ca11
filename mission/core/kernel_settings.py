"""What the kernel needs beyond the engine's settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from fieldkit import settings as given
from fieldkit.engine.settings import EngineSettings
from mission.safety.limits import BatteryLimits, RadioLimits


@dataclass(frozen=True, slots=True)
class KernelSettings:
    """The choices of a mission file that the kernel follows."""

    engine: EngineSettings
    belief: str = given.BELIEF
    planner: str = given.PLANNER
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
    radio: RadioLimits = field(default_factory=RadioLimits)
    battery: BatteryLimits = field(default_factory=BatteryLimits)
    idle_limit_s: float = given.IDLE_LIMIT_S
    """End when no robot could be steered for this long: somebody has to look."""
