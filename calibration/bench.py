"""`fieldkit bench calibration`: how long a fit takes, against plain least squares in the same run."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from calibration import study
from calibration.dataset import Readings
from calibration.fit import fit
from calibration.verdict import judge
from fieldkit.clock import wall_s
from fieldkit.messages import FloatArray

SIZES = {
    "6560": (study.CONFIGURATIONS, study.PACKETS, 0.0, 7),
    "1000000": (2500, 400, 0.0, 3),
    "1000000 on the move": (2500, 400, 0.05, 1),
}
"""Name to (places, packets at each, how much the distance varies at one place in ln, times measured).

On the move no two readings have the same distance, so that none can be counted together.
"""


def run() -> dict[str, Any]:
    """Median times of the fit, of the fit with its verdict, and of least squares, with the error of each."""
    return {name: _measure(*size) for name, size in SIZES.items()}


def least_squares(distance_m: FloatArray, rss_dbm: FloatArray) -> tuple[float, float]:
    """Power at 1 m and exponent by `scipy.optimize.least_squares` on what was received: the plain way.

    Missed packets are absent and saturated readings taken as they are, which is what makes it wrong.
    """
    from scipy.optimize import least_squares as solve

    heard = ~np.isnan(rss_dbm)
    x, z = -10.0 * np.log10(distance_m[heard]), rss_dbm[heard]
    design = np.column_stack([np.ones_like(x), x])
    found = solve(lambda p: design @ p - z, np.array([-50.0, 2.0]), jac=lambda p: design)
    return float(found.x[0]), float(found.x[1])


def _measure(places: int, packets: int, wander: float, times: int) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    nearest, farthest = study.RANGE_M
    distance = np.exp(rng.uniform(np.log(nearest), np.log(farthest), places))
    if wander:
        distance = np.repeat(distance, packets) * np.exp(rng.uniform(-wander, wander, places * packets))
        readings = study.simulate(study.TRUTH, distance, 1, rng)
        readings = replace(readings, place=readings.place // packets)
    else:
        readings = study.simulate(study.TRUTH, distance, packets, rng)
    result, ours_s = _median(lambda: fit(readings), times)
    _, judged_s = _median(lambda: judge(fit(readings)), times)
    plain, plain_s = _median(lambda: _plain(readings), times)
    truth = study.TRUTH
    return {
        "readings": len(readings.rss_dbm),
        "missed": int(readings.missed.sum()),
        "places": places,
        "distinct_rows": len(result.rows.count),
        "fit_s": ours_s,
        "fit_and_verdict_s": judged_s,
        "least_squares_s": plain_s,
        "times_slower_than_least_squares": ours_s / plain_s,
        "exponent_error": result.antenna.path_loss_exponent - truth.path_loss_exponent,
        "power_error_db": result.antenna.power_at_1m_dbm - truth.power_at_1m_dbm,
        "least_squares_exponent_error": plain[1] - truth.path_loss_exponent,
        "least_squares_power_error_db": plain[0] - truth.power_at_1m_dbm,
    }


def _plain(readings: Readings) -> tuple[float, float]:
    return least_squares(readings.distance_m, readings.rss_dbm)


def _median(action: Callable[[], Any], times: int) -> tuple[Any, float]:
    """What a call gives, and the median wall time of several after one that is not counted."""
    value = action()
    spent = []
    for _ in range(times):
        began = wall_s()
        action()
        spent.append(wall_s() - began)
    return value, float(np.median(spent))
