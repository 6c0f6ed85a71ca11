"""How sure: covariance clustered by place, and what of sigma is time and what is place."""

import numpy as np

from calibration import likelihood
from calibration.dataset import Readings
from calibration.likelihood import Rows
from fieldkit.messages import FloatArray


def clustered(
    theta: FloatArray, rows: Rows, penalty: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, float]:
    """Sandwich covariance by place, the naive one, and Student's t for 95 %. `penalty` as in `maximise`.

    Small-sample factor G/(G - p) and G - p degrees of freedom: with few places the plain sandwich is too sure
    (Cameron and Miller, A practitioner's guide to cluster-robust inference, J. Human Resources 50, 2015).
    """
    from scipy.special import stdtrit

    curve = likelihood.hessian(theta, rows) + (0.0 if penalty is None else penalty)
    bread = np.asarray(np.linalg.pinv(curve), dtype=float)
    scores = likelihood.place_scores(theta, rows)
    groups, p = scores.shape
    spare = max(1, groups - p)
    covariance: FloatArray = bread @ (scores.T @ scores) @ bread * groups / spare
    return covariance, bread, float(stdtrit(spare, 0.975))


def split_sigma(
    readings: Readings, sigma_db: float, saturation_dbm: float | None
) -> tuple[float | None, float | None]:
    """Deviation within places and between them, from places where nothing was censored."""
    within, freedom, places = 0.0, 0, 0
    order = np.argsort(readings.place, kind="stable")
    bounds = np.flatnonzero(np.diff(readings.place[order])) + 1
    for rows in np.split(order, bounds):
        z = readings.rss_dbm[rows]
        hidden = np.isnan(z) | (False if saturation_dbm is None else z >= saturation_dbm)
        same_distance = np.ptp(readings.distance_m[rows]) < 1e-9
        if len(z) < 3 or hidden.any() or not same_distance:
            continue
        within, freedom, places = (
            within + float(((z - z.mean()) ** 2).sum()),
            freedom + len(z) - 1,
            places + 1,
        )
    if places < 3:
        return None, None
    # Rounding to integers adds a variance of 1/12.
    time2 = max(0.0, within / freedom - 1.0 / 12.0)
    return float(np.sqrt(time2)), float(np.sqrt(max(0.0, sigma_db**2 - time2)))


def standard_errors(covariance: FloatArray) -> FloatArray:
    """Roots of the diagonal; rounding may have left a variance of zero just below it."""
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))
