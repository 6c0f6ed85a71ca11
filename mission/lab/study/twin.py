"""How much faster a whole search is than the same search on a belief in plain numpy, both run here and now."""

from dataclasses import replace
from typing import Any

import numpy as np

from fieldkit.clock import wall_s
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection
from fieldkit.world.sources import TransientSource
from mission.lab.bench import spog_numpy
from mission.lab.study.packets import Outcome, search


class NumpySpog(SpogBelief):
    """Theorem 1, Algorithm 1 and the Dirichlet rule written out in numpy."""

    def detect(self, detection: Detection) -> None:
        engine, n = self.settings, self.grid.n_cells
        p1, self.log_absent = spog_numpy(
            self.grid.centres_m, detection, engine, self.log_prior, self.log_absent
        )
        self._events += 1
        self._sum_p1 += p1
        alpha = self.settings.tuning.paper_beliefs.dirichlet_alpha
        self.log_prior = np.log((alpha / n + self._sum_p1) / (alpha + self._events))


def against_numpy(
    engine: EngineSettings, hidden: tuple[TransientSource, ...], cap_s: float
) -> dict[str, Any]:
    """One search by pairs walking at random, with either belief: simulated seconds a second, and their ratio."""
    start = np.array([(2.0 + 1.6 * k, 1.0) for k in range(len(engine.robots))])
    engine = replace(engine, sensing="pairwise", prior_rule="dirichlet")

    def timed(belief: SpogBelief) -> tuple[float, Outcome]:
        began = wall_s()
        outcome = search(engine, "pair-random-walk", hidden, start, engine.seed, cap_s, belief=belief)
        return outcome.elapsed_s / (wall_s() - began), outcome

    timed(SpogBelief(engine))  # compiles
    (ours, outcome), (numpy, same) = timed(SpogBelief(engine)), timed(NumpySpog(engine))
    return {
        "simulated_s_per_s": ours,
        "numpy_simulated_s_per_s": numpy,
        "times_faster": ours / numpy,
        "detections": outcome.detections,
        "same_outcome": (outcome.time_s, outcome.detections) == (same.time_s, same.detections),
    }
