"""What the engine is given before a mission; checked once here, trusted inside."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from fieldkit import settings as given
from fieldkit.channel.antenna_file import Receiver
from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.grid import Grid
from fieldkit.errors import ConfigError
from fieldkit.geometry.polygons import NOWHERE, KeepOut
from fieldkit.tuning import Tuning

FIND_M, FIND_RANGES, MOST_FIND_RANGES = 2.0, 0.1, 1.0 / 3.0
"""A find is within 2 m or a tenth of the typical range, the larger; where that would say nothing, a third of it."""
SENSING = ("levels", "pairwise", "directional")


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """Everything a belief and a planner may need. Robots of one team move together, usually as pairs."""

    grid: Grid
    antenna: Antenna
    teams: tuple[tuple[str, ...], ...]
    """Robots that move abreast: pairs, or single robots."""
    power_levels_db: tuple[float, ...] = (given.POWER_DB.default,)
    """Powers a source may send at, relative to the calibrated transmitter."""
    found_probability: float = given.FOUND_PROBABILITY.default
    """p_t: a source is found when it is within `found_within_m` of the estimate with at least this probability."""
    min_receptions: float = given.MIN_RECEPTIONS.default
    reference_rate_hz: float = given.RATE_HZ.default
    """Transmission rate of a typical source; a source that sends more rarely takes longer to be noticed."""
    expected_sources: float = given.EXPECTED_SOURCES.default
    """Prior mean of the number of sources in the whole field."""
    planning_period_s: float = given.PLANNING_PERIOD_S.default
    max_speed_m_s: float = given.MAX_SPEED_M_S.default
    max_turn_deg_s: float = given.MAX_TURN_DEG_S.default
    """How fast a robot turns on the spot at the corners of its path."""
    min_separation_m: float = given.MIN_SEPARATION_M.default
    """No two robots are planned closer than this."""
    fence_margin_m: float = given.FENCE_MARGIN_M.default
    """Way-points keep this far inside the field's border."""
    keep_out: KeepOut = NOWHERE
    """Ground no path may cross."""
    spread: ChannelSpread | None = None
    """What readings of one place and one transmitter have in common; None: nothing, every reading stands alone."""
    found_within_m: float | None = None
    """A source is found when it is this near to the estimate; None: within one cell, without place noise, else 2 m or
    a tenth of the typical range, at most a third of it."""
    pose_sigma_m: float = given.POSE_SIGMA_M.default
    """Standard deviation of each coordinate of the robots' positions; a pose that says it is worse is believed."""
    source_up_m: float = given.SOURCE_UP_M.default
    """How high transmitters are above the field's origin."""
    identity: Literal["anonymous", "address"] = given.IDENTITY
    """`address`: each address that frames name is one source, and nobody guesses who sent what."""
    receivers: Mapping[str, Receiver] = field(default_factory=dict, hash=False)
    """Robots whose radio is not like the calibrated one."""
    seed: int = 0
    keep_teams: bool = False
    """Whether robots of a team stay together with every planner; else `infogain` parts and joins robots by need."""
    prior_rule: str = given.PRIOR_RULE
    """SPOG only: literal, uniform, dirichlet or em (notes on PRWA eq 2)."""
    sensing: str = given.SENSING
    """levels (exact, power set known), pairwise (PRWA Theorem 1) or directional (RWA, one robot); for SPOG."""
    directional_form: Literal["censored", "interval", "density", "truncated"] = given.DIRECTIONAL_FORM
    """For `directional` sensing: censored (ends of the scale open), or interval, density or truncated as printed."""
    group_gap_m: float = given.GROUP_GAP_M
    """DPRWA only: ridges further apart than this are toured in separate groups, each by pairs of its own."""
    normalised_entropy: bool = False
    """PRWA only: choose the spacing by P(C_i^1), a distribution, not by P(C_i) as eq 25 prints it."""

    tuning: Tuning = field(default_factory=Tuning)
    """What belief and planner are tuned by."""

    def __post_init__(self) -> None:
        if not self.power_levels_db:
            raise ConfigError("power_levels_db: expected at least one level, got none")
        if self.sensing not in SENSING:
            raise ConfigError(f"sensing: expected one of {', '.join(SENSING)}, got {self.sensing!r}")
        if self.sensing == "pairwise" and len(self.robots) == 1:
            raise ConfigError(
                "sensing 'pairwise' compares what at least two robots heard, got 1: "
                "add a robot, or choose sensing 'levels' or 'directional'"
            )
        for name in ("found_probability",):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ConfigError(f"{name}: expected a number between 0 and 1, got {getattr(self, name)}")
        for name in (
            "reference_rate_hz",
            "expected_sources",
            "planning_period_s",
            "max_speed_m_s",
            "max_turn_deg_s",
            "group_gap_m",
        ):
            if not getattr(self, name) > 0.0:
                raise ConfigError(f"{name}: expected a positive number, got {getattr(self, name)}")

    @property
    def place_noise(self) -> bool:
        """Whether readings of one place hang together."""
        return (
            self.spread is not None and self.spread.sigma_place_db > 0.0 and self.spread.correlation_m > 0.0
        )

    @property
    def find_radius_m(self) -> float | None:
        """How near a find is; None: within one cell."""
        if self.found_within_m is not None or not self.place_noise:
            return self.found_within_m
        typical_m = float(np.median(self.antenna.nominal_range_m(np.array(self.power_levels_db))))
        return float(
            min(max(FIND_M, FIND_RANGES * typical_m), max(MOST_FIND_RANGES * typical_m, self.grid.cell_m))
        )

    @property
    def robots(self) -> tuple[str, ...]:
        """All robots, team by team."""
        return tuple(robot for team in self.teams for robot in team)
