"""Missions under shadowing that belongs to places: the trust study's scenario, on a channel the engine is given.

`fieldkit study shadowing`. A source is found when a find lies within `FOUND_WITHIN_M` of it; a find further than twice
that from every source is false.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import UNMEASURED_RECEIVER_DB, ChannelSpread
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import GoTo, SourceEstimate
from fieldkit.world.shadowing import shadow_fields
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.lab.simulate import Truth, simulate
from mission.lab.study.packets import ROBOTS_APART_M
from mission.lab.study.pool import Progress
from mission.lab.study.scenarios import FOUND_WITHIN_M, Sometimes, run_scenarios
from mission.lab.study.trust import CELL_M, EXPONENT, FIELD_M, LEVELS_DB, RATE_HZ, THRESHOLD_DBM

TIME_DB = 2.0
CAP_S = 2500.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """A world and what the engine knows of it."""

    name: str
    place_db: float = 0.0
    length_m: float = 5.0
    known: bool = True
    """Whether the engine knows that noise belongs to places; else it knows the total."""
    offset_db: float = 0.0
    """Deviation of the receivers' offsets, which nobody has calibrated."""
    wander_m: float = 0.0
    """Deviation of wandering position errors, given as they are."""
    standing: bool = False
    """The robots stand somewhere in the field and never move."""


SCENARIOS = (
    *(
        Scenario(f"{place:g} dB over {length:g} m", place, length)
        for place in (3.0, 6.0, 8.0)
        for length in (1.0, 5.0, 15.0)
    ),
    Scenario("3 dB over 5 m, not known", 3.0, 5.0, known=False),
    Scenario("6 dB over 5 m, not known", 6.0, 5.0, known=False),
    Scenario("receivers 6 dB apart, not calibrated", 3.0, 5.0, offset_db=6.0),
    Scenario("positions wander by 0.5 m", 3.0, 5.0, wander_m=0.5),
    Scenario("robots that stand still", 3.0, 5.0, standing=True),
)


@dataclass(frozen=True, slots=True)
class Job:
    """One trial."""

    scenario: Scenario
    seed: int


def settings(scenario: Scenario, seed: int) -> EngineSettings:
    """What the engine is given."""
    total_db = float(np.hypot(TIME_DB, scenario.place_db))
    power = THRESHOLD_DBM + 10.0 * EXPONENT * np.log10(3.45)
    spread = ChannelSpread(
        TIME_DB,
        scenario.place_db,
        scenario.length_m,
        transmitter_db=max(0.1, scenario.offset_db),
        transmitter_exponent=0.0,
        lobe_db=0.0,
        receiver_db=UNMEASURED_RECEIVER_DB if scenario.offset_db else 0.0,
    )
    return EngineSettings(
        Grid(FIELD_M, FIELD_M, CELL_M),
        Antenna(EXPONENT, float(power), total_db, THRESHOLD_DBM),
        (("r0", "r1"), ("r2", "r3"), ("r4", "r5")),
        LEVELS_DB,
        reference_rate_hz=RATE_HZ,
        min_separation_m=ROBOTS_APART_M,
        seed=seed,
        spread=spread if scenario.known else None,
        found_within_m=FOUND_WITHIN_M,
        pose_sigma_m=float(np.hypot(0.05, scenario.wander_m)),
    )


def trial(job: Job) -> dict[str, Any]:
    """One mission."""
    scenario = job.scenario
    engine = settings(scenario, job.seed)
    rng = np.random.default_rng([job.seed, 99])
    sources = tuple(random_sources(4, FIELD_M, FIELD_M, LEVELS_DB, RATE_HZ, rng))
    shadow = shadow_fields(4, scenario.place_db, scenario.length_m, rng)
    offset_db = tuple((scenario.offset_db * rng.standard_normal(6)).tolist())
    start_m = tuple((2.0 + 2.0 * k, 1.0) for k in range(6))
    if scenario.standing:
        start_m = tuple(map(tuple, rng.uniform(1.0, FIELD_M - 1.0, (6, 2)).tolist()))
    truth = Truth(
        replace(engine.antenna, sigma_db=TIME_DB),
        sources,
        start_m,
        shadow=shadow,
        offset_db=offset_db,
        pose_wander_m=scenario.wander_m,
    )
    said: list[bool] = []
    complete_at: list[float] = []

    def watch(kernel: Kernel, event: Any, outcome: Any) -> Any:
        found = [source for source in kernel.sources() if source.state == "found"]
        whole = all(near(source, found) for source in sources)
        if whole and not complete_at:
            complete_at.append(event.t_ns * 1e-9)
        if not said and kernel.belief.probability_left() <= 0.05:
            said.append(not whole)
        return outcome.commands

    def stay(kernel: Kernel, event: Any, outcome: Any) -> Any:
        commands = every(kernel, event, outcome)
        return [each for each in commands if not (scenario.standing and isinstance(each, GoTo))]

    every = Sometimes(watch)
    kernel = KernelSettings(engine, max_duration_s=CAP_S, sources_expected=10**6)
    result = simulate(kernel, truth, job.seed, on_step=stay)
    finds = [source for source in result.kernel.sources() if source.state == "found"]
    belief = result.kernel.belief
    assert isinstance(belief, IntensityBelief)
    cells = {belief.grid.cell_of(source.east_m, source.north_m) for source in sources}
    covered = sum(bool(belief.region_90(c) & cells) for c in belief.candidates if c.state == "found")
    return {
        "time_s": complete_at[0] if complete_at else None,
        "found": sum(near(source, finds) for source in sources),
        "finds": len(finds),
        "false_finds": sum(not _by_any(find, sources) for find in finds),
        "covered": covered,
        "said_5": bool(said),
        "said_5_wrong": bool(said and said[0]),
    }


def near(source: TransientSource, found: list[SourceEstimate]) -> bool:
    """Whether a find lies at the source."""
    return any(
        np.hypot(f.east_m - source.east_m, f.north_m - source.north_m) <= FOUND_WITHIN_M for f in found
    )


def _by_any(find: SourceEstimate, sources: tuple[TransientSource, ...]) -> bool:
    return any(
        np.hypot(find.east_m - s.east_m, find.north_m - s.north_m) <= 2.0 * FOUND_WITHIN_M for s in sources
    )


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one scenario."""
    finds = sum(row["finds"] for row in rows)
    times = [row["time_s"] for row in rows if row["time_s"] is not None]
    said = sum(row["said_5"] for row in rows)
    return {
        "missions": len(rows),
        "all_found": len(times),
        "mean_time_s": float(np.mean(times)) if times else None,
        "sources_found": sum(row["found"] for row in rows) / (4 * len(rows)),
        "false_finds": sum(row["false_finds"] for row in rows) / len(rows),
        "coverage_90": sum(row["covered"] for row in rows) / finds if finds else None,
        "said_5_left": said,
        "said_5_left_wrong": sum(row["said_5_wrong"] for row in rows),
    }


def run(trials: int, seed: int, progress: Progress, *, only: str = "", **how: Any) -> dict[str, Any]:
    """All scenarios, `trials` each from `seed` on; `only` keeps those whose name contains it."""
    return run_scenarios(
        "shadowing", SCENARIOS, Job, trial, summarise, trials, seed, progress, only=only, **how
    )
