"""One drone looks for one transmitter on the ground: how near its estimate is after three and after ten minutes.

`fieldkit study rover`. The ground, the times and the channel are those of published flights of drones over a hidden
transmitter that sends all the time: 300 m x 270 m, 40 m above it, 10 m/s, a reading every two seconds that is an
average already, and shadowing of 8 to 12 dB over 20 m. Four ways to fly: fieldkit's own mission, lanes, to where it
was loudest, and a Gaussian process over the levels with an upper confidence bound. The same world for all four. Each
is judged by its own estimate, and by `locate` on what it heard, which also states a region.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.grid import Grid
from fieldkit.engine.location.one_source import OneSource, Radio, locate
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Command, Event, FloatArray, GoTo, Pose, RssReading, Tick, VehicleState
from fieldkit.world.bodies import Rover
from fieldkit.world.shadowing import ShadowField
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.lab.study.pool import Progress, having, run_trials

EAST_M, NORTH_M, UP_M, SOURCE_UP_M = 300.0, 270.0, 40.0, 1.5
DRONE_M_S, STEP_S, READING_S = 10.0, 0.5, 2.0
LOOKS_S = (180.0, 600.0)
DRONE = "d1"
RADIO = Antenna(4.5, 90.0, float(np.hypot(7.0, 10.0)), -80.0)
SPREAD = ChannelSpread(
    7.0,
    10.0,
    20.0,
    transmitter_db=2.9,
    transmitter_exponent=0.3,
    elevation=1.0,
    elevation_sd=0.3,
    transmitters=3,
)
LANE_M = 50.0
GP_LENGTH_M, GP_SD_DB, GP_WIDTHS = 40.0, 12.0, 1.5
THINKS_S = 10.0
"""How often the two who look for the loudest place choose anew where to go."""


@dataclass(frozen=True, slots=True)
class Job:
    """One flight."""

    pilot: str
    seed: int


class World:
    """One hidden transmitter and its channel: drawn about what the calibration knows."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 0xAFA2])
        self.source_m = rng.uniform(0.0, 1.0, 2) * (EAST_M, NORTH_M)
        self.exponent = RADIO.path_loss_exponent + SPREAD.transmitter_exponent * rng.standard_normal()
        self.power_db = RADIO.power_at_1m_dbm + SPREAD.transmitter_db * rng.standard_normal()
        self.lobe_db = SPREAD.lobe_db * rng.standard_normal(2)
        self.elevation = SPREAD.elevation + SPREAD.elevation_sd * rng.standard_normal()
        self.shadow = ShadowField(float(rng.uniform(8.0, 12.0)), SPREAD.correlation_m, rng)
        self.rng = rng

    def level_db(self, at_m: FloatArray) -> float:
        """What a drone at (2,) reads."""
        way = at_m - self.source_m
        flat_m, up_m = float(np.hypot(*way)), UP_M - SOURCE_UP_M
        away_m = math.hypot(flat_m, up_m)
        level = self.power_db - 10.0 * self.exponent * math.log10(away_m)
        level += self.elevation * 20.0 * math.log10(max(flat_m / away_m, 0.1))
        level += float(self.lobe_db @ way) / away_m + float(self.shadow.at(at_m[None])[0])
        return level + SPREAD.sigma_time_db * float(self.rng.standard_normal())


