"""Missions in a world that is not what the engine believes: each row one thing that real fields have.

`fieldkit study world --missions 30 [--only WORDS]`. The trust study's scenario; the engine is given what a mission file
would be: a radio whose place noise nobody measured, and GNSS as bad as it says. A source is found when a find lies
within `FOUND_WITHIN_M` of where it then is; a find further than twice that from every source, in the field or outside,
is false unless it is flagged as gone silent.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fieldkit.channel.spread import ChannelSpread, assumed, known_power
from fieldkit.engine.belief.intensity.belief import IntensityBelief
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
        placed = random_sources(4, FIELD_M, FIELD_M, LEVELS_DB, RATE_HZ, rng)
        borders = ((-2.0, None), (FIELD_M + 2.0, None), (None, -2.0), (None, FIELD_M + 2.0))
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


def engine_settings(job: Job, offset_db: tuple[float, ...]) -> EngineSettings:
    """What the engine is given."""
    from fieldkit.channel.antenna_file import Receiver

    what, engine = job.scenario, settings(job.seed)
    spread: ChannelSpread = assumed(engine.antenna)
    robots = engine.robots
    return replace(
        engine,
        spread=spread if what.power_over_db else known_power(spread),
        power_levels_db=(-10.0,) if what.power_over_db else LEVELS_DB,
        found_within_m=FOUND_WITHIN_M,
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
    disturbed = replace(what.disturbed, walls=random_walls(what.walls, FIELD_M, 5.0, 10.0, rng))
    truth = Truth(
        replace(antenna(), pattern_db=what.receivers_db),
        sources,
        tuple((2.0 + 2.0 * k, 1.0) for k in range(6)),
        offset_db=offset_db if what.offset_db else (),
        pose_wander_m=what.wander_m,
        disturbed=disturbed,
    )
    first: dict[str, bool] = {}

    def watch(kernel: Kernel, event: Any, outcome: Any) -> Any:
        if "wrong" not in first and kernel.belief.probability_left() <= 0.05:
            finds = [each for each in kernel.sources() if each.state == "found"]
            first["wrong"] = not all(_near(s, finds) for s in _now(event.t_ns * 1e-9) if _inside(s))
        return outcome.commands

    def _now(t_s: float) -> list[tuple[float, float]]:
        return [
            place_at((s.east_m, s.north_m), k, t_s, FIELD_M, disturbed, job.seed)
            for k, s in enumerate(sources)
        ]

    run = KernelSettings(engine_settings(job, offset_db), max_duration_s=CAP_S, sources_expected=10**6)
    result = simulate(run, truth, job.seed, on_step=Sometimes(watch))
    belief, at_end = result.kernel.belief, _now(result.elapsed_s)
    assert isinstance(belief, IntensityBelief)
    finds = [each for each in belief.sources() if each.state == "found"]
    flagged = [each for each in finds if "gone silent" in each.note]
    inside = [place for place in at_end if _inside(place)]
    cells = {(int(north // CELL_M), int(east // CELL_M)) for east, north in at_end}
    fresh = {each.ident for each in finds} - {each.ident for each in flagged}
    return {
        "inside": len(inside),
        "found": sum(_near(place, finds) for place in inside),
        "finds": len(fresh),
        "false_finds": sum(
            all(np.hypot(f.east_m - e, f.north_m - n) > 2.0 * FOUND_WITHIN_M for e, n in at_end)
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


def _inside(place: tuple[float, float]) -> bool:
    return all(0.0 <= each <= FIELD_M for each in place)


def _near(place: tuple[float, float], finds: list[SourceEstimate]) -> bool:
    return any(np.hypot(f.east_m - place[0], f.north_m - place[1]) <= FOUND_WITHIN_M for f in finds)


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
