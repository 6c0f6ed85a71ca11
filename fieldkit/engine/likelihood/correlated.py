"""The likelihood of what was heard of one source under shadowing that belongs to places (`channel.spread`).

Each reading is conditioned on its nearest earlier ones (Vecchia, J. R. Stat. Soc. B 50, 1988; Datta et al., J. Am.
Stat. Assoc. 111, 2016), with weights that depend on where receivers were, not on where the source is; the source's
own power, exponent, lobe and elevation law are integrated out exactly, the calibration's uncertainty by draws.
So the fiftieth reading of a place is no fiftieth witness, and a peak of the shadowing is no power.

With a single draw without place noise and with nothing unknown this is the sum of independent normal densities.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fieldkit.channel.reml import ROUNDING_VAR, Places, by_place
from fieldkit.channel.spread import Draw
from fieldkit.engine.likelihood import correlated_loops as loops
from fieldkit.messages import FloatArray

NEIGHBOURS = 10
MOST_PLACES = 240


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """Readings of one source, taken together by place, and how they hang together under one draw."""

    places: Places
    neighbours: np.ndarray
    weights: FloatArray
    deviation: FloatArray


def together(
    place_m: FloatArray, level_db: FloatArray, cell_m: float, most: int = MOST_PLACES
) -> tuple[Places, np.ndarray]:
    """Readings by place, and of each place its nearest earlier ones."""
    places = by_place(place_m, level_db, cell_m, most)
    neighbours = np.full(
        (places.count.size, min(NEIGHBOURS, max(1, places.count.size - 1))), -1, dtype=np.int64
    )
    loops.nearest_earlier(places.place_m, neighbours.shape[1], neighbours)
    return places, neighbours


def conditioned(places: Places, neighbours: np.ndarray, draw: Draw, place_sigma_db: float = 0.0) -> Heard:
    """The same under one draw. `place_sigma_db`: what unsure receiver positions add to every place's reading."""
    weights, deviation = np.empty(neighbours.shape), np.empty(places.count.size)
    noise = (draw.time_var + ROUNDING_VAR) / places.count + place_sigma_db**2
    loops.condition(places.place_m, neighbours, noise, draw.place_var, draw.correlation_m, weights, deviation)
    return Heard(places, neighbours, weights, deviation)


def log_likelihood(
    points_m: FloatArray,
    places: Places,
    neighbours: np.ndarray,
    draws: Sequence[Draw],
    min_range_m: float,
    smear_db: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """(draws, c): log p(all that was heard | source at the point (c, 3)), and (c, p) the first draw's coefficients."""
    logs = np.empty((len(draws), points_m.shape[0]))
    first = np.empty((points_m.shape[0], loops.FEATURES))
    best = np.empty_like(first)
    points = np.ascontiguousarray(points_m)
    for number, draw in enumerate(draws):
        heard = conditioned(places, neighbours, draw, smear_db)
        loops.log_marginal(
            points,
            places.place_m,
            places.level_db,
            neighbours,
            heard.weights,
            heard.deviation,
            draw.mean,
            np.asarray(np.linalg.inv(draw.covariance), dtype=float),
            min_range_m,
            logs[number],
            first if number == 0 else best,
        )
        white = draw.time_var + ROUNDING_VAR
        logs[number] -= 0.5 * places.within / white + 0.5 * places.freedom * np.log(2.0 * np.pi * white)
    return logs, first


def residuals(
    point_m: FloatArray, places: Places, neighbours: np.ndarray, draw: Draw, min_range_m: float
) -> FloatArray:
    """(n,) standardised residual of each place's reading given the earlier ones: white where the model holds.

    One step ahead: the coefficients are learnt from the earlier places alone, as a Kalman filter does.
    """
    heard = conditioned(places, neighbours, draw)
    columns = np.empty((places.count.size, loops.FEATURES))
    loops.features(
        float(point_m[0]), float(point_m[1]), float(point_m[2]), places.place_m, min_range_m, columns
    )
    mean, covariance = draw.mean.copy(), draw.covariance.copy()
    found = np.empty(places.count.size)
    for k in range(places.count.size):
        use = neighbours[k] >= 0
        earlier = neighbours[k][use]
        row = columns[k] - heard.weights[k][use] @ columns[earlier]
        level = places.level_db[k] - heard.weights[k][use] @ places.level_db[earlier]
        gain = covariance @ row
        variance = float(row @ gain) + heard.deviation[k] ** 2
        off = level - float(row @ mean)
        found[k] = off / np.sqrt(variance)
        mean = mean + gain * (off / variance)
        covariance = covariance - np.outer(gain, gain) / variance
    return found
