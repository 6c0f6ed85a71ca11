"""An antenna file improved by later readings of one source, or the word that they contradict it.

Both are estimates of the same law with their covariances, so that what follows from both is their precision-weighted
mean (inverse-variance weighting of independent estimates; Cochran, Biometrics 10, 1954). Of a normal law the scatter is
estimated independently of the mean. A source whose level nobody knows says nothing about the calibrated transmitter's
power: its own power is a free parameter of its fit.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from calibration import channel
from calibration.dataset import Readings
from calibration.fit import PARAMETERS, FitResult, Options, fit
from calibration.verdict import judge
from fieldkit.channel.antenna_file import AntennaFile
from fieldkit.channel.reml import MOST_PLACES, ROUNDING_VAR, by_place, design, min_range_m, typical_cell_m
from fieldkit.channel.spread import ChannelSpread
from fieldkit.errors import CalibrationRefused
from fieldkit.messages import FloatArray

SURE = 0.001
"""A difference that chance makes less often than this contradicts."""
UNSTATED = (2.0, 0.2, 0.2)
"""Standard errors of a file that states none: dB, of the exponent, and sigma's as a share of it."""
TWO_SIDED_95 = 1.96
NOISE = ("sigma_time_db", "sigma_place_db", "correlation_m")


@dataclass(frozen=True, slots=True)
class Update:
    """What came of it. `file` is the new antenna file, None where there is none."""

    state: Literal["updated", "contradicts", "says too little"]
    reasons: tuple[str, ...]
    file: AntennaFile | None
    lines: tuple[str, ...]
    """The parameters before, by the readings alone, and after, for people."""
    p_chance: float
    """How often chance makes a difference as large, were both of the same law."""


def update(file: AntennaFile, readings: Readings, *, level_db: float | None, old_sha256: str) -> Update:
    """`level_db`: how much stronger the source sends than the calibrated transmitter; None where nobody knows."""
    try:
        result = fit(readings, Options("counted" if readings.missed.any() else "none"))
    except CalibrationRefused as refused:
        return Update("says too little", (str(refused),), None, (), float("nan"))
    verdict = judge(result)
    if verdict.refusals or not np.isfinite(result.covariance).all():
        why = verdict.refusals or ("the fit did not converge",)
        return Update("says too little", why, None, (), float("nan"))
    old, old_cov = _stated(file)
    new, new_cov = _estimated(result, level_db, file)
    used = np.array([level_db is not None, True, True])
    p_chance = _p_chance(old[used] - new[used], (old_cov + new_cov)[np.ix_(used, used)])
    information = np.zeros((3, 3))
    information[np.ix_(used, used)] = np.linalg.inv(new_cov[np.ix_(used, used)])
    prior = np.linalg.inv(old_cov)
    after_cov = np.asarray(np.linalg.inv(prior + information), dtype=float)
    after = after_cov @ (prior @ old + information @ np.where(used, new, 0.0))
    lines = _lines(old, old_cov, new, new_cov, after, after_cov, used)
    if p_chance < SURE:
        reasons = (
            f"the readings contradict the antenna file: chance makes such a difference once in {1.0 / p_chance:.0f} "
            "times; calibrate anew where the mission is, or see that the source is where it is said to be",
        )
        return Update("contradicts", reasons, None, lines, p_chance)
    return Update(
        "updated", (), _written(file, result, after, after_cov, level_db, old_sha256), lines, p_chance
    )


def _stated(file: AntennaFile) -> tuple[FloatArray, FloatArray]:
    """Power, exponent and ln sigma of the file, and their covariance."""
    antenna = file.antenna
    values = np.array([antenna.power_at_1m_dbm, antenna.path_loss_exponent, np.log(antenna.sigma_db)])
    names = list(file.covariance.get("names", ()))
    if not set(PARAMETERS) <= set(names):
        return values, np.diag(np.square(UNSTATED))
    pick = [names.index(name) for name in PARAMETERS]
    by = np.array([1.0, 1.0, 1.0 / antenna.sigma_db])
    matrix = np.asarray(file.covariance["matrix"], dtype=float)[np.ix_(pick, pick)] * np.outer(by, by)
    return values, _apart(matrix)


