"""Profile likelihoods: intervals that need not be symmetric, for fits where little is known.

The curve of the likelihood is scaled so that at its bottom it is as flat as the clustered covariance says;
far from the bottom it keeps the shape the readings give it. With many places both agree; with few, or many
censored readings, the profile is the honest one.
"""

from dataclasses import dataclass

import numpy as np

from calibration import likelihood
from calibration.fit import PARAMETERS, FitResult
from fieldkit.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """One parameter's curve. `drop` is 0 at the fit and 1 at the ends of the 95 % interval."""

    name: str
    value: FloatArray
    drop: FloatArray
    interval_95: tuple[float, float]


def profile(result: FitResult, name: str, points: int = 21) -> Profile:
    """The profile of "power_at_1m_dbm", "path_loss_exponent" or "sigma_db". Ends not found are infinite."""
    from iminuit import Minuit

    index = -1 if name == "sigma_db" else PARAMETERS.index(name)
    index %= len(result.theta)
    inflation = float(result.covariance[index, index] / result.naive_covariance[index, index])
    labels = [f"x{i}" for i in range(len(result.theta))]
    minuit = Minuit(
        lambda t: likelihood.nll(np.asarray(t), result.rows),
        result.theta,
        grad=lambda t: likelihood.gradient(np.asarray(t), result.rows),
        name=labels,
    )
    minuit.errordef = minuit.LIKELIHOOD * max(1e-9, inflation) * result.quantile**2
    minuit.strategy = 0
    minuit.migrad()
    low, high = _ends(minuit, labels[index], result, index)
    error = float(np.sqrt(result.covariance[index, index])) * result.quantile
    near, far = (max(low, result.theta[index] - 2.0 * error), min(high, result.theta[index] + 2.0 * error))
    value, cost, _ = minuit.mnprofile(labels[index], size=points, bound=(near, far), subtract_min=True)
    drop = np.asarray(cost) / minuit.errordef
    if name == "sigma_db":
        return Profile(name, np.exp(value), drop, (float(np.exp(low)), float(np.exp(high))))
    return Profile(name, np.asarray(value), drop, (low, high))


def _ends(minuit: object, label: str, result: FitResult, index: int) -> tuple[float, float]:
    """Both ends of the interval by MINOS; infinite where the curve never rises enough."""
    try:
        minuit.minos(label)  # type: ignore[attr-defined]
        merror = minuit.merrors[label]  # type: ignore[attr-defined]
    except RuntimeError:
        return -np.inf, np.inf
    centre = float(result.theta[index])
    low = centre + merror.lower if merror.lower_valid else -np.inf
    high = centre + merror.upper if merror.upper_valid else np.inf
    return float(low), float(high)
