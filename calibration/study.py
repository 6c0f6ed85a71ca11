"""Does the fit keep its promises? Bias and coverage over many simulated data sets with a known truth."""

from typing import Any

import numpy as np

from calibration.dataset import Readings, from_arrays
from calibration.fit import fit
from fieldkit.antenna.model import Antenna
from fieldkit.messages import FloatArray

#: The papers' calibration: exponent 2.53 and 3.3 dB; power and threshold give 11 % missed and 21 % saturated.
TRUTH = Antenna(2.53, -62.0, 3.3, -76.0, -49.0)
CONFIGURATIONS, PACKETS = 328, 20
RANGE_M = (0.15, 4.9)
CONDITIONS: dict[str, tuple[float, float]] = {"plain": (0.0, 0.0), "shadowed": (2.0, 0.0), "soft": (0.0, 2.0)}
"""Name to (place-to-place shadowing in dB, jitter of the threshold in dB)."""


def simulate(
    truth: Antenna,
    distance_m: FloatArray,
    packets: int,
    rng: np.random.Generator,
    *,
    shadowing_db: float = 0.0,
    jitter_db: float = 0.0,
) -> Readings:
    """`packets` at each distance (n,), with place-to-place shadowing and a jittering threshold if asked."""
    place = np.repeat(np.arange(len(distance_m)), packets)
    shadow = rng.normal(0.0, shadowing_db, len(distance_m))[place] if shadowing_db else 0.0
    mean = truth.mean_rss_dbm(distance_m)[place] + shadow
    reading = np.floor(mean + rng.normal(0.0, truth.sigma_db, len(place)) + 0.5)
    threshold = truth.threshold_dbm + np.rint(rng.normal(0.0, jitter_db, len(place)) if jitter_db else 0.0)
    reported = reading if truth.saturation_dbm is None else np.minimum(reading, truth.saturation_dbm)
    return from_arrays(distance_m[place], np.where(reading > threshold, reported, np.nan), place)


def run(trials: int = 200, seed: int = 0, conditions: tuple[str, ...] = tuple(CONDITIONS)) -> dict[str, Any]:
    """Bias of each parameter and how often its 95 % interval holds the truth, per condition."""
    report: dict[str, Any] = {}
    for name in conditions:
        shadowing_db, jitter_db = CONDITIONS[name]
        wanted = {
            "path_loss_exponent": TRUTH.path_loss_exponent,
            "power_at_1m_dbm": TRUTH.power_at_1m_dbm,
            "sigma_db": float(np.hypot(TRUTH.sigma_db, shadowing_db)),
            "threshold_dbm": TRUTH.threshold_dbm,
        }
        errors: dict[str, list[float]] = {key: [] for key in wanted}
        covered: dict[str, list[bool]] = {key: [] for key in wanted}
        missed, saturated = [], []
        for trial in range(trials):
            rng = np.random.default_rng([seed, trial])
            distance = np.exp(rng.uniform(np.log(RANGE_M[0]), np.log(RANGE_M[1]), CONFIGURATIONS))
            readings = simulate(TRUTH, distance, PACKETS, rng, shadowing_db=shadowing_db, jitter_db=jitter_db)
            result = fit(readings)
            missed.append(readings.missed.mean())
            saturated.append(result.n_saturated / len(readings.rss_dbm))
            for key, truth in wanted.items():
                low, high = result.intervals_95[key]
                errors[key].append(getattr(result.antenna, key) - truth)
                covered[key].append(low <= truth <= high)
        report[name] = {
            "trials": trials,
            "missed": float(np.mean(missed)),
            "saturated": float(np.mean(saturated)),
            "bias": {key: float(np.mean(values)) for key, values in errors.items()},
            "coverage": {key: float(np.mean(values)) for key, values in covered.items()},
        }
    return report