def _estimated(result: FitResult, level_db: float | None, file: AntennaFile) -> tuple[FloatArray, FloatArray]:
    """The same by the readings alone, with their shadowing: a walk past few walls is few witnesses, however many
    packets it heard. Another transmitter's exponent is its own, by as much as they differ."""
    measured, _, _ = channel.measured(result)
    known = measured if file.spread is None or file.spread.assumed else file.spread
    mean, matrix = _generalised(result.readings, known)
    if result.n_missed + result.n_saturated > channel.CENSORED_SHARE * result.n_readings:
        mean = result.theta[:2]
    time_db, place_db = measured.sigma_time_db, measured.sigma_place_db
    sigma_db = float(np.hypot(time_db, place_db))
    slope = np.square([time_db, place_db]) / sigma_db**2
    log_var = float(slope @ np.asarray(measured.log_covariance)[:2, :2] @ slope)
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[2, 2] = matrix, log_var
    if level_db is None and file.spread is not None and file.spread.transmitters > 1:
        whole[1, 1] += file.spread.transmitter_exponent**2
    return np.array([mean[0] - (level_db or 0.0), mean[1], np.log(sigma_db)]), _apart(whole)


def _generalised(readings: Readings, spread: ChannelSpread) -> tuple[FloatArray, FloatArray]:
    """Power and exponent by generalised least squares, and their covariance: readings share the shadowing of their
    places (`fieldkit.channel.spread`), and the transmitter's lobe."""
    heard = ~readings.missed
    assert readings.tx_m is not None and readings.rx_m is not None
    up_m = np.zeros(heard.size) if readings.climb_m is None else readings.climb_m
    level_db = readings.rss_dbm - (0.0 if readings.gain_db is None else readings.gain_db)
    away_m = readings.distance_m[heard]
    place_m = np.column_stack([readings.rx_m, up_m])[heard]
    places = by_place(place_m, level_db[heard], typical_cell_m(away_m), MOST_PLACES)
    columns = design(places.place_m, np.append(readings.tx_m[0], 0.0), min_range_m(away_m))
    apart_m = np.sqrt(((places.place_m[:, None] - places.place_m[None]) ** 2).sum(axis=-1))
    noise = spread.sigma_place_db**2 * np.exp(-apart_m / max(spread.correlation_m, 1e-3))
    noise += spread.lobe_db**2 * columns[:, 2:4] @ columns[:, 2:4].T
    noise[np.diag_indices_from(noise)] += (spread.sigma_time_db**2 + ROUNDING_VAR) / places.count
    weighted = np.linalg.solve(noise, columns[:, :2])
    matrix = np.asarray(np.linalg.inv(columns[:, :2].T @ weighted), dtype=float)
    return matrix @ weighted.T @ places.level_db, matrix


def _apart(matrix: FloatArray) -> FloatArray:
    """(3, 3) without the covariance of scatter and mean."""
    apart = matrix + 1e-9 * np.eye(3)
    apart[:2, 2] = apart[2, :2] = 0.0
    return apart


def _p_chance(difference: FloatArray, matrix: FloatArray) -> float:
    from scipy.special import chdtrc

    distance2 = float(difference @ np.linalg.solve(matrix, difference))
    return float(chdtrc(difference.size, distance2))


