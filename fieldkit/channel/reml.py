"""The spread of a channel from readings of transmitters at known places: restricted maximum likelihood.

The means of power, exponent and elevation are integrated out (Patterson and Thompson, Biometrika 58, 1971), so
that few transmitters do not make the spread too small. Weak priors keep what the readings do not determine at ordinary
values; the curvature at the optimum says how well each parameter is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from scipy.optimize import minimize

from fieldkit.channel.spread import HYPER, ChannelSpread
from fieldkit.errors import CalibrationRefused
from fieldkit.messages import FloatArray

MOST_PLACES = 150
"""Places of one transmitter, at most: nearer ones are taken together."""
FEWEST_PLACES = 5
TYPICAL = {
    "sigma_time_db": (2.5, 0.7),
    "sigma_place_db": (4.0, 0.5),
    "transmitter_db": (3.0, 0.5),
    "transmitter_exponent": (0.4, 0.5),
    "lobe_db": (2.0, 0.7),
}
"""Prior median and deviation of the logarithm, from published campaigns (indoor and outdoor, 2.4 and 3.3 GHz)."""
LENGTH_SHARE, LENGTH_LOG_SD = 0.25, 1.0
"""Prior median of the correlation length as a share of the median distance, and deviation of its logarithm."""
ROUNDING_VAR = 1.0 / 12.0


@dataclass(frozen=True, slots=True, eq=False)
class Transmitter:
    """What was heard of one transmitter: places (n, 3) of the receiver and levels (n,), in metres and dB."""

    place_m: FloatArray
    level_db: FloatArray
    source_m: FloatArray
    """(3,)"""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Readings taken together by place, in order of their first ones."""

    place_m: FloatArray
    level_db: FloatArray
    count: FloatArray
    within: float
    """Sum of squares of the readings about their places' means."""
    freedom: int
    cell_m: float
    index: np.ndarray
    """Reading to its place."""


def by_place(place_m: FloatArray, level_db: FloatArray, cell_m: float, most: int) -> Places:
    """Take together what was read in one cell; cells grow until there are no more than `most`."""
    while True:
        key = np.round(place_m / max(cell_m, 1e-9)).astype(np.int64)
        _, first, inverse = np.unique(key, axis=0, return_index=True, return_inverse=True)
        if first.size <= most:
            break
        cell_m *= 1.25
    rank = np.empty(first.size, dtype=np.int64)
    rank[np.argsort(first)] = np.arange(first.size)
    index = rank[inverse.ravel()]
    count = np.bincount(index).astype(float)
    mean = np.bincount(index, level_db) / count
    place = np.column_stack([np.bincount(index, place_m[:, axis]) / count for axis in range(3)])
    within = float(((level_db - mean[index]) ** 2).sum())
    return Places(place, mean, count, within, level_db.size - first.size, cell_m, index)


def design(place_m: FloatArray, source_m: FloatArray, min_range_m: float) -> FloatArray:
    """(n, 5): what the mean level is linear in: 1, distance, direction east and north, elevation."""
    offset = place_m - source_m
    away = np.maximum(np.sqrt((offset**2).sum(axis=1)), min_range_m)
    flat = np.hypot(offset[:, 0], offset[:, 1]) / away
    level = np.where(offset[:, 2] == 0.0, 1.0, np.maximum(flat, 0.1))
    return np.column_stack(
        [
            np.ones(away.size),
            -10.0 * np.log10(away),
            offset[:, 0] / away,
            offset[:, 1] / away,
            20.0 * np.log10(level),
        ]
    )