class Pilot:
    """Where to fly, by what was read so far: places (n, 2) and levels (n,)."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 0x9170])
        self.places, self.levels = np.zeros((0, 2)), np.zeros(0)
        self._thought_s = -math.inf
        self._to_m: FloatArray | None = None

    def read(self, t_s: float, at_m: FloatArray, level_db: float) -> None:
        self.places = np.concatenate([self.places, at_m[None]])
        self.levels = np.append(self.levels, level_db)

    def next(self, t_s: float, at_m: FloatArray) -> FloatArray | None:
        """A way-point (2,), or None to go on."""
        if t_s < self._thought_s + THINKS_S or self.levels.size == 0:
            return None
        self._thought_s = t_s
        return np.clip(self.choose(at_m), 0.0, (EAST_M, NORTH_M))

    def choose(self, at_m: FloatArray) -> FloatArray:
        """Where it was loudest, for a pilot who knows no better."""
        return self.estimate()

    def estimate(self) -> FloatArray:
        """Where it was loudest, averaged over neighbours."""
        return np.asarray(self.places[int(np.argmax(self._smoothed(self.places)))])

    def _smoothed(self, at_m: FloatArray) -> FloatArray:
        away2 = ((at_m[:, None] - self.places[None]) ** 2).sum(axis=2)
        weight = np.exp(-away2 / (2.0 * 15.0**2))
        return np.asarray((weight @ self.levels) / weight.sum(axis=1))


class Lanes(Pilot):
    """Lanes to and fro, then across, then between those."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self._corners: list[FloatArray] = []
        for first_m in (LANE_M / 2.0, 0.0):
            for across in (False, True):
                length_m, width_m = (NORTH_M, EAST_M) if across else (EAST_M, NORTH_M)
                for number, lane_m in enumerate(np.arange(first_m, width_m, LANE_M)):
                    ends = [0.0, length_m][:: 1 if number % 2 == 0 else -1]
                    self._corners += [np.array([lane_m, e] if across else [e, lane_m]) for e in ends]

    def next(self, t_s: float, at_m: FloatArray) -> FloatArray | None:
        if self._corners and (self._to_m is None or np.hypot(*(at_m - self._to_m)) < 2.0):
            self._to_m = self._corners.pop(0)
        return self._to_m


class Loudest(Pilot):
    """To where it was loudest, and about there."""

    def choose(self, at_m: FloatArray) -> FloatArray:
        return self.estimate() + self.rng.normal(0.0, 30.0, 2)


