"""Fit received power against distance: w - 10 beta log10(d), by interval-censored maximum likelihood.

`fit` is a pure function of readings and options. What its result is good for is verdict.py's business.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from calibration import likelihood
from calibration.dataset import Readings
from calibration.likelihood import Rows
from calibration.observations import Missed, first_guess, fitted_mean, make_rows
from calibration.spread import clustered, split_sigma, standard_errors
from calibration.threshold import Threshold, estimate_threshold
from fieldkit import settings as given
from fieldkit.channel.model import Antenna
from fieldkit.errors import CalibrationRefused
from fieldkit.messages import FloatArray

#: Packets this far above the weakest reading may still get lost where the threshold jitters: a first guess.
RECENSOR_DB = 3.5
#: Beyond this many standard deviations of the threshold's jitter every packet is received (99.4 %).
SAFE_JITTERS = 2.5
MAX_ROUNDS, OUTLIER_ROUNDS = 12, 6
#: Farther from its mean, in sigma, a reading is another transmitter or a fault (normal: 1 in 2 million).
OUTLIER_SIGMA = 5.0
PARAMETERS = ("power_at_1m_dbm", "path_loss_exponent", "sigma_db")


@dataclass(frozen=True, slots=True)
class Options:
    """How to fit. None: find out from the readings."""

    missed: Missed = given.MISSED
    """counted: every packet sent is a row; none: all were received; uncounted: weak ones may be absent."""
    saturation_dbm: float | None = None
    min_distance_m: float = 0.0
    receiver_offsets: bool = False
    """One more parameter for each receiver after the first: how much more it reports than the first."""


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """What the readings say. Intervals and errors are clustered by place unless said otherwise."""

    antenna: Antenna
    converged: bool
    theta: FloatArray
    """power at 1 m, exponent, [pattern, receiver offsets...], ln sigma."""
    covariance: FloatArray
    """Of `theta`, clustered by place."""
    naive_covariance: FloatArray
    """Of `theta`, as if all readings were independent: far too small."""
    quantile: float
    """Student's t for 95 % with one degree of freedom for each place beyond the parameters."""
    intervals_95: dict[str, tuple[float, float]]
    threshold: Threshold
    missed: Missed
    """As decided: never auto."""
    stated: bool
    """Whether the user said so, rather than the readings."""
    sigma_time_db: float | None
    """Deviation within a place; None where no three places are free of censoring."""
    sigma_place_db: float | None
    """Deviation from place to place that is left: averaging at one spot does not reduce it."""
    nll: float
    n_readings: int
    n_missed: int
    n_saturated: int
    n_places: int
    n_outliers: int
    n_lost_near: int
    """Packets missed where nothing weak enough can explain it: collisions; left out."""
    readings: Readings = field(repr=False)
    """What was fitted, outliers taken out."""
    rows: Rows = field(repr=False)
    censor_dbm: float | None = None
    """At or below this level readings were counted as missed; None where nothing is censored."""
    receiver_offsets_db: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Receiver to its offset from the first one, and the 95 % half-width."""

    def errors(self) -> dict[str, float]:
        """Standard errors, clustered."""
        root = standard_errors(self.covariance)
        return {**dict(zip(PARAMETERS[:2], root, strict=False)), "sigma_db": root[-1] * self.antenna.sigma_db}

    def mean_dbm(self, distance_m: FloatArray) -> FloatArray:
        """Mean level at a distance from the calibrated transmitter, for the first receiver."""
        return self.antenna.mean_rss_dbm(distance_m)


def fit(readings: Readings, options: Options | None = None) -> FitResult:
    """Fit the log-distance model. Raises `CalibrationRefused` where there is nothing to fit."""
    options = options or Options()
    if options.min_distance_m > 0.0:
        readings = readings.keep(readings.distance_m >= options.min_distance_m)
    heard = ~readings.missed
    if heard.sum() < 10 or len(np.unique(readings.distance_m[heard])) < 2:
        distances = len(np.unique(readings.distance_m[heard]))
        raise CalibrationRefused(
            f"{readings.name}: {heard.sum()} readings at {distances} distances cannot carry a fit: at least "
            f"10 at 5 places are needed, the farthest 3 times the nearest{_and(readings.warnings)}"
        )
    if len(np.unique(readings.rss_dbm[heard])) < 2:
        raise CalibrationRefused(
            f"{readings.name}: all {heard.sum()} readings are {readings.rss_dbm[heard][0]:g} dBm: "
            "the receiver "
            "repeats one value, or is saturated; see that new packets arrive, and go farther away"
        )
    missed = decide_missed(readings, options.missed)
    return _fit(readings, missed, options)


def _and(warnings: tuple[str, ...]) -> str:
    return f" ({'; '.join(warnings)})" if warnings else ""


def decide_missed(readings: Readings, wish: Missed) -> Missed:
    """Whether missed packets are in the file. `auto` takes a single empty reading as proof that they are."""
    if wish != "auto":
        return wish
    return "counted" if readings.missed.any() else "none"


@dataclass(frozen=True, slots=True)
class _Agreed:
    """Where the rounds of fitting, leaving out and fitting again have come to rest."""

    theta: FloatArray
    converged: bool
    threshold: Threshold
    readings: Readings
    """Without what was left out."""
    rows: Rows
    censor_dbm: float | None
    saturation_dbm: float | None
    n_outliers: int
    n_lost: int


def _agree(readings: Readings, missed: Missed, options: Options) -> _Agreed:
    """Fit until what counts as an outlier, as saturated and as hidden by the threshold no longer changes."""
    n_outliers = n_lost = 0
    saturation, offsets = options.saturation_dbm, options.receiver_offsets
    level = readings.rss_dbm[~readings.missed]
    censor = _first_censor_level(level, missed)
    theta: FloatArray | None = None
    for number in range(MAX_ROUNDS):
        rows = make_rows(readings, missed, censor, saturation, offsets)
        if not np.isfinite(rows.low_dbm).any():
            raise CalibrationRefused(
                f"{readings.name}: every reading is so near the threshold that receiving it may be chance; "
                "collect nearer to the transmitter"
            )
        theta, converged = likelihood.maximise(rows, first_guess(rows) if theta is None else theta)
        if saturation is None and _piles_up(theta, readings):
            saturation = float(level.max())
            continue
        odd, lost = _odd(theta, readings, censor, offsets)
        # More than a few are no outliers but another model; the verdict sees them in the residuals.
        few = odd.sum() <= 0.02 * len(level) + 1 and number < OUTLIER_ROUNDS
        if few and (odd | lost).any():
            n_outliers, n_lost = n_outliers + int(odd.sum()), n_lost + int(lost.sum())
            readings = readings.keep(~(odd | lost))
            continue
        mean = fitted_mean(theta, readings, offsets)
        sigma = float(np.exp(theta[-1]))
        threshold = estimate_threshold(mean, sigma, readings, missed)
        # A threshold that jitters loses packets well above it: count that whole region as hidden, fit again.
        if not threshold.jitter_db:
            break
        wanted = float(np.floor(threshold.dbm + SAFE_JITTERS * threshold.jitter_db))
        if wanted == censor:
            break
        censor = wanted
    assert theta is not None
    return _Agreed(theta, converged, threshold, readings, rows, censor, saturation, n_outliers, n_lost)


def _fit(every: Readings, missed: Missed, options: Options) -> FitResult:
    agreed = _agree(every, missed, options)
    theta, rows, readings = agreed.theta, agreed.rows, agreed.readings
    saturation, threshold = agreed.saturation_dbm, agreed.threshold
    sigma = float(np.exp(theta[-1]))
    covariance, naive, quantile = clustered(theta, rows)
    result = FitResult(
        antenna=Antenna(float(theta[1]), float(theta[0]), sigma, threshold.dbm, saturation),
        converged=agreed.converged and bool(np.all(np.isfinite(covariance))),
        theta=theta,
        covariance=covariance,
        naive_covariance=naive,
        quantile=quantile,
        intervals_95={},
        threshold=threshold,
        missed=missed,
        stated=options.missed != "auto",
        sigma_time_db=None,
        sigma_place_db=None,
        nll=likelihood.nll(theta, rows),
        n_readings=int((~readings.missed).sum()),
        n_missed=int(readings.missed.sum()) + agreed.n_lost,
        n_saturated=0 if saturation is None else int((readings.rss_dbm >= saturation).sum()),
        n_places=readings.n_places,
        n_outliers=agreed.n_outliers,
        n_lost_near=agreed.n_lost,
        readings=readings,
        rows=rows,
        censor_dbm=agreed.censor_dbm,
    )
    time_db, place_db = split_sigma(readings, sigma, saturation)
    by_receiver = offsets_of(result) if options.receiver_offsets else {}
    return replace(
        result,
        intervals_95=intervals(result),
        sigma_time_db=time_db,
        sigma_place_db=place_db,
        receiver_offsets_db=by_receiver,
    )


def _first_censor_level(level: FloatArray, missed: Missed) -> float | None:
    if missed == "none":
        return None
    weakest = float(level.min())
    safe = float(np.floor(weakest - 1.0 + RECENSOR_DB))
    # Caution must not hide most of what there is.
    return safe if missed == "counted" and np.mean(level > safe) > 0.5 else weakest - 1.0


def _piles_up(theta: FloatArray, readings: Readings) -> bool:
    """Whether many more readings stand at the strongest level than its neighbours' mean can explain."""
    z = readings.rss_dbm[~readings.missed]
    top = z.max()
    mean = fitted_mean(theta[[0, 1, -1]], readings.keep(~readings.missed))
    sigma = float(np.exp(theta[-1]))
    from scipy.special import ndtr

    at_top = float((ndtr((top + 0.5 - mean) / sigma) - ndtr((top - 0.5 - mean) / sigma)).sum())
    above = float(ndtr((mean - top - 0.5) / sigma).sum())
    places = len(np.unique(readings.place[~readings.missed][z == top]))
    return bool((z == top).sum() > 2.0 * at_top + 5.0 and above > 5.0 and places >= 2)


