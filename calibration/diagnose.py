"""Questions put to a fit: does anything else show in the residuals, was something left out or swapped?"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from calibration import likelihood
from calibration.fit import FitResult
from calibration.likelihood import Rows
from calibration.observations import fitted_mean, make_rows
from calibration.spread import clustered
from fieldkit.messages import FloatArray

SUSPECT_NATS, SURE_NATS = 3.0, 6.0
UNITS = (("centimetres", 100.0), ("millimetres", 1000.0))
LARGEST_SPREAD_LEFT = 2.0 / 3.0
OUT_OF_REACH_M = 100_000.0
"""No radio calibrated here reaches this far: coordinates that say so are exchanged."""


@dataclass(frozen=True, slots=True)
class Structure:
    """A pattern in the residuals: how big it is from its lowest to its highest point, and how sure."""

    swing_db: float
    p_value: float
    """Of no such pattern, clustered by place."""


def span_decades(result: FitResult) -> float:
    """log10 of farthest over nearest distance at which something was heard."""
    heard = result.readings.distance_m[~result.readings.missed]
    return float(np.log10(heard.max() / heard.min()))


def against_distance(result: FitResult) -> Structure | None:
    """A bend: level against log distance is no straight line. None with fewer than 5 distances."""
    x = np.log10(result.readings.distance_m)
    if len(np.unique(x)) < 5:
        return None
    bend = (x - x.mean()) ** 2
    extra = _with_columns(result, bend[:, None])
    if extra is None:
        return None
    theta, covariance = extra
    swing = abs(theta[-2]) * (np.ptp(x) / 2.0) ** 2
    return Structure(float(swing), _p_value(theta[-2:-1], covariance[-2:-1, -2:-1]))


def against_heading(result: FitResult) -> Structure | None:
    """An antenna pattern that the model does not have. None where headings are not known or do not vary."""
    heading = result.readings.heading_deg
    if heading is None or len(np.unique(np.round(heading / 15.0))) < 6:
        return None
    angle = np.radians(heading)
    columns = np.column_stack([f(k * angle) for k in (1, 2) for f in (np.cos, np.sin)])
    extra = _with_columns(result, columns)
    if extra is None:
        return None
    theta, covariance = extra
    coefficients = theta[-5:-1]
    swing = np.ptp(columns @ coefficients)
    return Structure(float(swing), _p_value(coefficients, covariance[-5:-1, -5:-1]))


def truncation(result: FitResult) -> float:
    """How much better the readings fit if weak ones were left out of the file, as a log-likelihood ratio.

    Only meaningful where no missed packet is in the file; divided by the clustering's inflation of variance.
    """
    if result.missed != "none":
        return 0.0
    weakest = float(np.nanmin(result.readings.rss_dbm))
    rows = make_rows(result.readings, "uncounted", weakest - 1.0, result.antenna.saturation_dbm)
    theta, converged = likelihood.maximise(rows, np.append(result.theta[:2], result.theta[-1]))
    if not converged:
        return 0.0
    inflation = float(np.median(np.diag(result.covariance) / np.diag(result.naive_covariance)))
    return (result.nll - likelihood.nll(theta, rows)) / max(1.0, inflation)


def cut_short(result: FitResult) -> float:
    """Share of the farther places whose weakest reading stands within 1 dB of the weakest of all."""
    r = result.readings
    heard = ~r.missed
    weakest = r.rss_dbm[heard].min()
    far = heard & (r.distance_m >= np.median(r.distance_m[heard]))
    lows = [r.rss_dbm[far & (r.place == place)].min() for place in np.unique(r.place[far])]
    return float(np.mean(np.array(lows) <= weakest + 1.0))


def thinned(result: FitResult) -> float:
    """Share of readings absent at places that reach the weakest level, if all others have equally many.

    Weak readings dropped from a file leave such holes: 50 readings everywhere, but 4 at the weakest place.
    """
    r = result.readings
    if result.missed != "none":
        return 0.0
    places, index, counts = np.unique(r.place, return_inverse=True, return_counts=True)
    lows = np.full(len(places), np.inf)
    np.minimum.at(lows, index.reshape(-1), r.rss_dbm)
    touching = lows <= r.rss_dbm.min() + 1.0
    if touching.all() or not touching.any():
        return 0.0
    usual = float(np.median(counts[~touching]))
    regular = np.abs(counts[~touching] - usual) <= 0.2 * usual
    if usual < 5.0 or regular.mean() < 0.8:
        return 0.0
    absent = float(1.0 - np.minimum(counts[touching], usual).mean() / usual)
    return absent - float(1.0 - np.minimum(counts[~touching], usual).mean() / usual)


def swapped(result: FitResult) -> tuple[str, bool]:
    """Which coordinates, if exchanged, make the readings fit better, and whether there is no doubt.

    Evidence is log-likelihood, one observation for each place: by chance it passes x once in exp(x)
    files. Empty where nothing speaks for an exchange.
    """
    r = result.readings
    heard = ~r.missed
    _, sigma = _quick(r.distance_m[heard], r.rss_dbm[heard])
    name, most, sure = "", SUSPECT_NATS, False
    for what, distance in r.alternatives.items():
        if np.median(r.distance_m) > OUT_OF_REACH_M > np.median(distance):
            return what, True
        exponent, alternative = _quick(distance[heard], r.rss_dbm[heard])
        evidence = result.n_places * float(np.log(sigma / max(alternative, 1e-6)))
        if exponent > 0.5 and evidence > most:
            name, most, sure = what, evidence, evidence > SURE_NATS and alternative < 0.95 * sigma
    return name, sure


def mixed_units(result: FitResult) -> str:
    """Which distances look as if they were given in another unit than the rest, in words; empty where none.

    A group of places at one end, beyond the widest gaps, is tried 100 and 1000 times nearer or farther. As for
    `swapped`, evidence counts places; it must be beyond doubt, and the spread must fall by a third.
    """
    r = result.readings
    heard = ~r.missed
    distance, level = r.distance_m[heard], r.rss_dbm[heard]
    _, sigma = _quick(distance, level)
    distinct = np.unique(distance)
    gaps = np.argsort(np.diff(np.log(distinct)))[::-1][:3]
    said, best = "", sigma * LARGEST_SPREAD_LEFT
    for edge in np.sqrt(distinct[gaps] * distinct[gaps + 1]):
        for unit, factor, far in ((*UNITS[0], True), (*UNITS[1], True), ("", 1000.0, False)):
            odd = distance > edge if far else distance < edge
            moved = np.where(odd, distance * (1.0 / factor if far else factor), distance)
            exponent, left = _quick(moved, level)
            evidence = result.n_places * float(np.log(sigma / max(left, 1e-6)))
            if exponent > 0.5 and left < best and evidence > SURE_NATS:
                which, other = ("above", unit) if far else ("below", "kilometres")
                said, best = f"distances {which} {edge:.3g} m are in {other}", left
    return said


def between_receivers(result: FitResult) -> Structure | None:
    """Levels differ from receiver to receiver. None with one receiver, or where their offsets are in the fit."""
    r = result.readings
    if r.receiver is None or len(r.receivers) < 2 or result.receiver_offsets_db:
        return None
    columns = np.column_stack([(r.receiver == k).astype(float) for k in range(1, len(r.receivers))])
    fitted = _with_columns(result, columns)
    if fitted is None:
        return None
    theta, covariance = fitted
    own = slice(-1 - columns.shape[1], -1)
    offsets = np.concatenate([[0.0], theta[own]])
    return Structure(float(np.ptp(offsets)), _p_value(theta[own], covariance[own, own]))


def near_field(result: FitResult) -> tuple[float, float] | None:
    """The exponent without places under 0.5 m, and its clustered error; None where too little is left."""
    from calibration.fit import Options, fit

    r = result.readings
    far = r.distance_m >= 0.5
    if far.all() or len(np.unique(r.place[far & ~r.missed])) < 5:
        return None
    try:
        again = fit(r.keep(far), Options(missed=result.missed, saturation_dbm=result.antenna.saturation_dbm))
    except ValueError:
        return None
    return again.antenna.path_loss_exponent, again.errors()["path_loss_exponent"]


def residuals_db(result: FitResult) -> FloatArray:
    """(n,) reading minus fitted level; nan for missed packets."""
    r = result.readings
    return r.rss_dbm - fitted_mean(result.theta, r, bool(result.receiver_offsets_db))


def _quick(distance_m: FloatArray, rss_dbm: FloatArray) -> tuple[float, float]:
    """Exponent and spread by least squares."""
    x = -10.0 * np.log10(np.maximum(distance_m, 1e-3))
    slope, level = np.polyfit(x, rss_dbm, 1) if np.ptp(x) > 0 else (0.0, rss_dbm.mean())
    return float(slope), float(np.std(rss_dbm - level - slope * x))


def _with_columns(result: FitResult, columns: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Parameters and clustered covariance with more columns (n, k), placed before ln sigma."""
    rows = _rows_with(result, columns)
    theta, converged = likelihood.maximise(
        rows, np.concatenate([result.theta[:-1], np.zeros(columns.shape[1]), result.theta[-1:]])
    )
    return (theta, clustered(theta, rows)[0]) if converged else None


def _rows_with(result: FitResult, columns: FloatArray) -> Rows:
    """The fit's rows with more columns; readings at one place and one value of the columns stay together."""
    return make_rows(
        result.readings,
        result.missed,
        result.censor_dbm,
        result.antenna.saturation_dbm,
        bool(result.receiver_offsets_db),
        columns,
    )


def _p_value(coefficients: FloatArray, covariance: FloatArray) -> float:
    """Wald's test that all coefficients are zero."""
    wald = float(coefficients @ np.linalg.pinv(covariance) @ coefficients)
    return float(chdtrc(len(coefficients), max(0.0, wald)))
