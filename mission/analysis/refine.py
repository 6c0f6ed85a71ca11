"""Each source once more, after the fact: place and power by weighted maximum likelihood, with their covariance.

The engine believes on a grid and in steps of power. Afterwards all detections are there at once, so that the
estimate can lie between cells. Detections are shared out over the sources by what each would have led to (EM); each
source is then where its share is most likely (RWA section VI.C, whose readings are weighted likewise). The likelihood
is the engine's: what was heard, what was heard at the receiver's ceiling, and who listened and heard nothing
(`fieldkit.engine.likelihood.levels`), with the gain towards the source where the antenna has a pattern. The
covariance is
the inverse of the observed information, that is of the log-likelihood's curvature at its top.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_ndtr, logsumexp, ndtr

from fieldkit import settings as given
from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.messages import Detection, FloatArray, SourceEstimate
from fieldkit.tuning import LikelihoodTuning

RADIO = LikelihoodTuning()

ROUNDS = 8
CLUTTER = 0.02
"""Share of transmissions taken to be from no known source."""
STEP_M, STEP_DB = 0.02, 0.05
"""For the curvature: small against any useful accuracy, large against rounding."""


_SIMPLEX = np.vstack([np.zeros(3), np.diag([0.2, 0.2, 1.0])])


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """One source after the fact."""

    ident: int
    east_m: float
    north_m: float
    power_db: float
    """Relative to the calibrated transmitter."""
    cov_m2: FloatArray
    """(2, 2) over (east, north), the power being unknown too; nan where the likelihood has no clear top."""
    power_sigma_db: float
    receptions: float
    """Detections that are this source's, each counted by the probability that it is."""
    share: FloatArray
    """(d,) probability that each detection is this source's."""
    region: tuple[tuple[tuple[float, ...], ...], ...] = ()
    """Closed rings round the 90 % region; empty: it is the covariance's ellipse."""

    @property
    def sigma_m(self) -> float:
        """Standard deviation of a coordinate, both taken together."""
        return float(np.sqrt(np.trace(self.cov_m2) / 2.0))


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """All detections as arrays over (d, robots); a robot that did not listen has no weight."""

    place_m: FloatArray
    """(d, m, 2)."""
    heading_deg: FloatArray
    """(d, m), clockwise from north: where a directional antenna points."""
    rss_dbm: FloatArray
    """(d, m), nan: listened and heard nothing."""
    saturated: np.ndarray
    listened: np.ndarray
    robots: tuple[str, ...]


def stack(detections: Sequence[Detection]) -> Heard:
    """Detections of changing teams as arrays over all robots there were."""
    robots = tuple(sorted({robot for d in detections for robot in d.robots}))
    shape = (len(detections), len(robots))
    place, heading, rss = np.zeros((*shape, 2)), np.zeros(shape), np.full(shape, np.nan)
    saturated, listened = np.zeros(shape, bool), np.zeros(shape, bool)
    for row, d in enumerate(detections):
        columns = [robots.index(robot) for robot in d.robots]
        place[row, columns], rss[row, columns] = d.position_m, d.rss_dbm
        saturated[row, columns], listened[row, columns] = d.saturated, True
        heading[row, columns] = d.heading_deg
    return Heard(place, heading, rss, saturated, listened, robots)


def log_likelihood(
    heard: Heard, antenna: Antenna, east_m: float, north_m: float, power_db: float, place_sigma_m: float
) -> FloatArray:
    """(d,) log p(what the team heard of each transmission | it came from there at that power)."""
    mean, sigma = predicted(heard, antenna, east_m, north_m, power_db, place_sigma_m)
    t = np.nan_to_num((heard.rss_dbm - mean) / sigma)
    core = np.log1p(-RADIO.outliers) - 0.5 * t**2
    tail = np.log(RADIO.outliers / RADIO.outlier_width) - 0.5 * (t / RADIO.outlier_width) ** 2
    level = np.logaddexp(core, tail) - np.log(sigma * np.sqrt(2.0 * np.pi))
    at_least = log_ndtr(-(heard.rss_dbm - 0.5 - mean) / sigma)
    silent = np.log(
        RADIO.packet_loss + (1.0 - RADIO.packet_loss) * ndtr((antenna.threshold_dbm + 0.5 - mean) / sigma)
    )
    each = np.where(np.isnan(heard.rss_dbm), silent, np.where(heard.saturated, at_least, level))
    result: FloatArray = np.where(heard.listened, each, 0.0).sum(axis=1)
    return result


