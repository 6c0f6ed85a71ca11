"""Does a calibration still hold? New readings against what an antenna file predicts."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calibration import likelihood
from calibration.dataset import Readings
from calibration.observations import Missed, make_rows
from calibration.spread import clustered, standard_errors
from fieldkit.channel.antenna_file import AntennaFile, gain_db
from fieldkit.errors import DataError

DRIFT_DB = 1.5
"""An offset below this is less than what another battery or another body height does."""
SPREAD_RATIO = 1.3


@dataclass(frozen=True, slots=True)
class Check:
    """New readings against a calibration: how much stronger they are, and how much wider they spread."""

    offset_db: float
    offset_95: tuple[float, float]
    sigma_db: float
    sigma_95: tuple[float, float]
    calibrated_sigma_db: float
    n_readings: int
    n_missed: int
    n_places: int
    state: Literal["holds", "drifted", "too few readings"]
    reasons: tuple[str, ...]


def check(antenna_file: AntennaFile, readings: Readings) -> Check:
    """Fit an offset and a spread to new readings, with the exponent and the ends as calibrated."""
    antenna = antenna_file.antenna
    heard = ~readings.missed
    if heard.sum() < 10:
        raise DataError(
            f"{readings.name}: {heard.sum()} readings are too few to check a calibration; collect 100"
        )
    missed: Missed = "counted" if readings.missed.any() else "none"
    censor = float(np.floor(antenna.threshold_dbm)) if missed == "counted" else None
    if antenna_file.pattern:
        if readings.heading_deg is None:
            raise DataError(
                f"{readings.name}: this antenna's gain depends on heading, and there is no column heading_deg"
            )
        readings = replace(readings, gain_db=gain_db(antenna_file, readings.heading_deg))
    rows = make_rows(readings, missed, censor, antenna.saturation_dbm)
    predicted = rows.design[:, 1] * antenna.path_loss_exponent + antenna.power_at_1m_dbm + rows.offset_dbm
    rows = likelihood.Rows(rows.design[:, :1], rows.low_dbm, rows.high_dbm, rows.count, rows.place, predicted)
    theta, converged = likelihood.maximise(rows, np.array([0.0, np.log(antenna.sigma_db)]))
    covariance, _, quantile = clustered(theta, rows)
    half = quantile * standard_errors(covariance)
    offset, sigma = float(theta[0]), float(np.exp(theta[1]))
    offset_95 = (offset - float(half[0]), offset + float(half[0]))
    sigma_95 = (float(np.exp(theta[1] - half[1])), float(np.exp(theta[1] + half[1])))
    reasons = []
    if readings.n_places < 3 or not converged:
        state: Literal["holds", "drifted", "too few readings"] = "too few readings"
        reasons.append(f"{readings.n_places} places: shadowing and drift cannot be separated; take 5 or more")
    else:
        reasons = _drifts(offset, offset_95, sigma, sigma_95, antenna.sigma_db)
        state = "drifted" if reasons else "holds"
    return Check(
        offset_db=offset,
        offset_95=offset_95,
        sigma_db=sigma,
        sigma_95=sigma_95,
        calibrated_sigma_db=antenna.sigma_db,
        n_readings=int(heard.sum()),
        n_missed=int(readings.missed.sum()),
        n_places=readings.n_places,
        state=state,
        reasons=tuple(reasons),
    )


def words(said: Check) -> list[str]:
    """For people, a line each."""
    low, high = said.offset_95
    return [
        f"offset {said.offset_db:+.1f} dB ({low:+.1f} to {high:+.1f}) against the calibration",
        f"spread {said.sigma_db:.1f} dB ({said.sigma_95[0]:.1f} to {said.sigma_95[1]:.1f}), "
        f"calibrated {said.calibrated_sigma_db:.1f} dB",
        f"from {said.n_readings} readings and {said.n_missed} missed packets at {said.n_places} places",
        f"verdict: {said.state}",
        *(f"  {reason}" for reason in said.reasons),
    ]


def _drifts(
    offset: float,
    offset_95: tuple[float, float],
    sigma: float,
    sigma_95: tuple[float, float],
    calibrated_sigma: float,
) -> list[str]:
    reasons = []
    if abs(offset) > DRIFT_DB and offset_95[0] * offset_95[1] > 0.0:
        way = "stronger" if offset > 0 else "weaker"
        reasons.append(
            f"readings are {abs(offset):.1f} dB {way} than calibrated ({offset_95[0]:+.1f} to "
            f"{offset_95[1]:+.1f}): "
            "check battery, antenna and power setting, or calibrate again"
        )
    if sigma_95[0] > SPREAD_RATIO * calibrated_sigma:
        reasons.append(
            f"readings spread by {sigma:.1f} dB, not {calibrated_sigma:.1f}: another place, "
            "obstacles or headings; "
            "calibrate where the mission will be"
        )
    return reasons
