"""Missions in a world that is not what the engine believes: each row one thing that real fields have.

`fieldkit study world --missions 30 [--only WORDS]`. The trust study's scenario; the engine is given what a mission file
would be: a radio whose place noise nobody measured, and GNSS as bad as it says. A source is found when a find lies
within `Scenario.within_m` of where it then is; a find further than twice that from every source, in the field or
outside, is false unless it is flagged as gone silent.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fieldkit import settings as given
from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread, assumed, known_power
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import SourceEstimate
from fieldkit.world.disturbed import NONE, Disturbances, place_at
from fieldkit.world.sources import TransientSource, random_sources
from fieldkit.world.walls import random_walls
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.lab.simulate import Truth, simulate
from mission.lab.study.pool import Progress
from mission.lab.study.scenarios import FOUND_WITHIN_M, Sometimes, run_scenarios
from mission.lab.study.trust import CELL_M, FIELD_M, LEVELS_DB, RATE_HZ, antenna, settings

CAP_S = 1500.0
DEG = np.arange(0.0, 360.0, 10.0)
DIPOLES = 2.0
"""`channel.spread`'s elevation of two vertical dipoles."""
RIPPLE_DB = tuple(
    np.round(3.0 * np.cos(np.radians(3.0 * DEG)) - 20.0 * (np.abs(DEG - 180.0) < 11.0), 2).tolist()
)
"""6 dB of ripple and one null."""
LOBE_DB = tuple(np.round(6.0 * np.cos(np.radians(DEG)), 2).tolist())
"""12 dB front to back."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """One row."""

    name: str
    disturbed: Disturbances = NONE
    walls: int = 0
    outside: int = 0
    """Of the four sources, so many lie 2 m outside the field."""
    offset_db: float = 0.0
    """Deviation of the receivers' offsets."""
    calibrated: bool = False
    """Whether the engine knows them."""
    receivers_db: tuple[float, ...] = ()
    """Gain of the receivers by heading, unknown to the engine."""
    power_over_db: float = 0.0
    """Powers are anywhere in such a range, and none is known."""
    wander_m: float = 0.0
    rates: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    """Of the reference rate."""
    burst_s: tuple[float, float] | None = None
    beacons: bool = False
    """Sources send with a fixed period."""
    scale: float = 1.0
    """Field, cells, ranges and speeds are so many times those of the trust study."""
    up_m: float = 0.0
    """How high the robots fly over sources on the ground, both with the pattern of a vertical dipole."""

    @property
    def size_m(self) -> float:
        """Side of the field."""
        return FIELD_M * self.scale

    @property
    def within_m(self) -> float:
        """How near a find must be: where ranges are long, as near as a mission file says by default."""
        typical_m = float(antenna().nominal_range_m(LEVELS_DB[len(LEVELS_DB) // 2])) * self.scale
        return FOUND_WITHIN_M if self.scale == 1.0 else max(2.0, 0.1 * typical_m)


SCENARIOS = (
    Scenario("as believed"),
    Scenario("2 of 4 sources 2 m outside", outside=2),
    Scenario("one false packet a minute", Disturbances(foreign_hz=1.0 / 60.0)),
    Scenario(
        "one false packet a minute at two robots", Disturbances(foreign_hz=1.0 / 60.0, foreign_robots=2)
    ),
    Scenario("an insensitive receiver", Disturbances(insensitive=(2,))),
    Scenario("beacons with a fixed period", beacons=True),
    Scenario("bursts", burst_s=(60.0, 660.0), rates=(20.0, 20.0, 20.0, 20.0)),
    Scenario("rates 100 times apart", rates=(20.0, 20.0, 0.2, 0.2)),
    Scenario("a walk of 0.05 m/s", Disturbances(walk_m_s=0.05)),
    Scenario("a jump of 5 m", Disturbances(jump_m=5.0, jump_s=700.0)),
    Scenario("positions wander by 2 m, stated", wander_m=2.0),
    Scenario("positions wander by 2 m, stated, ranges of 10 m", wander_m=2.0, scale=3.0),
    Scenario("drones 40 m over sources on the ground, ranges of 140 m", scale=40.0, up_m=40.0),
    Scenario("receivers 6 dB apart, calibrated", offset_db=6.0, calibrated=True),
    Scenario("receivers 6 dB apart, not calibrated", offset_db=6.0),
    Scenario("power anywhere in 20 dB, not known", power_over_db=20.0),
    Scenario("transmitters with 12 dB front to back", Disturbances(lobe_db=LOBE_DB)),
    Scenario("transmitters with ripple and a null", Disturbances(lobe_db=RIPPLE_DB)),
    Scenario("receivers with ripple and a null", receivers_db=RIPPLE_DB),
    Scenario("8 walls of 10 dB", walls=8),
    Scenario("25 walls of 10 dB", walls=25),
    Scenario("packets collide", Disturbances(collision_s=0.5), rates=(10.0, 10.0, 10.0, 10.0)),
)


@dataclass(frozen=True, slots=True)
class Job:
    """One trial."""

    scenario: Scenario
    seed: int

    def sources(self) -> tuple[TransientSource, ...]:
        """What is hidden: those outside the field come first."""
        what = self.scenario
        rng = np.random.default_rng([self.seed, 99])
        placed = random_sources(4, what.size_m, what.size_m, LEVELS_DB, RATE_HZ, rng)
        borders = ((-2.0, None), (what.size_m + 2.0, None), (None, -2.0), (None, what.size_m + 2.0))
        for number in range(what.outside):
            east_m, north_m = borders[int(rng.integers(4))]
            placed[number] = replace(
                placed[number],
                east_m=placed[number].east_m if east_m is None else east_m,
                north_m=placed[number].north_m if north_m is None else north_m,
                power_db=0.0,
            )
        if what.power_over_db:
            placed = [replace(each, power_db=float(rng.uniform(-what.power_over_db, 0.0))) for each in placed]
        return tuple(
            replace(each, rate_hz=RATE_HZ * factor, burst_s=what.burst_s, beacon=what.beacons)
            for each, factor in zip(placed, what.rates, strict=True)
        )


def scaled_antenna(what: Scenario) -> Antenna:
    """The trust study's radio, stronger by as much as ranges are longer."""
    radio = antenna()
    more_db = 10.0 * radio.path_loss_exponent * float(np.log10(what.scale))
    return replace(radio, power_at_1m_dbm=radio.power_at_1m_dbm + more_db)


def engine_settings(job: Job, offset_db: tuple[float, ...]) -> EngineSettings:
    """What the engine is given."""
    from fieldkit.channel.antenna_file import Receiver

    what, engine = job.scenario, settings(job.seed)
    radio = scaled_antenna(what)
    spread: ChannelSpread = replace(assumed(radio), elevation=DIPOLES if what.up_m else 0.0)
    robots = engine.robots
    return replace(
        engine,
        grid=Grid(what.size_m, what.size_m, CELL_M * what.scale),
        antenna=radio,
        max_speed_m_s=engine.max_speed_m_s * what.scale,
        min_separation_m=engine.min_separation_m * what.scale,
        spread=spread if what.power_over_db else known_power(spread),
        power_levels_db=(-10.0,) if what.power_over_db else LEVELS_DB,
        found_within_m=what.within_m,
        pose_sigma_m=max(0.05, what.wander_m),
        receivers={robot: Receiver(each) for robot, each in zip(robots, offset_db, strict=True)}
        if what.calibrated
        else {},
    )


def trial(job: Job) -> dict[str, Any]:
    """One mission."""
    what, sources = job.scenario, job.sources()
    rng = np.random.default_rng([job.seed, 98])
    offset_db = tuple((what.offset_db * rng.standard_normal(6)).tolist())
    disturbed = replace(what.disturbed, walls=random_walls(what.walls, what.size_m, 5.0, 10.0, rng))
    truth = Truth(
        replace(scaled_antenna(what), pattern_db=what.receivers_db),
        sources,
        tuple(((2.0 + 2.0 * k) * what.scale, what.scale) for k in range(6)),
        max_speed_m_s=given.MAX_SPEED_M_S.default * what.scale,
        elevation=DIPOLES if what.up_m else 0.0,
        offset_db=offset_db if what.offset_db else (),
        pose_wander_m=what.wander_m,
        disturbed=disturbed,
    )
    first: dict[str, bool] = {}

    def watch(kernel: Kernel, event: Any, outcome: Any) -> Any:
        if "wrong" not in first and kernel.belief.probability_left() <= 0.05:
            finds = [each for each in kernel.sources() if each.state == "found"]
            now = [place for place in _now(event.t_ns * 1e-9) if _inside(place, what.size_m)]
            first["wrong"] = not all(_near(place, finds, what.within_m) for place in now)
        return outcome.commands

    def _now(t_s: float) -> list[tuple[float, float]]:
        return [
            place_at((s.east_m, s.north_m), k, t_s, what.size_m, disturbed, job.seed)
            for k, s in enumerate(sources)
        ]

    engine = engine_settings(job, offset_db)
    up_m = dict.fromkeys(engine.robots, what.up_m)
    run = KernelSettings(engine, max_duration_s=CAP_S, sources_expected=10**6, altitude_m=up_m)
    result = simulate(run, truth, job.seed, on_step=Sometimes(watch))
    belief, at_end = result.kernel.belief, _now(result.elapsed_s)
    assert isinstance(belief, IntensityBelief)
    finds = [each for each in belief.sources() if each.state == "found"]
    flagged = [each for each in finds if "gone silent" in each.note]
    inside = [place for place in at_end if _inside(place, what.size_m)]
    cells = {belief.grid.cell_of(east, north) for east, north in at_end}
    fresh = {each.ident for each in finds} - {each.ident for each in flagged}
    return {
        "inside": len(inside),
        "found": sum(_near(place, finds, what.within_m) for place in inside),
        "finds": len(fresh),
        "false_finds": sum(
            all(np.hypot(f.east_m - e, f.north_m - n) > 2.0 * what.within_m for e, n in at_end)
            for f in finds
            if f.ident in fresh
        ),
        "flagged": len(flagged),
        "covered": sum(bool(belief.region_90(c) & cells) for c in belief.candidates if c.ident in fresh),
        "outside": sum(each.state == "outside" for each in belief.sources()),
        "said_5": bool(first),
        "said_5_wrong": first.get("wrong", False),
        "notes": sum(1 for each in belief.sources() if each.note),
    }


def _inside(place: tuple[float, float], size_m: float) -> bool:
    return all(0.0 <= each <= size_m for each in place)


def _near(place: tuple[float, float], finds: list[SourceEstimate], within_m: float) -> bool:
    return any(np.hypot(f.east_m - place[0], f.north_m - place[1]) <= within_m for f in finds)


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one scenario."""
    finds = sum(row["finds"] for row in rows)
    inside = sum(row["inside"] for row in rows)
    return {
        "missions": len(rows),
        "found": f"{sum(row['found'] for row in rows)}/{inside}",
        "all_found": sum(row["found"] == row["inside"] for row in rows),
        "false_finds": sum(row["false_finds"] for row in rows) / len(rows),
        "flagged": sum(row["flagged"] for row in rows) / len(rows),
        "outside": sum(row["outside"] for row in rows) / len(rows),
        "coverage_90": sum(row["covered"] for row in rows) / finds if finds else None,
        "said_5_left": sum(row["said_5"] for row in rows),
        "said_5_left_wrong": sum(row["said_5_wrong"] for row in rows),
    }


def run(missions: int, seed: int, progress: Progress, *, only: str = "", **how: Any) -> dict[str, Any]:
    """All scenarios, `missions` each from `seed` on; `only` keeps those whose name contains it."""
    return run_scenarios(
        "world", SCENARIOS, Job, trial, summarise, missions, seed, progress, only=only, **how
    )