def _at(x: FloatArray, heard: Heard, antenna: Antenna, place_sigma_m: float) -> FloatArray:
    """`log_likelihood` of a source (east, north, power)."""
    return log_likelihood(heard, antenna, float(x[0]), float(x[1]), float(x[2]), place_sigma_m)


def predicted(
    heard: Heard, antenna: Antenna, east_m: float, north_m: float, power_db: float, place_sigma_m: float
) -> tuple[FloatArray, FloatArray]:
    """(d, m) mean and standard deviation of each reading, in dBm and dB, from a source there."""
    way_m = np.array([east_m, north_m]) - heard.place_m
    range_m = np.maximum(np.hypot(way_m[..., 0], way_m[..., 1]), MIN_RANGE_M)
    smear = antenna.slope_db(range_m) * place_sigma_m
    variance = antenna.sigma_db**2 + 1.0 / 12.0 + smear**2 / (range_m**2 + place_sigma_m**2)
    mean = antenna.mean_rss_dbm(range_m, power_db)
    if antenna.pattern_db:
        off_front_deg = np.degrees(np.arctan2(way_m[..., 0], way_m[..., 1])) - heard.heading_deg
        mean = mean + antenna.gain_db(off_front_deg, range_m)
    return mean, np.sqrt(variance)


def refine(
    detections: Sequence[Detection],
    sources: Sequence[SourceEstimate],
    antenna: Antenna,
    *,
    size_m: tuple[float, float],
    levels_db: Sequence[float],
    place_sigma_m: float = given.POSE_SIGMA_M.default,
) -> list[Refined]:
    """All sources refined together, from their estimates on; none where nothing was heard.

    `size_m` is the field's extent east and north, which holds clutter; `levels_db` the powers it may have.
    """
    if not detections or not sources:
        return []
    heard = stack(detections)
    at = np.array([[s.east_m, s.north_m, s.power_db if np.isfinite(s.power_db) else 0.0] for s in sources])
    clutter = _clutter(heard, antenna, size_m, levels_db, place_sigma_m) + np.log(CLUTTER)
    portion = np.full(len(sources), (1.0 - CLUTTER) / len(sources))
    share = np.zeros((len(sources), len(detections)))
    for _ in range(ROUNDS):
        each = np.array([_at(row, heard, antenna, place_sigma_m) for row in at])
        each += np.log(np.maximum(portion, 1e-12))[:, None]
        before, share = share, np.exp(each - logsumexp(np.vstack([each, clutter]), axis=0))
        portion = np.maximum(share.sum(axis=1), 1e-9)
        portion *= (1.0 - CLUTTER) / portion.sum()
        at = np.array([_top(heard, antenna, row, w, place_sigma_m) for row, w in zip(at, share, strict=True)])
        if np.abs(share - before).max() < 1e-3:
            break
    return [
        _refined(source.ident, heard, antenna, row, w, place_sigma_m)
        for source, row, w in zip(sources, at, share, strict=True)
    ]


def _clutter(
    heard: Heard,
    antenna: Antenna,
    size_m: tuple[float, float],
    levels_db: Sequence[float],
    place_sigma_m: float,
) -> FloatArray:
    """(d,) the likelihood of each detection averaged over places all over the field and the levels."""
    east, north = (np.linspace(0.05, 0.95, 10) * size for size in size_m)
    each = [
        log_likelihood(heard, antenna, float(e), float(n), float(p), place_sigma_m)
        for e in east
        for n in north
        for p in levels_db
    ]
    return np.asarray(logsumexp(each, axis=0) - np.log(len(each)))


