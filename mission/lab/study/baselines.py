"""What a survey's own estimate is compared with: the same readings, the same calibration, simpler thinking."""

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares
from scipy.special import logsumexp

from fieldkit.channel.model import Antenna
from fieldkit.engine.location.ground import Ground
from fieldkit.messages import FloatArray
from mission.lab.study.datasets import Survey

PARTICLES = 4000
POWER_SD_DB = 10.0
SIDE = 60


def strongest_reading(survey: Survey, antenna: Antenna, ground: Ground, up_m: float) -> FloatArray:
    """Where it was heard loudest."""
    return survey.place_m[int(np.argmax(survey.level_db)), :2]


def fit_least_squares(survey: Survey, antenna: Antenna, ground: Ground, up_m: float) -> FloatArray:
    """Place and power by robust least squares from the strongest reading, readings independent."""
    west, south, east, north = ground

    def residual(x: FloatArray) -> FloatArray:
        away = np.sqrt(((survey.place_m - np.array([x[0], x[1], up_m])) ** 2).sum(axis=1))
        mean = antenna.mean_rss_dbm(np.maximum(away, 0.1), x[2])
        return np.asarray((survey.level_db - mean) / antenna.sigma_db)

    start = np.append(strongest_reading(survey, antenna, ground, up_m) + 0.1, 0.0)
    low, high = np.array([west, south, -60.0]), np.array([east, north, 60.0])
    fit = least_squares(residual, np.clip(start, low + 1e-3, high - 1e-3), loss="soft_l1", bounds=(low, high))
    return np.asarray(fit.x[:2])


def independent_grid(survey: Survey, antenna: Antenna, ground: Ground, up_m: float) -> FloatArray:
    """The mean of a grid posterior with unknown power and readings that know nothing of each other."""
    return _grid(survey, antenna, ground, up_m)[0]


def independent_grid_holds(
    survey: Survey, antenna: Antenna, ground: Ground, up_m: float, share: float
) -> bool:
    """Whether that posterior's region of a share holds the truth."""
    _, points, probability, cell_m = _grid(survey, antenna, ground, up_m)
    order = np.argsort(-probability, kind="stable")
    inside = order[: int(np.searchsorted(np.cumsum(probability[order]), share)) + 1]
    return bool((np.abs(points[inside] - survey.truth_m[:2]) <= cell_m / 2).all(axis=1).any())


def _grid(
    survey: Survey, antenna: Antenna, ground: Ground, up_m: float
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    west, south, east, north = ground
    cell_m = max(east - west, north - south) / SIDE
    at_east, at_north = (
        np.arange(west + cell_m / 2, east, cell_m),
        np.arange(south + cell_m / 2, north, cell_m),
    )
    points = np.column_stack([np.tile(at_east, at_north.size), np.repeat(at_north, at_east.size)])
    logs = np.empty(points.shape[0])
    variance = antenna.sigma_db**2 + 1.0 / 12.0
    for k, point in enumerate(points):
        away = np.sqrt(((survey.place_m - np.array([*point, up_m])) ** 2).sum(axis=1))
        off = survey.level_db - antenna.mean_rss_dbm(np.maximum(away, 0.1))
        # An unknown power with a normal prior, integrated out.
        gain = POWER_SD_DB**2 / (variance + off.size * POWER_SD_DB**2)
        logs[k] = -0.5 * (float(off @ off) - gain * float(off.sum()) ** 2) / variance
    probability = np.exp(logs - logsumexp(logs))
    return np.asarray(probability @ points), points, probability, cell_m


def particle_filter(survey: Survey, antenna: Antenna, ground: Ground, up_m: float) -> FloatArray:
    """Stone Soup's bootstrap particle filter over place and power. Raises `ImportError` without Stone Soup."""
    from mission.lab.stone_soup import BootstrapFilter

    def log_likelihood_of(place_m: FloatArray, level_db: float) -> Callable[[FloatArray], FloatArray]:
        def log_likelihood(x: FloatArray) -> FloatArray:
            away = np.sqrt((x[0] - place_m[0]) ** 2 + (x[1] - place_m[1]) ** 2 + (up_m - place_m[2]) ** 2)
            off = level_db - antenna.mean_rss_dbm(np.maximum(away, 0.1), x[2])
            return np.asarray(-0.5 * off**2 / antenna.sigma_db**2)

        return log_likelihood

    rng = np.random.default_rng(0)
    west, south, east, north = ground
    cloud = np.vstack(
        [
            rng.uniform(west, east, PARTICLES),
            rng.uniform(south, north, PARTICLES),
            rng.normal(0.0, POWER_SD_DB, PARTICLES),
        ]
    )
    # Roughening keeps the cloud alive: a few per mille of the ground a step.
    step_m2 = (0.002 * max(east - west, north - south)) ** 2
    particles = BootstrapFilter(cloud, step_m2, 0.02, seed=0)
    for place, level in zip(survey.place_m, survey.level_db, strict=True):
        particles.update(log_likelihood_of(place, float(level)))
    return particles.mean[:2]


Baseline = Callable[[Survey, Antenna, Ground, float], FloatArray]
BASELINES: dict[str, Baseline] = {
    "strongest_reading": strongest_reading,
    "least_squares": fit_least_squares,
    "particle_filter": particle_filter,
    "independent_grid": independent_grid,
}
