"""Interval-censored likelihood of readings: what was reported, what the receiver's ends hid, what was missed.

A reading z says that the true level lay in (z - 1/2, z + 1/2); at saturation that it lay above z - 1/2; a
missed packet that it lay below the level up to which packets can get lost. Levels are normal around a mean
that is linear in the parameters, with deviation sigma. Rows that say the same are counted once.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from fieldkit.messages import FloatArray

_LOG_SQRT_2PI = 0.5 * np.log(2.0 * np.pi)
_LARGEST_EXPONENT = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """n distinct observations. Mean level = `design` @ coefficients + `offset_dbm`."""

    design: FloatArray
    """(n, p)."""
    low_dbm: FloatArray
    """(n,) the level lay above this; -inf for a missed packet."""
    high_dbm: FloatArray
    """(n,) and below this; inf for a saturated reading."""
    count: FloatArray
    """(n,) how many readings said so."""
    place: np.ndarray
    """(n,) which place they come from."""
    offset_dbm: FloatArray | float = 0.0
    seen_above_dbm: float | None = None
    """Truncated data: only packets above this level are in the file at all; None where all are."""


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """Log-probability of each row and its derivatives by the mean and by ln sigma. All (n,)."""

    value: FloatArray
    by_mean: FloatArray
    by_log_sigma: FloatArray
    mean_mean: FloatArray
    mean_sigma: FloatArray
    sigma_sigma: FloatArray


def interval_terms(mean: FloatArray, sigma: float, low: FloatArray, high: FloatArray) -> Terms:
    """log P(low < N(mean, sigma) < high) with first and second derivatives; ends may be infinite.

    Exact far out in the tails: the difference of two nearly equal probabilities is never formed.
    """
    a, b = (low - mean) / sigma, (high - mean) / sigma
    # Seen from the left tail both ends are small numbers with a well-behaved logarithm.
    turn = a + b > 0.0
    near, far = np.where(turn, -a, b), np.where(turn, -b, a)
    log_near, log_far = log_ndtr(near), log_ndtr(far)
    value = log_near + np.log(-np.expm1(np.minimum(log_far - log_near, -1e-300)))
    # Where sigma is absurdly small the difference is rounding noise; it must only stay finite.
    pa = np.exp(np.minimum(-0.5 * a * a - _LOG_SQRT_2PI - value, _LARGEST_EXPONENT))
    pb = np.exp(np.minimum(-0.5 * b * b - _LOG_SQRT_2PI - value, _LARGEST_EXPONENT))
    # At an infinite end the density is zero, and so is every product with it.
    a, b = np.where(np.isinf(a), 0.0, a), np.where(np.isinf(b), 0.0, b)
    pull, spread = pa - pb, a * pa - b * pb
    return Terms(
        value=value,
        by_mean=pull / sigma,
        by_log_sigma=spread,
        mean_mean=(spread - pull**2) / sigma**2,
        mean_sigma=(a * a * pa - b * b * pb - pull - pull * spread) / sigma,
        sigma_sigma=a * pa * (a * a - 1.0) - b * pb * (b * b - 1.0) - spread**2,
    )


def row_terms(theta: FloatArray, rows: Rows) -> Terms:
    """The terms of each row at `theta` = (coefficients..., ln sigma)."""
    mean, sigma = rows.design @ theta[:-1] + rows.offset_dbm, float(np.exp(theta[-1]))
    terms = interval_terms(mean, sigma, rows.low_dbm, rows.high_dbm)
    if rows.seen_above_dbm is None:
        return terms
    floor = np.full_like(mean, rows.seen_above_dbm)
    seen = interval_terms(mean, sigma, floor, np.full_like(mean, np.inf))
    return Terms(*(getattr(terms, name) - getattr(seen, name) for name in Terms.__dataclass_fields__))


def nll(theta: FloatArray, rows: Rows, terms: Terms | None = None) -> float:
    """Negative log-likelihood, natural logarithm. `terms` where those at `theta` are known, here and below."""
    terms = terms or row_terms(theta, rows)
    return -float(rows.count @ terms.value)


def gradient(theta: FloatArray, rows: Rows, terms: Terms | None = None) -> FloatArray:
    """(p + 1,) derivative of `nll`."""
    terms = terms or row_terms(theta, rows)
    return -np.append(rows.design.T @ (rows.count * terms.by_mean), rows.count @ terms.by_log_sigma)


def hessian(theta: FloatArray, rows: Rows, terms: Terms | None = None) -> FloatArray:
    """(p + 1, p + 1) second derivative of `nll`."""
    terms = terms or row_terms(theta, rows)
    mixed = rows.design.T @ (rows.count * terms.mean_sigma)
    block = rows.design.T @ (rows.design * (rows.count * terms.mean_mean)[:, None])
    return -np.block([[block, mixed[:, None]], [mixed[None, :], rows.count @ terms.sigma_sigma]])


def place_scores(theta: FloatArray, rows: Rows) -> FloatArray:
    """(places, p + 1) gradient of the log-likelihood summed within each place: what clustering needs."""
    terms = row_terms(theta, rows)
    each = np.column_stack([rows.design * terms.by_mean[:, None], terms.by_log_sigma]) * rows.count[:, None]
    _, index = np.unique(rows.place, return_inverse=True)
    scores = np.zeros((int(index.max()) + 1, each.shape[1]))
    np.add.at(scores, index.reshape(-1), each)
    return scores


def maximise(rows: Rows, start: FloatArray, penalty: FloatArray | None = None) -> tuple[FloatArray, bool]:
    """Parameters of least `nll`, and whether the search converged.

    `penalty` (p + 1, p + 1): half of theta' penalty theta is added, to keep what is smooth smooth.
    """
    from scipy.optimize import minimize

    total = float(rows.count.sum())
    ridge = np.zeros((len(start), len(start))) if penalty is None else penalty
    known: dict[bytes, Terms] = {}

    def terms(theta: FloatArray) -> Terms:
        """Those of the point asked for last are kept: value, slope and bend are asked for one after another."""
        point = theta.tobytes()
        if point not in known:
            known.clear()
            known[point] = row_terms(theta, rows)
        return known[point]

    # Per reading, so that the tolerance means the same for a hundred readings and for a million.
    found = minimize(
        lambda t: (nll(t, rows, terms(t)) + 0.5 * t @ ridge @ t) / total,
        start,
        jac=lambda t: (gradient(t, rows, terms(t)) + ridge @ t) / total,
        hess=lambda t: (hessian(t, rows, terms(t)) + ridge) / total,
        method="trust-exact",
        options={"gtol": 1e-8, "maxiter": 200, "initial_trust_radius": 2.0},
    )
    steep = float(np.abs(gradient(found.x, rows) + ridge @ found.x).max()) / total
    sane = bool(np.all(np.isfinite(found.x))) and float(np.exp(found.x[-1])) < 100.0
    return found.x, sane and steep < 1e-5
