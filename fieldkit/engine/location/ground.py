"""A posterior over the ground: points that refine themselves where it matters, its spread and its regions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from fieldkit.messages import FloatArray

FIRST_SIDE = 40
"""Points along the longer side at first."""
REFINED_SIDE = 32
REFINEMENTS = 3
NEGLIGIBLE_NATS = 12.0
ENOUGH = 12.0
"""Points along the posterior's own width that are enough."""

Ground = tuple[float, float, float, float]
"""West, south, east, north."""


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Square cells of one size, with the probability of each."""

    points_m: FloatArray
    """(c, 2)"""
    probability: FloatArray
    """(c,), sums to 1."""
    cell_m: float
    log_evidence: float
    """log of the mean likelihood over the whole ground."""
    coefficients: FloatArray
    """(c, p)"""

    @property
    def mean_m(self) -> FloatArray:
        return np.asarray(self.probability @ self.points_m)

    @property
    def cov_m2(self) -> FloatArray:
        """About the mean, the cells' own size included."""
        offset = self.points_m - self.mean_m
        return np.asarray((offset * self.probability[:, None]).T @ offset + np.eye(2) * self.cell_m**2 / 12.0)

    @property
    def likeliest(self) -> int:
        return int(np.argmax(self.probability))

    def centre_m(self) -> FloatArray:
        """(2,) the place with the least expected distance to the source: a far tail does not pull it along."""
        at = self.points_m[self.likeliest].astype(float)
        for _ in range(100):
            weight = self.probability / np.maximum(np.hypot(*(self.points_m - at).T), 0.25 * self.cell_m)
            step = weight @ self.points_m / weight.sum()
            if np.hypot(*(step - at)) < 0.01 * self.cell_m:
                break
            at = step
        return np.asarray(at)

    def region(self, share: float) -> np.ndarray:
        """Indices of the fewest cells that hold this share, most probable first."""
        order = np.argsort(-self.probability, kind="stable")
        needed = int(np.searchsorted(np.cumsum(self.probability[order]), share)) + 1
        return order[:needed]

    def holds(self, place_m: FloatArray, share: float) -> bool:
        """Whether the region of this share holds a place."""
        chosen = self.points_m[self.region(share)]
        return bool(
            (np.abs(chosen - np.asarray(place_m)) <= 0.5 * self.cell_m * (1.0 + 1e-9)).all(axis=1).any()
        )

    def within(self, place_m: FloatArray, radius_m: float) -> float:
        """Probability of being within a radius, cells on the edge by halves."""
        away = np.hypot(*(self.points_m - np.asarray(place_m)).T)
        part = np.clip((radius_m - away) / self.cell_m + 0.5, 0.0, 1.0)
        return float(part @ self.probability)


def explore(
    log_of: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    ground: Ground,
    first_side: int = FIRST_SIDE,
) -> Posterior:
    """The posterior under an even prior. `log_of`: points (c, 2) to log likelihoods (c,) and coefficients (c, p)."""
    west, south, east, north = ground
    area = (east - west) * (north - south)
    box, side = ground, first_side
    evidence = 0.0
    for turn in range(REFINEMENTS + 1):
        points, cell_m = _cells(box, side)
        logs, coefficients = log_of(points)
        if turn == 0:
            evidence = float(logsumexp(logs)) + np.log(cell_m**2 / area)
        probability = np.exp(logs - logsumexp(logs))
        found = Posterior(points, probability / probability.sum(), cell_m, evidence, coefficients)
        near = logs > logs.max() - NEGLIGIBLE_NATS
        low = np.maximum(points[near].min(axis=0) - cell_m, [box[0], box[1]])
        high = np.minimum(points[near].max(axis=0) + cell_m, [box[2], box[3]])
        spread_m = float(np.sqrt(np.linalg.eigvalsh(found.cov_m2)[0]))
        fine_m = max(high - low) / min(REFINED_SIDE, first_side)
        if cell_m * ENOUGH <= 4.0 * spread_m or fine_m > 0.8 * cell_m:
            break
        box, side = (
            (float(low[0]), float(low[1]), float(high[0]), float(high[1])),
            min(REFINED_SIDE, first_side),
        )
    if turn > 0:
        evidence = float(logsumexp(logs)) + np.log(found.cell_m**2 / area)
        found = Posterior(found.points_m, found.probability, found.cell_m, evidence, found.coefficients)
    return found


def _cells(box: Ground, side: int) -> tuple[FloatArray, float]:
    """Centres (c, 2) of square cells that cover the box, and their size."""
    west, south, east, north = box
    cell_m = max(east - west, north - south) / side
    columns = max(1, int(np.ceil((east - west) / cell_m - 1e-9)))
    rows = max(1, int(np.ceil((north - south) / cell_m - 1e-9)))
    at_east = west + (np.arange(columns) + 0.5) * cell_m
    at_north = south + (np.arange(rows) + 0.5) * cell_m
    return np.column_stack([np.tile(at_east, rows), np.repeat(at_north, columns)]), cell_m


def polygon(posterior: Posterior, share: float) -> list[list[list[float]]]:
    """The region of this share as closed rings, one an outline or a hole, along the cells' edges."""
    chosen = {tuple(each) for each in _lattice(posterior)[posterior.region(share)].tolist()}
    edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for column, row in sorted(chosen):
        for off, start, end in (
            ((0, -1), (0, 0), (1, 0)),
            ((1, 0), (1, 0), (1, 1)),
            ((0, 1), (1, 1), (0, 1)),
            ((-1, 0), (0, 1), (0, 0)),
        ):
            if (column + off[0], row + off[1]) not in chosen:
                edges.setdefault((column + start[0], row + start[1]), []).append(
                    (column + end[0], row + end[1])
                )
    origin = posterior.points_m.min(axis=0) - 0.5 * posterior.cell_m
    rings = []
    while edges:
        start = next(iter(edges))
        ring, at = [start], start
        while True:
            following = edges[at].pop()
            if not edges[at]:
                del edges[at]
            ring.append(following)
            at = following
            if at == start:
                break
        rings.append([[float(v) for v in origin + np.array(corner) * posterior.cell_m] for corner in ring])
    return rings


def _lattice(posterior: Posterior) -> np.ndarray:
    """(c, 2) column and row of each cell."""
    result: np.ndarray = np.rint(
        (posterior.points_m - posterior.points_m.min(axis=0)) / posterior.cell_m
    ).astype(int)
    return result
