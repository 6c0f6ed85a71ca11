"""Walls that weaken what passes through them: segments over ground, each with its loss."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fieldkit.messages import FloatArray


@dataclass(frozen=True, slots=True)
class Wall:
    """From one end (east, north) to the other, in metres."""

    ends_m: tuple[tuple[float, float], tuple[float, float]]
    loss_db: float


def walls_loss_db(source_m: FloatArray, places_m: FloatArray, walls: Sequence[Wall]) -> FloatArray:
    """(m,) dB lost from a source (2,) to places (m, 2): the sum over the walls that the straight way crosses."""
    loss = np.zeros(places_m.shape[0])
    for wall in walls:
        a, b = np.array(wall.ends_m[0]), np.array(wall.ends_m[1])
        apart = _side(a, b, source_m[None]) * _side(a, b, places_m) < 0.0
        within = _side(source_m, places_m, a[None]) * _side(source_m, places_m, b[None]) < 0.0
        loss += wall.loss_db * (apart & within)
    return loss


def _side(start: FloatArray, end: FloatArray, points: FloatArray) -> FloatArray:
    """(m,) positive left of the line from `start` to `end`, negative right of it; any of them may be (m, 2)."""
    way, off = end - start, points - start
    return np.asarray(way[..., 0] * off[..., 1] - way[..., 1] * off[..., 0])


def random_walls(
    count: int, size_m: float, length_m: float, loss_db: float, rng: np.random.Generator
) -> tuple[Wall, ...]:
    """Walls anywhere in a square field, in any direction."""
    walls = []
    for _ in range(count):
        middle, angle = rng.uniform(0.0, size_m, 2), rng.uniform(0.0, np.pi)
        half = 0.5 * length_m * np.array([np.sin(angle), np.cos(angle)])
        low, high = middle - half, middle + half
        walls.append(Wall(((float(low[0]), float(low[1])), (float(high[0]), float(high[1]))), loss_db))
    return tuple(walls)
