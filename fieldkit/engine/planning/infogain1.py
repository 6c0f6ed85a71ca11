"""The default planner of before: progress with a candidate by what a path is expected to learn of it.

Selectable for a release, to be compared (`fieldkit study planners`).
"""

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fieldkit.channel.model import MIN_RANGE_M
from fieldkit.engine.belief.base import Unresolved
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.base import Team
from fieldkit.engine.planning.infogain import InfoGainPlanner
from fieldkit.engine.planning.reward import Reward
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray
from fieldkit.tuning import InfogainTuning


class ExpectedReward(Reward):
    """Progress by the information that is expected over a candidate's samples."""

    def _nothing(self, candidate: Unresolved) -> FloatArray:
        """(4,): exposure and information per unit rate of no track."""
        return np.zeros(4)

    def _information_of(self, candidate: Unresolved, tracks_m: FloatArray, ears: FloatArray) -> FloatArray:
        """(n, 4) exposure and information per unit rate that tracks (n, steps, m, 2) give of a candidate."""
        information = np.empty((len(tracks_m), 4))
        path_loops.all_information(
            tracks_m,
            self._tuning.step_s,
            candidate.points_m,
            candidate.level,
            self._model.hear,
            self._model.step2_m2,
            MIN_RANGE_M,
            ears,
            information,
        )
        return information

    def _with(self, before: FloatArray, information: FloatArray) -> FloatArray:
        return before + information

    def _is_heard(self, information: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(information[:, 0] > 1e-3)

    def _progress(self, candidate: Unresolved, information: FloatArray) -> FloatArray:
        """(n,) reward for what is known of a candidate given this (n, 4) exposure and information."""
        rate = candidate.rate_hz
        antenna = self._settings.antenna
        cell_m = self._settings.find_radius_m or self._settings.grid.cell_m
        scale = (10.0 * antenna.path_loss_exponent / (antenna.sigma_db * math.log(10.0))) ** 2 * rate
        floor = (0.1 * cell_m) ** 2
        ee, en, nn = candidate.cov_m2[0, 0] + floor, candidate.cov_m2[0, 1], candidate.cov_m2[1, 1] + floor
        det = ee * nn - en * en
        ee, en, nn = (
            nn / det + scale * information[:, 1],
            scale * information[:, 2] - en / det,
            ee / det + scale * information[:, 3],
        )
        # Receptions still needed grow with the precision still missing: so counted, a candidate that is nearly
        # resolved is finished before the team drives to the next. Eigenvalues of the precision, closed form.
        only_place = candidate.state == "found" and not candidate.may_be_two
        target = ((self._tuning.settled_cells if only_place else self._tuning.target_cells) * cell_m) ** 2
        middle, half = (ee + nn) / 2.0, np.hypot((ee - nn) / 2.0, en)
        done = (np.minimum((middle - half) * target, 1.0) + np.minimum((middle + half) * target, 1.0)) / 2.0
        missing = max(1.0, self._settings.min_receptions - candidate.receptions)
        received = 1.0 - np.exp(-rate * information[:, 0] / missing)
        if only_place:
            weight = self._tuning.settle_value * (1.0 - candidate.p_here)
        else:
            weight = self._tuning.inconsistent_value if candidate.state == "inconsistent" else 1.0
        # A packet settles whether a find is still there; most is learnt where that is as probable as not.
        checked = (
            4.0 * candidate.p_gone * (1.0 - candidate.p_gone) * (1.0 - np.exp(-rate * information[:, 0]))
        )
        return np.asarray(
            weight * (self._tuning.resolve_value * done + self._tuning.reception_value * received)
            + self._check_value * checked
        )


class InfoGain1Planner(InfoGainPlanner):
    """See the module."""

    NAME: ClassVar = "infogain1"
    REWARD: ClassVar[type[Reward]] = ExpectedReward

    def teams(self, stated: tuple[Team, ...]) -> tuple[Team, ...]:
        """As stated: it was made for pairs."""
        return stated

    @staticmethod
    def _table(settings: EngineSettings) -> InfogainTuning:
        return settings.tuning.infogain1
