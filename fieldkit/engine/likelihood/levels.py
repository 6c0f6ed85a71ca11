"""The exact likelihood of what a team heard, for sources at one of a known set of power levels.

For each robot independently, with mean reading mu = w - 10 beta log10 d (PRWA eq 3, d clamped at `MIN_RANGE_M`):

- heard z:            N(z; mu, sigma^2 + 1/12), the integer rounding as extra variance;
- heard at the ceiling: 1 - Phi((z - 1/2 - mu) / sigma);
- listened, silent:     Phi((threshold + 1/2 - mu) / sigma), a robot hears iff its integer reading exceeds zeta.

Radios are not ideal: a small share of packets is lost at any strength, and a small share of readings scatters
several times as wide. Both keep one odd reading from vetoing the truth; the wide part still falls off with
distance, so that a source does not claim what was heard at the other end of the field.

Neither robots nor candidate places are points: a place known to s metres smears a reading at distance d by
(10 beta / ln 10) s / sqrt(d^2 + s^2) dB, which is added to sigma; close by it is what matters most.

Besides the known levels there are hypotheses beyond them, with a small prior: when they win, the calibration or
the power set is wrong, and the belief says so instead of naming a position. The last hypothesis is a source whose
level changes from packet to packet (PRWA assumption a.4).
"""

from functools import lru_cache

import numpy as np
from scipy.special import log_ndtr, logsumexp, ndtr

from fieldkit.channel import law
from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.engine.likelihood import levels_loops
from fieldkit.engine.likelihood.ears import Ears
from fieldkit.messages import Detection, FloatArray
from fieldkit.tuning import LikelihoodTuning

UNHEARD = 1e-5
"""A packet heard so rarely says nothing by its absence."""
SILENT_FROM, PER_SIGMA = -10.0, 100.0
_STEPS = 4096
"""Steps of the hearing tables in squared distance, out to `reach_m`."""


@lru_cache(maxsize=4)
def tables(tuning: LikelihoodTuning) -> tuple[FloatArray, FloatArray]:
    """log P(silent) by standard deviations above the threshold, and the log of the heard density's shape by |t|.

    Linear in between is right to 2e-5 nats.
    """
    x = np.arange(SILENT_FROM, 14.0, 1.0 / PER_SIGMA)
    silent = np.log(tuning.packet_loss + (1.0 - tuning.packet_loss) * ndtr(-x))
    t = np.arange(0.0, 80.0, 1.0 / PER_SIGMA)
    core = np.log1p(-tuning.outliers) - 0.5 * t**2
    tail = np.log(tuning.outliers / tuning.outlier_width) - 0.5 * (t / tuning.outlier_width) ** 2
    return silent, np.logaddexp(core, tail)