def _written(
    file: AntennaFile,
    result: FitResult,
    after: FloatArray,
    after_cov: FloatArray,
    level_db: float | None,
    old_sha256: str,
) -> AntennaFile:
    sigma_db = float(np.exp(after[2]))
    by = np.array([1.0, 1.0, sigma_db])
    half = TWO_SIDED_95 * np.sqrt(np.diag(after_cov))
    low, high = after - half, after + half
    heard = result.readings.distance_m[~result.readings.missed]
    step: dict[str, Any] = {
        "antenna_sha256": old_sha256,
        "file": result.readings.name,
        "sha256": result.readings.sha256,
        "n_readings": result.n_readings,
        "n_missed": result.n_missed,
        "n_places": result.n_places,
        **({} if level_db is None else {"level_db": level_db}),
    }
    data = {
        **file.data,
        "n_readings": int(file.data.get("n_readings", 0)) + result.n_readings,
        "n_missed": int(file.data.get("n_missed", 0)) + result.n_missed,
        "n_places": int(file.data.get("n_places", 0)) + result.n_places,
        "min_range_m": min(float(file.data.get("min_range_m", np.inf)), float(heard.min())),
        "max_range_m": max(float(file.data.get("max_range_m", 0.0)), float(heard.max())),
        "updates": [*file.data.get("updates", ()), step],
    }
    return replace(
        file,
        antenna=replace(
            file.antenna,
            power_at_1m_dbm=float(after[0]),
            path_loss_exponent=float(after[1]),
            sigma_db=sigma_db,
        ),
        intervals_95={
            **file.intervals_95,
            PARAMETERS[0]: (float(low[0]), float(high[0])),
            PARAMETERS[1]: (float(low[1]), float(high[1])),
            PARAMETERS[2]: (float(np.exp(low[2])), float(np.exp(high[2]))),
        },
        covariance={"names": list(PARAMETERS), "matrix": (after_cov * np.outer(by, by)).tolist()},
        data=data,
        spread=_spread(file, result, after),
    )


def _spread(file: AntennaFile, result: FitResult, after: FloatArray) -> ChannelSpread | None:
    """Noise in time and place, weighted by how well each is known; as it was where nothing was measured."""
    found, measured, _ = channel.measured(result)
    if measured is None:
        return file.spread
    old = file.spread
    if old is None or old.assumed:
        kept = (
            found
            if old is None
            else replace(old, **{name: getattr(found, name) for name in NOISE}, assumed="")
        )
        return replace(kept, power_at_1m_dbm=None, path_loss_exponent=None)
    before, since = (np.diag(np.asarray(each.log_covariance))[: len(NOISE)] for each in (old, found))
    weight = before / (before + since)
    values: dict[str, Any] = {
        name: float(getattr(old, name) ** (1.0 - w) * getattr(found, name) ** w)
        for name, w in zip(NOISE, weight, strict=True)
    }
    logs = np.array(old.log_covariance)
    for k, w in enumerate(weight):
        logs[k, :] *= np.sqrt(1.0 - w)
        logs[:, k] *= np.sqrt(1.0 - w)
    return replace(
        old,
        **values,
        log_covariance=tuple(map(tuple, logs.tolist())),
        path_loss_exponent=None if old.path_loss_exponent is None else float(after[1]),
        power_at_1m_dbm=None if old.power_at_1m_dbm is None else float(after[0]),
    )


def _lines(
    old: FloatArray,
    old_cov: FloatArray,
    new: FloatArray,
    new_cov: FloatArray,
    after: FloatArray,
    after_cov: FloatArray,
    used: "np.ndarray[Any, Any]",
) -> tuple[str, ...]:
    rows = []
    for k, name in enumerate(PARAMETERS):
        cells = []
        for values, matrix, has in ((old, old_cov, True), (new, new_cov, used[k]), (after, after_cov, True)):
            value, error = float(values[k]), float(np.sqrt(matrix[k, k]))
            if k == 2:
                value, error = float(np.exp(value)), float(np.exp(value)) * error
            cells.append(f"{value:8.2f} +-{TWO_SIDED_95 * error:5.2f}" if has else f"{'not given':>16}")
        rows.append(f"{name:20}{''.join(f'{cell:>18}' for cell in cells)}")
    return (f"{'':20}{'before':>18}{'by these alone':>18}{'after':>18}", *rows)