class _Problem:
    """Negative log of likelihood times prior, over the logarithms of `HYPER`."""

    def __init__(self, transmitters: Sequence[Transmitter], cell_m: float, min_range_m: float) -> None:
        self.heights = any(
            np.ptp(each.place_m[:, 2] - each.source_m[2]) > 0.0
            or np.any(each.place_m[:, 2] != each.source_m[2])
            for each in transmitters
        )
        self.fixed = [0, 1, 4] if self.heights else [0, 1]
        self.parts = []
        distances = []
        for each in transmitters:
            averaged = by_place(each.place_m, each.level_db, cell_m, MOST_PLACES)
            apart = np.sqrt(((averaged.place_m[:, None] - averaged.place_m[None]) ** 2).sum(axis=-1))
            columns = design(averaged.place_m, each.source_m, min_range_m)
            distances.append(10.0 ** (-columns[:, 1] / 10.0))
            self.parts.append((averaged, apart, columns))
        typical_m = float(np.median(np.concatenate(distances)))
        self.typical = {**TYPICAL, "correlation_m": (max(LENGTH_SHARE * typical_m, 0.3), LENGTH_LOG_SD)}
        self.start = np.log([self.typical[name][0] for name in HYPER])
        self.width = np.array([self.typical[name][1] for name in HYPER])
        level = float(np.mean(np.concatenate([averaged.level_db for averaged, _, _ in self.parts])))
        self.mean0 = np.array([level + 22.0 * np.log10(typical_m), 2.2, 0.0])[: len(self.fixed)]
        self.weight0 = np.array([1.0 / 100.0**2, 1.0, 0.25])[: len(self.fixed)]

    def __call__(self, logs: FloatArray) -> float:
        return self.solve(logs)[0]

    def solve(self, logs: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """The value, the means of the coefficients, and their covariance."""
        time_db, place_db, length_m, power_db, exponent, lobe_db = np.exp(np.clip(logs, -12.0, 12.0))
        own = np.array([power_db**2, exponent**2, lobe_db**2, lobe_db**2, 0.25 if self.heights else 1e-9])
        white = time_db**2 + ROUNDING_VAR
        precision = np.diag(self.weight0)
        right = self.weight0 * self.mean0
        value = 0.5 * float(self.mean0 @ right)
        for averaged, apart, columns in self.parts:
            cov = place_db**2 * np.exp(-apart / length_m) + (columns * own) @ columns.T
            cov[np.diag_indices_from(cov)] += white / averaged.count
            try:
                root = scipy.linalg.cholesky(cov, lower=True, check_finite=False)
            except scipy.linalg.LinAlgError:
                return 1e12, self.mean0, np.diag(1.0 / self.weight0)
            both = scipy.linalg.solve_triangular(
                root,
                np.column_stack([averaged.level_db, columns[:, self.fixed]]),
                lower=True,
                check_finite=False,
            )
            precision += both[:, 1:].T @ both[:, 1:]
            right = right + both[:, 1:].T @ both[:, 0]
            value += 0.5 * float(both[:, 0] @ both[:, 0]) + float(np.log(np.diag(root)).sum())
            value += 0.5 * averaged.within / white + 0.5 * averaged.freedom * float(np.log(white))
        mean = np.linalg.solve(precision, right)
        value += -0.5 * float(right @ mean) + 0.5 * float(np.linalg.slogdet(precision)[1])
        value += 0.5 * float((((logs - self.start) / self.width) ** 2).sum())
        return value, mean, np.linalg.inv(precision)

    def curvature(self, logs: FloatArray, step: float = 0.1) -> FloatArray:
        """Second derivatives by differences."""
        size = logs.size
        centre, unit = self(logs), np.eye(size) * step
        up = [self(logs + each) for each in unit]
        down = [self(logs - each) for each in unit]
        found = np.empty((size, size))
        for i in range(size):
            found[i, i] = (up[i] - 2.0 * centre + down[i]) / step**2
            for j in range(i):
                both = self(logs + unit[i] + unit[j]) + self(logs - unit[i] - unit[j])
                cross = both - up[i] - up[j] + 2.0 * centre - down[i] - down[j]
                found[i, j] = found[j, i] = cross / (2.0 * step**2)
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Reml:
    """What `estimate` found."""

    spread: ChannelSpread
    power_at_1m_dbm: float
    path_loss_exponent: float
    sigma_db: float
    """Of one reading of one transmitter at a new place."""
    correlation_95_m: tuple[float, float]
    min_range_m: float


def estimate(transmitters: Sequence[Transmitter], *, cell_m: float | None = None) -> Reml:
    """Raises `CalibrationRefused` where no transmitter was heard at enough places."""
    enough = [each for each in transmitters if np.unique(each.place_m, axis=0).shape[0] >= FEWEST_PLACES]
    if not enough:
        raise CalibrationRefused(
            f"no transmitter was heard at {FEWEST_PLACES} places: what differs from place to place cannot be estimated"
        )
    away = np.concatenate([np.sqrt(((t.place_m - t.source_m) ** 2).sum(axis=1)) for t in enough])
    least = min_range_m(away)
    problem = _Problem(enough, cell_m if cell_m is not None else typical_cell_m(away), least)
    best = minimize(problem, problem.start, method="L-BFGS-B", options={"eps": 1e-3, "maxiter": 60})
    values, vectors = np.linalg.eigh(problem.curvature(best.x))
    log_covariance = (vectors / np.maximum(values, 0.5)) @ vectors.T
    _, mean, covariance = problem.solve(best.x)
    full = np.diag([0.0, 0.0, 1e-9])
    full[: mean.size, : mean.size] = covariance
    hyper = dict(zip(HYPER, np.exp(best.x).tolist(), strict=True))
    spread = ChannelSpread(
        **hyper,
        elevation=float(mean[2]) if problem.heights else 0.0,
        elevation_sd=0.5 if problem.heights else 1.0,
        transmitters=len(enough),
        mean_covariance=tuple(map(tuple, full.tolist())),
        log_covariance=tuple(map(tuple, log_covariance.tolist())),
    )
    at, half = best.x[2], 1.96 * float(np.sqrt(log_covariance[2, 2]))
    return Reml(
        spread,
        float(mean[0]),
        float(mean[1]),
        float(np.hypot(hyper["sigma_time_db"], hyper["sigma_place_db"])),
        (float(np.exp(at - half)), float(np.exp(at + half))),
        least,
    )


def min_range_m(distance_m: FloatArray) -> float:
    """Nearer than this all distances count alike: there is no near field in the model."""
    return float(np.clip(0.05 * np.median(distance_m), 0.05, 1.0))


def typical_cell_m(distance_m: FloatArray) -> float:
    """Readings nearer to each other than this are of one place."""
    return float(np.clip(0.08 * np.median(distance_m), 0.05, 5.0))
