"""The default belief beside others on the same recorded detections: SPOG, Stone Soup's particle filter, least squares.

Missions of the trust study's world give detections and listening, on the default planner's paths or on pair patrol's,
which do not depend on any belief; every method is fed the same. The particle filter and least squares know one source:
with more they follow what most readings have in common. Each method says itself what it has found: fieldkit by its
states, the others where nine tenths of their particles, or of their Gaussian, lie within one cell of the estimate.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from scipy.optimize import least_squares
from scipy.special import log_ndtr
from scipy.stats import norm

from fieldkit.clock import wall_s
from fieldkit.engine.association.detections import Associator
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Command, Detection, Event, FloatArray, Listening, Pose, RssReading, Tick
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.kernel import Kernel, Outcome
from mission.core.kernel_settings import KernelSettings
from mission.lab.simulate import Truth, simulate
from mission.lab.study.trust import LEVELS_DB, antenna, settings

DURATION_S = 1500.0
PARTICLES = 5000
WITHIN = float(norm.ppf(0.95))
"""Standard deviations each way that hold nine tenths of a Gaussian."""


@dataclass
class Recorded:
    """What a team heard, and where the sources were."""

    settings: EngineSettings
    sources: tuple[TransientSource, ...]
    heard: list[Detection | Listening] = field(default_factory=list)


class Method(Protocol):
    """Fed in order; `found` gives (k, 2) claimed places, `best` its best (j, 2) places claimed or not."""

    def detect(self, detection: Detection) -> None: ...

    def listen(self, listening: Listening) -> None: ...

    def found(self) -> FloatArray: ...

    def best(self) -> FloatArray: ...


def record(sources: int, seed: int, *, planner: str = "infogain", duration_s: float = DURATION_S) -> Recorded:
    """Detections and listening of a mission in the trust study's world, on the paths of `planner`."""
    rng = np.random.default_rng([seed, 7])
    hidden = tuple(random_sources(sources, 25.0, 25.0, LEVELS_DB, 0.05, rng))
    engine = settings(seed)
    truth = Truth(antenna(), hidden, tuple((2.0 + 2.0 * k, 1.0) for k in range(6)))
    kept = Recorded(engine, hidden)
    associator = Associator(engine.robots)

    def overhear(kernel: Kernel, event: Event, outcome: Outcome) -> tuple[Command, ...]:
        match event:
            case Pose():
                associator.pose(event)
            case RssReading():
                associator.reading(event)
            case Tick():
                detections, stretches = associator.advance(event.t_ns)
                kept.heard += [*stretches, *detections]
        return outcome.commands

    run = KernelSettings(
        engine,
        max_duration_s=duration_s,
        sources_expected=10**6,
        belief="intensity" if planner == "infogain" else "spog",
        planner=planner,
    )
    simulate(run, truth, seed, on_step=overhear)
    return kept


class Ours:
    """A belief of fieldkit's."""

    def __init__(self, belief: IntensityBelief | SpogBelief) -> None:
        self.belief = belief
        self.detect, self.listen = belief.detect, belief.listen

    def found(self) -> FloatArray:
        return _places([s for s in self.belief.sources() if s.state == "found"])

    def best(self) -> FloatArray:
        return _places(self.belief.sources())


def _places(estimates: list[Any]) -> FloatArray:
    return np.array([(s.east_m, s.north_m) for s in estimates]).reshape(-1, 2)


class LeastSquares:
    """One source at an unknown power, by scipy's robust least squares over all readings so far."""

    def __init__(self, engine: EngineSettings) -> None:
        self.engine = engine
        self.robots = np.empty((0, 2))
        self.rss = np.empty(0)
        self.place: FloatArray | None = None
        self.sigma_m = np.inf

    def listen(self, listening: Listening) -> None:
        """Silence is nothing to least squares."""

    def detect(self, detection: Detection) -> None:
        self.robots = np.concatenate([self.robots, detection.position_m[detection.heard]])
        self.rss = np.concatenate([self.rss, detection.rss_dbm[detection.heard]])
        if self.rss.size < 4:
            return
        radio = self.engine.antenna

        def residual(x: FloatArray) -> FloatArray:
            mean = radio.mean_rss_dbm(np.hypot(*(self.robots - x[:2]).T), x[2])
            return np.asarray((self.rss - mean) / radio.sigma_db)

        start = np.append(self.robots[np.argmax(self.rss)] + 0.1, np.median(self.engine.power_levels_db))
        size = (self.engine.grid.size_east_m, self.engine.grid.size_north_m)
        low, high = np.array([0.0, 0.0, -40.0]), np.array([*size, 40.0])
        fit = least_squares(
            residual, np.clip(start, low + 1e-3, high - 1e-3), loss="soft_l1", bounds=(low, high)
        )
        self.place = fit.x[:2]
        cov = np.linalg.pinv(fit.jac.T @ fit.jac)
        self.sigma_m = float(np.sqrt(np.max(np.diag(cov)[:2])))

    def found(self) -> FloatArray:
        sure = self.place is not None and WITHIN * self.sigma_m <= self.engine.grid.cell_m
        return self.best() if sure else np.empty((0, 2))

    def best(self) -> FloatArray:
        return np.empty((0, 2)) if self.place is None else self.place.reshape(1, 2)


