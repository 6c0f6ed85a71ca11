"""What may follow the default planner: a team stays with a candidate until it is found, and looks from several sides.

Progress is taken at each sample of where and how strong a candidate may be, and then averaged: a path that learns all
if the source is here and nothing if it is there makes half the progress, however much it learns here. Power counts as
unknown. Of packets that one team hears anyway, another team learns little that is still needed. Where it is given a
budget, the best of the first paths are bettered by local search.
"""

import math
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fieldkit.channel.model import MIN_RANGE_M
from fieldkit.engine.belief.base import Unresolved
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.infogain import InfoGainPlanner
from fieldkit.engine.planning.reward import Reward
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray
from fieldkit.tuning import InfogainTuning


class SampledReward(Reward):
    """Progress at each of a candidate's k samples by itself."""

    def _nothing(self, candidate: Unresolved) -> FloatArray:
        """(k, 7): as `path_loops.all_learnt` of no track."""
        return np.zeros((len(candidate.points_m), 7))

    def _information_of(self, candidate: Unresolved, tracks_m: FloatArray, ears: FloatArray) -> FloatArray:
        """(n, k, 7) as `path_loops.all_learnt` of tracks (n, steps, m, 2)."""
        information = np.empty((len(tracks_m), len(candidate.points_m), 7))
        path_loops.all_learnt(
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
        """(n, k, 7): what is learnt (k, 7) and a further track's (n, k, 7) come to.

        Of packets that a team hears anyway, another team would learn little that is still needed.
        """
        free = 1.0 - np.minimum(before[:, :1] / self._horizon_s, 1.0)
        return np.asarray(before + free * information)

    def _is_heard(self, information: FloatArray) -> NDArray[np.bool_]:
        """(n,) whether tracks are near enough to a candidate to learn anything."""
        return np.asarray(information[..., 0].mean(axis=1) > 1e-3)

    def _precision(self, candidate: Unresolved, information: FloatArray) -> tuple[FloatArray, ...]:
        """(n, k) each, ee, en, nn: the inverse covariance of a candidate's place (1/m^2) after (n, k, 7).

        Power is not known: what readings say of it is no word on the place (Schur complement).
        """
        antenna = self._settings.antenna
        per_db = 10.0 * antenna.path_loss_exponent / math.log(10.0)
        variance = antenna.sigma_db**2
        ee, en, nn, e, n, count = (candidate.rate_hz / variance * information[..., k] for k in range(1, 7))
        powers_db2 = float(np.var(self._settings.power_levels_db))
        shared = powers_db2 / (1.0 + powers_db2 * count)
        floor = (0.1 * self._near_m()) ** 2
        cov = candidate.cov_m2 + floor * np.eye(2)
        before = np.linalg.inv(cov)
        return (
            before[0, 0] + per_db**2 * (ee - shared * e * e),
            before[0, 1] + per_db**2 * (en - shared * e * n),
            before[1, 1] + per_db**2 * (nn - shared * n * n),
        )

    def _near_m(self) -> float:
        return self._settings.find_radius_m or self._settings.grid.cell_m

    def _progress(self, candidate: Unresolved, information: FloatArray) -> FloatArray:
        """(n,) reward for what is known of a candidate given this (n, k, 7)."""
        tuning, find = self._tuning, candidate.state == "found" and not candidate.may_be_two
        target = ((tuning.settled_cells if find else tuning.target_cells) * self._near_m()) ** 2
        ee, en, nn = self._precision(candidate, information)
        # Receptions still needed grow with the precision still missing: so counted, a candidate that is nearly
        # resolved is finished before the team drives to the next. Eigenvalues of the precision, closed form.
        middle, half = (ee + nn) / 2.0, np.hypot((ee - nn) / 2.0, en)
        done = (np.minimum((middle - half) * target, 1.0) + np.minimum((middle + half) * target, 1.0)) / 2.0
        receptions = candidate.rate_hz * information[..., 0]
        # A packet settles whether a find is still there; most is learnt where that is as probable as not.
        doubt = 4.0 * candidate.p_gone * (1.0 - candidate.p_gone)
        value = self._check_value * doubt * (1.0 - np.exp(-receptions))
        if find:
            value = value + tuning.settle_value * (1.0 - candidate.p_here) * done
        else:
            missing = max(1.0, self._settings.min_receptions - candidate.receptions)
            weight = tuning.inconsistent_value if candidate.state == "inconsistent" else 1.0
            received = tuning.reception_value * (1.0 - np.exp(-receptions / missing))
            value = value + weight * (tuning.resolve_value * done + received)
        return np.asarray(value.mean(axis=1))


class InfoGain2Planner(InfoGainPlanner):
    """See the module."""

    NAME: ClassVar = "infogain2"
    REWARD: ClassVar[type[Reward]] = SampledReward

    @staticmethod
    def _table(settings: EngineSettings) -> InfogainTuning:
        return settings.tuning.infogain2

    @staticmethod
    def _budget(settings: EngineSettings) -> int:
        return settings.tuning.infogain2.budget