def _top(
    heard: Heard, antenna: Antenna, start: FloatArray, share: FloatArray, place_sigma_m: float
) -> FloatArray:
    """Where the shared log-likelihood is highest; the start where it has too little to go by."""
    if share.sum() < 1.0:
        return start
    found = minimize(
        lambda x: -float(np.dot(share, _at(x, heard, antenna, place_sigma_m))),
        start,
        method="Nelder-Mead",
        options={
            "xatol": 1e-3,
            "fatol": 1e-4,
            "initial_simplex": start + np.vstack([np.zeros(3), np.diag([0.2, 0.2, 1.0])]),
        },
    )
    return np.asarray(found.x)


def _refined(
    ident: int, heard: Heard, antenna: Antenna, at: FloatArray, share: FloatArray, place_sigma_m: float
) -> Refined:
    information = -_curvature(
        lambda x: float(np.dot(share, _at(x, heard, antenna, place_sigma_m))),
        at,
        np.array([STEP_M, STEP_M, STEP_DB]),
    )
    cov = np.full((3, 3), np.nan)
    if np.all(np.isfinite(information)) and np.all(np.linalg.eigvalsh(information) > 1e-9):
        cov = np.linalg.inv(information)
    east, north, power = (float(v) for v in at)
    return Refined(
        ident, east, north, power, cov[:2, :2], float(np.sqrt(cov[2, 2])), float(share.sum()), share
    )


def _curvature(value: Callable[[FloatArray], float], at: FloatArray, steps: FloatArray) -> FloatArray:
    """The matrix of second derivatives, by central differences."""
    n = len(at)
    second = np.empty((n, n))
    for i in range(n):
        for j in range(i, n):
            a, b = np.eye(n)[i] * steps[i], np.eye(n)[j] * steps[j]
            corners = value(at + a + b) - value(at + a - b) - value(at - a + b) + value(at - a - b)
            second[i, j] = second[j, i] = corners / (4.0 * steps[i] * steps[j])
    return second


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How readings lie around what the antenna file predicts, over all that are some source's for sure."""

    residual_db: FloatArray
    """(n,) reading minus prediction."""
    expected_db: FloatArray
    """(n,) the prediction's standard deviation."""
    robot: np.ndarray
    """(n,) whose reading it is."""

    @property
    def bias_db(self) -> float:
        return float(np.mean(self.residual_db)) if self.residual_db.size else float("nan")

    @property
    def spread_db(self) -> float:
        """Standard deviation of the residuals."""
        return float(np.std(self.residual_db, ddof=1)) if self.residual_db.size > 1 else float("nan")

    @property
    def promised_db(self) -> float:
        return float(np.sqrt(np.mean(self.expected_db**2))) if self.residual_db.size else float("nan")


def model_fit(
    detections: Sequence[Detection],
    refined: Sequence[Refined],
    antenna: Antenna,
    place_sigma_m: float = given.POSE_SIGMA_M.default,
) -> Fit:
    """Residuals of the readings that are one source's with at least 90 %, against that source as refined.

    Readings of weak packets are those strong enough to be heard, so that the bias far away is not zero: it counts
    only readings predicted at least two standard deviations above the threshold.
    """
    heard = stack(detections)
    residual: list[FloatArray] = []
    expected: list[FloatArray] = []
    robots: list[np.ndarray] = []
    names = np.array(heard.robots)
    for source in refined:
        mean, sigma = predicted(heard, antenna, source.east_m, source.north_m, source.power_db, place_sigma_m)
        use = (source.share >= 0.9)[:, None] & heard.listened & ~np.isnan(heard.rss_dbm) & ~heard.saturated
        use &= mean > antenna.threshold_dbm + 2.0 * sigma
        residual.append((heard.rss_dbm - mean)[use])
        expected.append(sigma[use])
        robots.append(np.broadcast_to(names, use.shape)[use])
    if not residual:
        return Fit(np.zeros(0), np.zeros(0), np.zeros(0, dtype="U1"))
    return Fit(np.concatenate(residual), np.concatenate(expected), np.concatenate(robots))