class LevelsModel:
    """Likelihoods and hearing probabilities under each power hypothesis.

    Hypotheses (h): the known levels, levels outside them, and last the varying level.
    """

    def __init__(
        self,
        antenna: Antenna,
        power_levels_db: tuple[float, ...],
        place_sigma_m: float,
        tuning: LikelihoodTuning = LikelihoodTuning(),
        ears: Ears | None = None,
    ) -> None:
        """`place_sigma_m`: how unsure places are, of receivers and candidates together; `ears` knows better of each."""
        self.tuning = tuning
        self.ears = ears or Ears(antenna, point_sigma_m=place_sigma_m)
        known = np.sort(np.asarray(power_levels_db, dtype=float))
        outside = np.concatenate(
            [known[0] - np.array(tuning.outside_db), known[-1] + np.array(tuning.outside_db)]
        )
        self.antenna = antenna
        self.place_sigma_m = place_sigma_m
        self.n_known = known.size
        self.power_db = np.concatenate([known, outside])
        """(h - 1,) power of each fixed-level hypothesis."""
        self.level_dbm = antenna.power_at_1m_dbm + self.power_db
        varying = tuning.prior_varying if known.size > 1 else 1e-6
        self.log_prior = np.log(
            np.concatenate(
                [
                    np.full(known.size, (1.0 - tuning.prior_outside - varying) / known.size),
                    np.full(outside.size, tuning.prior_outside / outside.size),
                    [varying],
                ]
            )
        )
        """(h,) log prior of each hypothesis."""
        self.outside = np.zeros(self.log_prior.size, dtype=bool)
        self.outside[known.size : known.size + outside.size] = True
        self.reach_m = self._reach_m(known[-1])
        """Beyond this, not one packet in 500 of the strongest known level is heard."""
        self.reach_outside_m = self._reach_m(self.power_db.max())
        """The same for the strongest hypothesis."""
        self.step2_m2 = self.reach_m**2 / _STEPS
        squared = (np.arange(int(self.reach_outside_m**2 / self.step2_m2) + 2) + 0.5) * self.step2_m2
        self.hear = np.exp(self.log_hear(np.sqrt(squared), self.level_dbm[:, None]))
        """(h - 1, steps) P(one robot hears) at squared distances (k + 1/2) * step2_m2."""
        unheard = np.array([np.flatnonzero(row >= UNHEARD).max(initial=-1) + 1 for row in self.hear])
        self.limit2_m2 = unheard * self.step2_m2
        """(h - 1,) squared distance from which on a source of that power counts as not heard at all."""
        self.hear_known_mean = np.ascontiguousarray(self.hear[: known.size, : _STEPS + 2].mean(axis=0))
        """(steps,) the same averaged over the known levels, up to `reach_m`."""
        heard = np.flatnonzero(self.hear_known_mean > 0.01)
        self.search_reach_m = float(np.sqrt((heard.max(initial=0) + 1) * self.step2_m2))
        """Beyond this, not one packet in a hundred is heard, on average over the known levels."""

    def log_hear(self, range_m: FloatArray, level_dbm: FloatArray) -> FloatArray:
        """log P(a robot hears a packet) at `range_m` from a source of power `level_dbm` at 1 m."""
        mean = level_dbm - self.antenna.loss_db(range_m)
        margin = (mean - self.antenna.threshold_dbm - 0.5) / self.antenna.sigma_db
        result: FloatArray = np.log1p(-self.tuning.packet_loss) + log_ndtr(margin)
        return result

    def _reach_m(self, strongest_db: float) -> float:
        margin_db = (
            self.antenna.power_at_1m_dbm
            + strongest_db
            + self.ears.best_db
            - self.antenna.threshold_dbm
            - 0.5
            + 2.9 * self.antenna.sigma_db
        )
        return float(10.0 ** law.decades_at(margin_db, self.antenna.law))

    def log_likelihood(self, detection: Detection, points_m: FloatArray) -> FloatArray:
        """(h, n): log p(what the team heard | a source at points_m (n, 2) sent it), under each hypothesis."""
        fixed = self._fixed_log_likelihood(detection, points_m, self.level_dbm)
        known = fixed[: self.n_known]
        best = known.max(axis=0)
        varying = best + np.log(np.exp(known - best).mean(axis=0))
        return np.concatenate([fixed, varying[None, :]])

    def known_log_likelihood(
        self, detection: Detection, points_m: FloatArray, ears: Ears | None = None
    ) -> FloatArray:
        """(known levels, n): the same under the known levels alone; `ears` for points that are further apart."""
        return self._fixed_log_likelihood(detection, points_m, self.level_dbm[: self.n_known], ears)

    def _fixed_log_likelihood(
        self, detection: Detection, points_m: FloatArray, level_dbm: FloatArray, ears: Ears | None = None
    ) -> FloatArray:
        fixed = np.empty((level_dbm.size, points_m.shape[0]))
        levels_loops.levels_loglik(
            np.ascontiguousarray(points_m),
            (ears or self.ears).of_detection(detection),
            detection.rss_dbm,
            detection.saturated.astype(float),
            level_dbm,
            self.ears.law,
            self.ears.pattern_db,
            self.antenna.sigma_db,
            self.tuning.packet_loss,
            self.tuning.outliers,
            self.tuning.outlier_width,
            *tables(self.tuning),
            SILENT_FROM,
            PER_SIGMA,
            fixed,
        )
        return fixed

    def spread_db(self, range_m: FloatArray) -> FloatArray:
        """Standard deviation of a reading at `range_m`: the antenna's sigma, the place's smear, the rounding."""
        smear = self.antenna.slope_db(range_m) * self.place_sigma_m
        result: FloatArray = np.sqrt(
            self.antenna.sigma_db**2
            + smear**2 / (np.maximum(range_m, MIN_RANGE_M) ** 2 + self.place_sigma_m**2)
            + 1.0 / 12.0
        )
        return result

    def marginal(self, log_likelihood: FloatArray) -> FloatArray:
        """(n,): the hypotheses of `log_likelihood` (h, n) averaged under their prior."""
        return np.asarray(logsumexp(log_likelihood + self.log_prior[:, None], axis=0))
