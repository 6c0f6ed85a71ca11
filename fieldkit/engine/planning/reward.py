"""The reward of a team's path for the default planner, given the paths already planned.

The reward is the expected number of sources the path would newly hear on unsearched ground, plus the progress it would
make on candidates not yet resolved: receptions still missing, and the shrinking of their posterior by Fisher
information. A find counts by the probability that it lies a cell off, and by the doubt whether it is still there.

Progress is taken at each sample of where and how strong a candidate may be, and then averaged: a path that learns all
if the source is here and nothing if it is there makes half the progress, however much it learns here. Power counts as
unknown. A packet that two teams hear counts once, and is read at two places.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fieldkit.channel.model import MIN_RANGE_M
from fieldkit.engine.belief.base import Unresolved
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.base import HearingModel
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray
from fieldkit.tuning import InfogainTuning


class Reward:
    """What is to be gained, what the teams planned so far take of it, and what a further path would add.

    All tracks (steps, m, 2) of one reward have as many steps.
    """

    def __init__(
        self,
        settings: EngineSettings,
        tuning: InfogainTuning,
        model: HearingModel,
        ground: FloatArray,
        square_m: float,
        horizon_s: float,
        unresolved: list[Unresolved],
    ) -> None:
        self.unresolved = unresolved
        self._taken_m: FloatArray | None = None
        """(steps, k, 2): tracks of all robots so far."""
        self._settings, self._tuning = settings, tuning
        self._model = model
        self._ground = ground
        """(n_north, n_east) of squares of side `square_m`: expected number of sources not among the candidates."""
        self.square_m, self._horizon_s = square_m, horizon_s
        self._rate_hz = tuning.ground_rate * settings.reference_rate_hz
        self._check_value = tuning.check_value * math.exp(-float(ground.sum()) / tuning.check_left)
        """Less while something is left to be found."""
        self._planned_s = np.zeros(ground.shape)
        """P(heard) integrated over the time of the tracks taken."""
        self._learnt = [self._nothing(each) for each in unresolved]
        """What they learn of each candidate."""
        self._scratch = np.empty(ground.shape)

    def left(self) -> FloatArray:
        """(n_north, n_east) of squares: sources that the tracks taken would leave unheard."""
        return np.asarray(self._ground * np.exp(-self._rate_hz * self._planned_s))

    def take(self, track_m: FloatArray, ears: FloatArray) -> None:
        """What this track gains is no gain for others; `ears` (m, 3) of its robots as `hearing_of` gives them."""
        self._scratch[:] = 0.0
        self._newly_heard(track_m[None], np.ones(1), ears)
        self._planned_s += self._scratch
        for index, candidate in enumerate(self.unresolved):
            information = self._information_of(candidate, track_m[None], ears)
            self._learnt[index] = self._with(self._learnt[index], information)[0]
        before = self._taken_m
        self._taken_m = track_m if before is None else np.concatenate([before, track_m], axis=1)

    def of(self, tracks_m: FloatArray, ears: FloatArray) -> FloatArray:
        """(n,) of tracks (n, steps, m, 2): sources newly heard, and progress with those not resolved.

        -inf where a track comes nearer than the separation to one that was taken.
        """
        total = self._newly_heard(tracks_m, self._clear(tracks_m), ears)
        for candidate, before in zip(self.unresolved, self._learnt, strict=True):
            information = self._information_of(candidate, tracks_m, ears)
            after = self._progress(candidate, self._with(before, information))
            total += np.where(
                self._is_heard(information), after - self._progress(candidate, before[None]), 0.0
            )
        return total

    def _clear(self, tracks_m: FloatArray) -> FloatArray:
        """(n,) 1 where a track keeps the separation from all that were taken, else 0."""
        clear = np.ones(len(tracks_m))
        if self._taken_m is not None:
            path_loops.all_clear(tracks_m, self._taken_m, self._settings.min_separation_m, clear)
        return clear

    def _newly_heard(self, tracks_m: FloatArray, clear: FloatArray, ears: FloatArray) -> FloatArray:
        """(n,) expected number of sources; the last track's own exposure is left in the scratch."""
        gain = np.empty(len(tracks_m))
        path_loops.all_ground_gains(
            tracks_m,
            clear,
            self._tuning.step_s,
            self.left(),
            self.square_m,
            self._model.hear_known_mean,
            self._model.step2_m2,
            self._model.search_reach_m,
            self._rate_hz,
            ears,
            self._scratch,
            gain,
        )
        return gain

    # -- candidates --------------------------------------------------------------------------------------

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

        A packet that two hear is one packet, read at two places.
        """
        free = 1.0 - np.minimum(before[:, :1] / self._horizon_s, 1.0)
        both = before + information
        both[..., :1] = before[:, :1] + free * information[..., :1]
        return np.asarray(both)

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


def hearing_of(settings: EngineSettings, robots: Sequence[str], up_m: Mapping[str, float]) -> FloatArray:
    """(m, 3) of robots for `path_loops.as_far2`: height above the sources, factor of the threshold, elevation's power.

    A pattern by azimuth is left out: planned paths have no headings yet.
    """
    ten_beta = 10.0 * settings.antenna.path_loss_exponent
    kappa = settings.spread.elevation if settings.spread is not None else 0.0
    ears = np.empty((len(robots), 3))
    for row, robot in enumerate(robots):
        radio = settings.receivers.get(robot)
        higher_db = 0.0
        if radio is not None:
            own = settings.antenna.threshold_dbm if radio.threshold_dbm is None else radio.threshold_dbm
            higher_db = own - radio.offset_db - settings.antenna.threshold_dbm
        ears[row] = (
            up_m.get(robot, 0.0) - settings.source_up_m,
            10.0 ** (2.0 * higher_db / ten_beta),
            20.0 * kappa / ten_beta,
        )
    return ears
