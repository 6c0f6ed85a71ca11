"""A CSMA channel simulated packet by packet: what the formulas of `sensing.csma` are checked against.

It shares nothing with them. Every node makes packets at random times and sends one if it hears no other node, whose
packets it hears `a` after they begin until `a` after they end. Time is in packet lengths. A node that finds the channel
busy drops the packet, or tries again after an exponential back-off; so it does after a collision.
"""

import heapq
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Traffic:
    """Shares of the time."""

    idle: float
    """Nothing on the air or still on its way."""
    busy_collision: float
    """Of the busy time: two or more packets on the air at once."""


def simulate_channel(
    nodes: int, rate: float, a: float, packets: int, rng: np.random.Generator, *, backoff: float | None = None
) -> Traffic:
    """About `packets` new packets of `nodes`, each making `rate` a packet length; `backoff` is the mean delay."""
    times = np.cumsum(rng.exponential(1.0 / (nodes * rate), packets))
    waiting: list[tuple[float, int]] = [
        (float(t), int(n)) for t, n in zip(times, rng.integers(0, nodes, packets), strict=True)
    ]
    heapq.heapify(waiting)
    until = float(times[-1])
    sent: list[float] = []
    free = np.zeros(nodes)  # when each node ends the packet it sends itself
    period: list[tuple[float, int]] = []  # packets that may yet collide
    while waiting and waiting[0][0] <= until:
        t, node = heapq.heappop(waiting)
        while period and period[0][0] + 1.0 + a <= t:
            period.pop(0)
        heard = any(start + a <= t < start + 1.0 + a for start, who in period if who != node)
        if heard or free[node] > t:
            if backoff is not None:
                heapq.heappush(waiting, (t + float(rng.exponential(backoff)), node))
            continue
        if backoff is not None:
            on_air = [(start, who) for start, who in period if start + 1.0 > t]
            collided = [*on_air, (t, node)] if on_air else []
            for start, who in collided:
                if start == t or len(on_air) == 1:  # the first learns of it with the second
                    heapq.heappush(waiting, (start + 1.0 + float(rng.exponential(backoff)), who))
        sent.append(t)
        free[node] = t + 1.0
        period.append((t, node))
    return shares(np.array(sent), a, until)


def shares(start: np.ndarray, a: float, until: float) -> Traffic:
    """Idle and collision time of packets that began at `start`, in order, each 1 long."""
    ends = np.concatenate(
        [np.column_stack([start, np.ones_like(start)]), np.column_stack([start + 1.0, -np.ones_like(start)])]
    )
    order = np.argsort(ends[:, 0], kind="stable")
    level = np.cumsum(ends[order, 1])
    span = np.diff(ends[order, 0], append=ends[order[-1], 0])
    overlap = float(span[level >= 2].sum())
    gap = np.maximum(0.0, np.diff(start, append=until) - (1.0 + a))
    gap[-1] = max(0.0, until - start[-1] - 1.0 - a)
    idle = float(gap.sum()) + float(start[0])
    return Traffic(idle / until, overlap / max(until - idle, 1e-12))
