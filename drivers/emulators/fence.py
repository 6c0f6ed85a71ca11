"""How far it is to the edge of a polygon: what an autopilot with a fence looks at. Pure, metres east and north."""

import math
from collections.abc import Sequence

Place = tuple[float, float]


def edge_ahead_m(here: Place, target: Place, fence: Sequence[Place]) -> float:
    """Distance from `here` to the fence in the direction of `target`; without a direction, to its nearest edge.

    Negative outside. Infinite where the way leads away from every edge.
    """
    nearest = min(_to_segment(here, a, b) for a, b in zip(fence, (*fence[1:], fence[0]), strict=True))
    if not _inside(here, fence):
        return -nearest
    step = (target[0] - here[0], target[1] - here[1])
    length = math.hypot(*step)
    if length < 1e-6:
        return nearest
    reach = 1e6 / length
    end = (here[0] + reach * step[0], here[1] + reach * step[1])
    crossings = (_crossing(here, end, a, b) for a, b in zip(fence, (*fence[1:], fence[0]), strict=True))
    return min((1e6 * share for share in crossings if share is not None), default=math.inf)


def _inside(point: Place, fence: Sequence[Place]) -> bool:
    odd = False
    for (e0, n0), (e1, n1) in zip(fence, (*fence[1:], fence[0]), strict=True):
        if (n0 > point[1]) != (n1 > point[1]) and point[0] < e0 + (point[1] - n0) / (n1 - n0) * (e1 - e0):
            odd = not odd
    return odd


def _to_segment(point: Place, a: Place, b: Place) -> float:
    step = (b[0] - a[0], b[1] - a[1])
    length2 = step[0] ** 2 + step[1] ** 2
    share = 0.0
    if length2 > 0:
        share = ((point[0] - a[0]) * step[0] + (point[1] - a[1]) * step[1]) / length2
    share = min(max(share, 0.0), 1.0)
    return math.hypot(point[0] - a[0] - share * step[0], point[1] - a[1] - share * step[1])


def _crossing(p: Place, q: Place, a: Place, b: Place) -> float | None:
    """Share of the way from p to q at which it crosses the segment a-b; None where it does not."""
    r, s = (q[0] - p[0], q[1] - p[1]), (b[0] - a[0], b[1] - a[1])
    turn = r[0] * s[1] - r[1] * s[0]
    if turn == 0:
        return None
    t = ((a[0] - p[0]) * s[1] - (a[1] - p[1]) * s[0]) / turn
    u = ((a[0] - p[0]) * r[1] - (a[1] - p[1]) * r[0]) / turn
    return t if 0 <= t <= 1 and 0 <= u <= 1 else None