def _odd(
    theta: FloatArray, readings: Readings, censor_dbm: float | None, receiver_offsets: bool
) -> tuple[np.ndarray, np.ndarray]:
    """(n,) readings too far from their mean, and packets missed where all should be heard."""
    mean = fitted_mean(theta, readings, receiver_offsets)
    sigma = float(np.exp(theta[-1]))
    with np.errstate(invalid="ignore"):
        odd = np.abs(readings.rss_dbm - mean) > OUTLIER_SIGMA * sigma + 0.5
    level = -np.inf if censor_dbm is None else censor_dbm
    lost = readings.missed & (mean - level > OUTLIER_SIGMA * sigma)
    return odd, lost


def intervals(result: FitResult) -> dict[str, tuple[float, float]]:
    """95 % by the clustered covariance and Student's t."""
    half = result.quantile * standard_errors(result.covariance)
    low, high = result.theta - half, result.theta + half
    return {
        "power_at_1m_dbm": (float(low[0]), float(high[0])),
        "path_loss_exponent": (float(low[1]), float(high[1])),
        "sigma_db": (float(np.exp(low[-1])), float(np.exp(high[-1]))),
        "threshold_dbm": result.threshold.interval_95,
    }


def offsets_of(result: FitResult) -> dict[str, tuple[float, float]]:
    """Receiver to its offset from the first and the 95 % half-width."""
    half = result.quantile * standard_errors(result.covariance)
    names = result.readings.receivers[1:]
    return {name: (float(result.theta[2 + i]), float(half[2 + i])) for i, name in enumerate(names)}
