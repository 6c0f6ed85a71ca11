"""What one candidate's readings, and the team's silence, have in common: places, receivers, the transmitter's lobe.

A reading is conditioned on the candidate's own earlier readings nearby (`correlated` says how and why); what is heard
of it at the fiftieth time in one place says little new. A place that has been silent for long is one witness: the
longer, the less a further second counts there. Without place noise both are what independent readings give.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import log_ndtr

from fieldkit.channel import law
from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.likelihood import levels_loops
from fieldkit.engine.likelihood.ears_loops import COLUMNS, NORTH, OFFSET, SIGMA, THRESHOLD, UP
from fieldkit.engine.likelihood.levels import PER_SIGMA, SILENT_FROM, LevelsModel, tables
from fieldkit.engine.likelihood.levels_loops import SILENT_BELOW
from fieldkit.engine.likelihood.places_loops import choose_neighbours, weigh
from fieldkit.messages import Detection, FloatArray, IntArray

NEIGHBOURS = 6
REACH = 2.5
"""Readings further away than so many correlation lengths are no neighbours."""
DEEPEST = 2.0
"""No shadow of more deviations than this is expected from what neighbours heard."""
LEVEL_STEP_DB = 3.0
SPENT_S = (0.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 640.0)
"""Seconds a place has been listened at, at which P(heard) of a further second is tabled."""
_DEVIATES = np.array([-2.0, -1.2, -0.4, 0.4, 1.2, 2.0])
_WEIGHTS = np.exp(-0.5 * _DEVIATES**2) / np.exp(-0.5 * _DEVIATES**2).sum()


def levels_of(known_db: tuple[float, ...], spread: ChannelSpread | None) -> tuple[float, ...]:
    """The power hypotheses: the known levels, and where transmitters differ all between and around them.

    A shadow that a source lies under all over looks like another power: without room for it the source is taken
    for one of no known level.
    """
    if spread is None or spread.sigma_place_db <= 0.0:
        return known_db
    wide = float(np.hypot(min(spread.transmitter_db, 12.0), spread.sigma_place_db))
    low, high = min(known_db) - wide, max(known_db) + wide
    return tuple(np.linspace(low, high, max(3, int(np.ceil((high - low) / LEVEL_STEP_DB)) + 1)).tolist())


@lru_cache(maxsize=2)
def _hear_after_silence(
    antenna: Antenna,
    level_dbm: tuple[float, ...],
    packet_loss: float,
    squared_ranges: tuple[int, float],
    variances: tuple[float, float],
    rate_hz: float,
) -> FloatArray:
    """(spent, h - 1, steps) P(heard) that a further second counts for after a silence of each of SPENT_S.

    E[p exp(-rate p T)] / E[exp(-rate p T)] over the shadowing that the place may have. `squared_ranges`: how many, and
    their step in m^2; `variances`: in place and in time. The tables are large and slow, and alike for missions alike.
    """
    steps, step2_m2 = squared_ranges
    place_var, time_var = variances
    range_m = np.sqrt((np.arange(steps) + 0.5) * step2_m2)
    margin = np.array(level_dbm)[:, None] - antenna.loss_db(range_m) - antenna.threshold_dbm - 0.5
    shadows_db = _DEVIATES * np.sqrt(place_var)
    heard = [(1.0 - packet_loss) * np.exp(log_ndtr((margin + db) / np.sqrt(time_var))) for db in shadows_db]
    least = np.minimum.reduce(heard)
    tables = np.empty((len(SPENT_S), *margin.shape))
    for table, spent_s in zip(tables, SPENT_S, strict=True):
        top, below = np.zeros(margin.shape), np.zeros(margin.shape)
        for each, weight in zip(heard, _WEIGHTS, strict=True):
            silent = weight * np.exp(-rate_hz * each * spent_s)
            top += each * silent
            below += silent
        # So long a silence of so busy a source is too improbable for a number: the deepest shadow is what is left.
        table[...] = np.divide(top, below, out=least.copy(), where=below > 0.0)
    return tables


@dataclass(frozen=True, slots=True, eq=False)
class Earlier:
    """A candidate's own readings: by which ears (k, columns) and how strong (k,); -inf where those heard nothing.

    Who listened and heard nothing is among them: a place where some packets are heard and some are not would else be
    known by the strong ones alone, and every silence there would be a surprise that another source, far away, explains.
    """

    ears: FloatArray
    rss_dbm: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """Of each of m ears the `count` (m,) nearest readings before it, as `choose_neighbours` has them."""

    ears: FloatArray
    rss_dbm: FloatArray
    count: IntArray
    cross_db2: FloatArray
    cov_db2: FloatArray

    def of_one_lobe(self, lobe_var: float, own: FloatArray, theirs: FloatArray) -> "Neighbours":
        """With what a transmitter's lobe adds: directions from it `own` (m, 2) to the ears, `theirs` (m, k, 2)."""
        cross = self.cross_db2 + lobe_var * (theirs * own[:, None]).sum(axis=-1)
        cov = self.cov_db2 + lobe_var * (theirs[:, :, None] * theirs[:, None]).sum(axis=-1)
        return replace(self, cross_db2=cross, cov_db2=cov)

    def weighed(self, noise_db2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(m, k) what each counts for, with so much variance (m, k) of its own, and (m,) dB^2 that they explain."""
        weights, explained = np.zeros_like(self.cross_db2), np.zeros(len(self.count))
        work, part = np.empty(self.cov_db2.shape[1:]), np.empty(NEIGHBOURS)
        for q, count in enumerate(self.count):
            explained[q] = weigh(
                count, self.cov_db2[q], self.cross_db2[q], noise_db2[q], work, part, weights[q]
            )
        return weights, explained


NOTHING_EARLIER = Earlier(np.zeros((0, COLUMNS)), np.zeros(0))


class PlaceNoise:
    """See the module; for one channel."""

    def __init__(self, model: LevelsModel, spread: ChannelSpread, rate_hz: float) -> None:
        self.model = model
        # Without a length of correlation every reading has a shadow of its own, as it has noise of its own.
        own_var = spread.sigma_place_db**2 if spread.correlation_m <= 0.0 else 0.0
        self.place_var = spread.sigma_place_db**2 - own_var
        self.time_var = spread.sigma_time_db**2 + own_var
        self.lobe_var = spread.lobe_db**2
        self.length_m = max(spread.correlation_m, 1e-6)
        self._spent_s: dict[tuple[int, int], float] = {}
        self._hear = _hear_after_silence(
            model.antenna,
            tuple(model.level_dbm.tolist()),
            model.tuning.packet_loss,
            (model.hear.shape[1], model.step2_m2),
            (self.place_var, self.time_var),
            rate_hz,
        )

    def listen(self, exposure_s: FloatArray, cell_m: float, ears: FloatArray, duration_s: float) -> None:
        """Add what a stretch of listening by ears (m, columns) counts for, and remember where it was."""
        keys = [tuple(each) for each in np.floor(ears[:, : UP + 1] / self.length_m).astype(int).tolist()]
        spent = np.array([self._spent_s.get(key, 0.0) for key in keys])
        which = np.argmin(np.abs(spent[:, None] - np.array(SPENT_S)), axis=1).astype(np.int64)
        for key in keys:
            self._spent_s[key] = self._spent_s.get(key, 0.0) + duration_s
        levels_loops.add_exposure_of_ears(
            exposure_s,
            cell_m,
            ears,
            which,
            self._hear,
            self.model.step2_m2,
            self.model.limit2_m2,
            self.model.antenna.threshold_dbm,
            self.model.ears.law,
            self.model.ears.pattern_db,
            self.model.ears.best_db,
            duration_s,
        )

    def log_likelihood(self, detection: Detection, points_m: FloatArray, earlier: Earlier) -> FloatArray:
        """(h, n): as the model's, given what was heard earlier of the same source, and by robots named before."""
        ears = self.model.ears.of_detection(detection)
        near = self._neighbours(detection, ears, earlier)
        fixed = np.empty((self.model.level_dbm.size, points_m.shape[0]))
        levels_loops.conditional_loglik(
            np.ascontiguousarray(points_m),
            ears,
            detection.rss_dbm,
            detection.saturated.astype(float),
            near.ears.reshape(-1, COLUMNS),
            near.rss_dbm,
            near.count,
            near.cross_db2,
            near.cov_db2,
            self.place_var,
            self.time_var,
            self.lobe_var,
            DEEPEST,
            self.model.level_dbm,
            self.model.ears.law,
            self.model.ears.pattern_db,
            self.model.tuning.packet_loss,
            self.model.tuning.outliers,
            self.model.tuning.outlier_width,
            *tables(self.model.tuning),
            SILENT_FROM,
            PER_SIGMA,
            fixed,
        )
        known = fixed[: self.model.n_known]
        best = known.max(axis=0)
        varying = best + np.log(np.exp(known - best).mean(axis=0))
        return np.concatenate([fixed, varying[None, :]])

    def misfit(
        self, detections: Sequence[Detection], point_m: FloatArray, level_dbm: float
    ) -> tuple[float, int]:
        """Mean squared standardised residual one step ahead of a source's readings, and how many there are."""
        squares: list[float] = []
        earlier = NOTHING_EARLIER

        def unsure_db2(ears: FloatArray) -> FloatArray:
            flat2 = ((ears[..., : NORTH + 1] - point_m) ** 2).sum(axis=-1)
            d2 = np.maximum(flat2 + ears[..., UP] ** 2, MIN_RANGE_M**2)
            slope = law.slope_db(0.5 * np.log10(d2), self.model.ears.law)
            return np.asarray(slope**2 * ears[..., SIGMA] ** 2 / (d2 + ears[..., SIGMA] ** 2))

        def toward(ears: FloatArray) -> FloatArray:
            way = ears[..., : NORTH + 1] - point_m
            d2 = np.maximum((way**2).sum(axis=-1) + ears[..., UP] ** 2, MIN_RANGE_M**2)
            return np.asarray(way / np.sqrt(d2 + ears[..., SIGMA] ** 2)[..., None])

        def fainter_db(ears: FloatArray) -> FloatArray:
            rows = ears.reshape(-1, COLUMNS)
            loss: FloatArray = self.model.ears.attenuation_db(point_m[None], rows)[0].reshape(ears.shape[:-1])
            return loss

        for detection in detections:
            ears = self.model.ears.of_detection(detection)
            alone = self._neighbours(detection, ears, earlier)
            near = alone.of_one_lobe(self.lobe_var, toward(ears), toward(alone.ears))
            weights, explained = near.weighed(self.time_var + 1.0 / 12.0 + unsure_db2(near.ears))
            silent = np.isinf(near.rss_dbm)
            typical = SILENT_BELOW * np.sqrt(self.place_var + self.time_var)
            read = np.where(silent, near.ears[..., THRESHOLD] + 0.5 - typical, near.rss_dbm)
            off = read - level_dbm + fainter_db(near.ears)
            off = weights * np.where(silent, np.minimum(off, 0.0), off)
            alike = self.place_var + ears[:, OFFSET] + self.lobe_var * (toward(ears) ** 2).sum(axis=-1)
            furthest = DEEPEST * np.sqrt(alike)
            expected = np.clip(off.sum(axis=1), -furthest, furthest)
            use = detection.heard & ~detection.saturated
            variance = self.time_var + alike - explained + unsure_db2(ears) + 1.0 / 12.0
            residual = detection.rss_dbm - level_dbm + fainter_db(ears) - expected
            squares += np.minimum(residual[use] ** 2 / variance[use], 12.0).tolist()
            told = ~detection.saturated
            earlier = Earlier(
                np.concatenate([earlier.ears, ears[told]]),
                np.concatenate([earlier.rss_dbm, np.where(use, detection.rss_dbm, -np.inf)[told]]),
            )
        return (float(np.mean(squares)) if squares else 0.0), len(squares)

    def _neighbours(self, detection: Detection, ears: FloatArray, earlier: Earlier) -> Neighbours:
        """Of each robot the nearest earlier readings."""
        m = ears.shape[0]
        near = Neighbours(
            np.zeros((m, NEIGHBOURS, COLUMNS)),
            np.zeros((m, NEIGHBOURS)),
            np.zeros(m, dtype=np.int64),
            np.zeros((m, NEIGHBOURS)),
            np.zeros((m, NEIGHBOURS, NEIGHBOURS)),
        )
        choose_neighbours(
            np.argsort(~detection.heard, kind="stable"),  # who heard goes first: silence is conditioned on it
            ears,
            np.where(detection.heard, detection.rss_dbm, -np.inf),
            (~detection.saturated).astype(float),
            np.ascontiguousarray(earlier.ears),
            np.ascontiguousarray(earlier.rss_dbm),
            self.place_var,
            self.length_m,
            REACH * self.length_m,
            near.ears,
            near.rss_dbm,
            near.count,
            near.cross_db2,
            near.cov_db2,
        )
        return near


def redundancy(place_m: Sequence[FloatArray], spread: ChannelSpread) -> FloatArray:
    """(k,) how much each detection counts when its neighbours are not conditioned on: 1 for one that stands alone."""
    if not place_m:
        return np.ones(0)
    middle = np.array([each.mean(axis=0) for each in place_m])
    apart = np.sqrt(((middle[:, None] - middle[None]) ** 2).sum(axis=-1))
    part = spread.sigma_place_db**2 / (spread.sigma_place_db**2 + spread.sigma_time_db**2 + 1.0 / 12.0)
    shared = part * np.exp(-apart / max(spread.correlation_m, 1e-6))
    np.fill_diagonal(shared, 0.0)
    return np.asarray(1.0 / (1.0 + shared.sum(axis=1)))