class StoneSoup:
    """One source at an unknown power, by Stone Soup's bootstrap particle filter; it knows detections only."""

    def __init__(self, engine: EngineSettings) -> None:
        from mission.lab.stone_soup import BootstrapFilter

        self.engine, self.radio = engine, engine.antenna
        rng = np.random.default_rng(engine.seed)
        low = (0.0, 0.0, min(engine.power_levels_db))
        high = (engine.grid.size_east_m, engine.grid.size_north_m, max(engine.power_levels_db))
        self.filter = BootstrapFilter(rng.uniform(low, high, (PARTICLES, 3)).T, 0.01, 0.02, engine.seed)

    def listen(self, listening: Listening) -> None:
        """Stretches of listening mean nothing to it."""

    def detect(self, detection: Detection) -> None:
        """Readings of the robots that heard, silence of those that did not."""

        def log_likelihood(x: FloatArray) -> FloatArray:
            radio, log = self.radio, np.zeros(x.shape[1])
            for place, rss in zip(detection.position_m, detection.rss_dbm, strict=True):
                mean = radio.mean_rss_dbm(np.hypot(x[0] - place[0], x[1] - place[1]), x[2])
                if np.isnan(rss):
                    log += log_ndtr((radio.threshold_dbm + 0.5 - mean) / radio.sigma_db)
                else:
                    log += norm.logpdf(rss, mean, np.hypot(radio.sigma_db, np.sqrt(1 / 12)))
            return log

        self.filter.update(log_likelihood)

    def best(self) -> FloatArray:
        return self.filter.mean[:2].reshape(1, 2)

    def found(self) -> FloatArray:
        near = (np.abs(self.filter.cloud[:2].T - self.best()) <= self.engine.grid.cell_m).all(axis=1)
        return self.best() if float(self.filter.weight[near].sum()) >= 0.9 else np.empty((0, 2))


METHODS: dict[str, Callable[[EngineSettings], Method]] = {
    "intensity": lambda engine: Ours(IntensityBelief(engine)),
    "spog (levels, em)": lambda engine: Ours(SpogBelief(replace(engine, prior_rule="em", sensing="levels"))),
    "spog (pairwise, dirichlet)": lambda engine: Ours(
        SpogBelief(replace(engine, prior_rule="dirichlet", sensing="pairwise"))
    ),
    "Stone Soup particle filter": StoneSoup,
    "scipy least squares": LeastSquares,
}


def score(recorded: list[Recorded], make: Callable[[EngineSettings], Method]) -> dict[str, Any]:
    """Errors of a method over missions: from each source to the nearest place claimed, and to the nearest at all."""
    claimed, nearest, false, took_s, count = [], [], 0, 0.0, 0
    for mission in recorded:
        method = make(mission.settings)
        began = wall_s()
        for heard in mission.heard:
            if isinstance(heard, Detection):
                method.detect(heard)
                count += 1
            else:
                method.listen(heard)
        took_s += wall_s() - began
        true = np.array([(s.east_m, s.north_m) for s in mission.sources])
        found, best = method.found(), method.best()
        for place in true:
            claimed += [float(np.hypot(*(found - place).T).min())] if len(found) else []
            nearest += [float(np.hypot(*(best - place).T).min())] if len(best) else []
        limit = 2.0 * mission.settings.grid.cell_m
        false += sum(float(np.hypot(*(true - place).T).min()) > limit for place in found)
    within = [error for error in claimed if error <= 2.0 * recorded[0].settings.grid.cell_m]
    return {
        "sources": sum(len(mission.sources) for mission in recorded),
        "sources_found": len(within),
        "median_error_m": float(np.median(nearest)) if nearest else None,
        "p90_error_m": float(np.percentile(nearest, 90)) if nearest else None,
        "median_error_of_finds_m": float(np.median(within)) if within else None,
        "p90_error_of_finds_m": float(np.percentile(within, 90)) if within else None,
        "false_finds_a_mission": false / len(recorded),
        "ms_a_detection": 1e3 * took_s / max(1, count),
        "detections": count,
    }


SCENARIOS = ((1, "infogain"), (4, "infogain"), (4, "pair-patrol"))


def run(missions: int = 6) -> dict[str, Any]:
    """Every method on the same missions: one source, four, and four on paths that follow no belief."""
    result: dict[str, Any] = {}
    for sources, planner in SCENARIOS:
        recorded = [record(sources, seed, planner=planner) for seed in range(missions)]
        few = replace(recorded[0], heard=recorded[0].heard[:200])
        table: dict[str, Any] = {}
        for name, make in METHODS.items():
            try:
                score([few], make)  # compiles and imports, so that no method is timed for that
            except ImportError as missing:
                table[name] = {
                    "left_out": f"{missing.name} is not installed: pip install 'spog-fieldkit[dev]'"
                }
                continue
            table[name] = score(recorded, make)
        result[
            f"{sources} source{'s' * (sources > 1)}, paths of {planner}, {missions} x {DURATION_S:.0f} s"
        ] = table
    return result