class GaussianProcess(Pilot):
    """Levels as a Gaussian process; flies to the highest upper confidence bound (Srinivas et al., ICML 2010)."""

    def choose(self, at_m: FloatArray) -> FloatArray:
        there = self.rng.uniform(0.0, 1.0, (400, 2)) * (EAST_M, NORTH_M)
        mean, sd = self._believed(there)
        return np.asarray(there[int(np.argmax(mean + GP_WIDTHS * sd))])

    def estimate(self) -> FloatArray:
        east, north = np.meshgrid(np.arange(2.5, EAST_M, 5.0), np.arange(2.5, NORTH_M, 5.0))
        points = np.column_stack([east.ravel(), north.ravel()])
        return np.asarray(points[int(np.argmax(self._believed(points)[0]))])

    def _believed(self, at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        def alike(a: FloatArray, b: FloatArray) -> FloatArray:
            away2 = ((a[:, None] - b[None]) ** 2).sum(axis=2)
            return np.asarray(GP_SD_DB**2 * np.exp(-away2 / (2.0 * GP_LENGTH_M**2)))

        middle = float(self.levels.mean())
        known = alike(self.places, self.places) + SPREAD.sigma_time_db**2 * np.eye(len(self.levels))
        cross = alike(at_m, self.places)
        solved = np.linalg.solve(known, np.column_stack([self.levels - middle, cross.T]))
        variance = GP_SD_DB**2 - np.einsum("ij,ji->i", cross, solved[:, 1:])
        return middle + cross @ solved[:, 0], np.sqrt(np.maximum(variance, 0.0))


class Fieldkit(Pilot):
    """The mission's own kernel: belief `intensity`, planner `infogain`, one source that sends every two seconds."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        engine = EngineSettings(
            Grid(EAST_M, NORTH_M, 3.0),
            RADIO,
            ((DRONE,),),
            reference_rate_hz=1.0 / READING_S,
            expected_sources=1.0,
            max_speed_m_s=DRONE_M_S,
            source_up_m=SOURCE_UP_M,
            spread=SPREAD,
            found_within_m=5.0,
            seed=seed,
        )
        self._kernel = Kernel(
            KernelSettings(engine, altitude_m={DRONE: UP_M}, sources_expected=10**6, arrive_m=3.0)
        )
        self._kernel.step(VehicleState(0, DRONE, "guided", True))
        self._inbox: list[Event] = []

    def read(self, t_s: float, at_m: FloatArray, level_db: float) -> None:
        super().read(t_s, at_m, level_db)
        self._inbox.append(RssReading(round(t_s * 1e9), DRONE, float(np.round(level_db))))

    def next(self, t_s: float, at_m: FloatArray) -> FloatArray | None:
        t_ns = round(t_s * 1e9)
        pose = Pose(t_ns, DRONE, float(at_m[0]), float(at_m[1]), UP_M, sigma_m=0.5)
        commands: list[Command] = []
        for event in (pose, *self._inbox, Tick(t_ns)):
            commands += self._kernel.step(event).commands
        self._inbox = []
        to = [c.waypoint for c in commands if isinstance(c, GoTo)]
        return np.array([to[-1].east_m, to[-1].north_m]) if to else None


PILOTS: dict[str, Callable[[int], Pilot]] = {
    "fieldkit": Fieldkit,
    "lanes": Lanes,
    "to the loudest": Loudest,
    "gaussian process": GaussianProcess,
}


def trial(job: Job) -> dict[str, Any]:
    """One flight: errors at each look, by the pilot's own estimate and by `locate`, whose region is judged."""
    world, pilot = World(job.seed), PILOTS[job.pilot](job.seed)
    drone = Rover(EAST_M / 2.0, 5.0, max_speed_m_s=DRONE_M_S)
    result: dict[str, Any] = {}
    for step in range(round(LOOKS_S[-1] / STEP_S) + 1):
        t_s, at_m = step * STEP_S, np.array([drone.east_m, drone.north_m])
        if step % round(READING_S / STEP_S) == 0:
            pilot.read(t_s, at_m, world.level_db(at_m))
        if (to := pilot.next(t_s, at_m)) is not None:
            drone.go_to(float(to[0]), float(to[1]), DRONE_M_S)
        if t_s in LOOKS_S:
            result |= {f"{name} {t_s:.0f}": value for name, value in _look(world, pilot).items()}
        drone.step(STEP_S)
    return result


def _look(world: World, pilot: Pilot) -> dict[str, Any]:
    at = np.column_stack([pilot.places, np.full(len(pilot.places), UP_M)])
    radio = Radio(RADIO, SPREAD, source_up_m=SOURCE_UP_M)
    posterior = locate(OneSource(at, pilot.levels), radio, (0.0, 0.0, EAST_M, NORTH_M)).posterior
    return {
        "own_m": float(np.hypot(*(pilot.estimate() - world.source_m))),
        "located_m": float(np.hypot(*(posterior.centre_m() - world.source_m))),
        "covered": posterior.holds(world.source_m, 0.9),
    }


def run(trials: int, seed: int, progress: Progress, *, only: str = "", **how: Any) -> dict[str, Any]:
    """JSON: for each pilot and look {"own_median_m", "located_median_m", "located_p90_m", "covered_90"}."""
    wanted = having(only, PILOTS)
    jobs = [Job(name, seed + k) for name in wanted for k in range(trials)]
    rows = run_trials(trial, jobs, progress, **how)
    scenarios: dict[str, Any] = {}
    for name in wanted:
        own = [row for job, row in zip(jobs, rows, strict=True) if job.pilot == name]
        scenarios[name] = {f"after {look:.0f} s": _summary(own, f"{look:.0f}") for look in LOOKS_S}
    return {"study": "rover", "trials": trials, "seed": seed, "scenarios": scenarios}


def _summary(rows: list[dict[str, Any]], look: str) -> dict[str, float]:
    located = [row[f"located_m {look}"] for row in rows]
    return {
        "own_median_m": float(np.median([row[f"own_m {look}"] for row in rows])),
        "located_median_m": float(np.median(located)),
        "located_p90_m": float(np.percentile(located, 90)),
        "covered_90": float(np.mean([row[f"covered {look}"] for row in rows])),
    }
