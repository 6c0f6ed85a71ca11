"""The time ring: pairs of robots that meet their neighbours again and again on one tour (DPRWA section V.B).

The tour is a circle in time, `tau0_s` round. Pairs start evenly spread, every other one the other way round (eq 6);
where two meet they exchange what they know and turn back, so each swings to and fro about its place, in 4 tau0 / m = 2
tau0 / pairs. After T (eq 7, Lemma 2) every pair has had a checkpoint: checked by simulation for 2 to 12 pairs; for odd
numbers T is reached exactly, and such rings drift, as two neighbours start the same way round.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Meeting:
    """Two pairs meet on the ring; numbers from 0."""

    t_s: float
    first: int
    second: int


@dataclass(frozen=True, slots=True)
class Turn:
    """Where a pair is on the ring at a time, and which way it goes on."""

    t_s: float
    at_s: float
    way: int


def initial_positions_s(pairs: int, tau0_s: float) -> list[float]:
    """phi_u = 2 tau0 (u - 1) / m (eq 6)."""
    return [tau0_s * u / pairs for u in range(pairs)]


def initial_ways(pairs: int) -> list[int]:
    """+1 for odd u, -1 for even (eq 6), u counted from 1."""
    return [1 if u % 2 == 0 else -1 for u in range(pairs)]


def ring_time_s(pairs: int, tau0_s: float) -> float:
    """T after which every pair has a checkpoint (eq 7)."""
    return tau0_s / 2.0 if pairs % 2 == 0 else tau0_s / 2.0 + tau0_s / (2.0 * pairs)


def swing(pairs: int, tau0_s: float, until_s: float) -> tuple[list[Meeting], list[list[Turn]]]:
    """All meetings until `until_s`, and every pair's turns, its start the first of them.

    Pairs of equal speed that turn back where they meet move like points that pass through each other and swap names:
    so neighbours stay neighbours.
    """
    at, way = initial_positions_s(pairs, tau0_s), initial_ways(pairs)
    turns = [[Turn(0.0, at[u], way[u])] for u in range(pairs)]
    meetings: list[Meeting] = []
    t = 0.0
    if pairs < 2:
        return meetings, turns
    while True:
        gaps = []
        for u in range(pairs):
            v = (u + 1) % pairs
            if way[u] == 1 and way[v] == -1:
                ahead = (at[v] - at[u]) % tau0_s
                # Two pairs that have just met next meet on the other side of the ring.
                gaps.append(((tau0_s if pairs == 2 and ahead < 1e-9 else ahead) / 2.0, u, v))
        if not gaps:
            return meetings, turns
        soonest = min(gap for gap, _, _ in gaps)
        t += soonest
        if t > until_s + 1e-9:
            return meetings, turns
        at = [(a + w * soonest) % tau0_s for a, w in zip(at, way, strict=True)]
        for gap, u, v in gaps:
            if gap <= soonest + 1e-9:
                meetings.append(Meeting(t, u, v))
                way[u], way[v] = -1, 1
                turns[u].append(Turn(t, at[u], -1))
                turns[v].append(Turn(t, at[v], 1))


def position_s(turns: list[Turn], tau0_s: float, t_s: float) -> float:
    """Where on the ring a pair is at `t_s`."""
    last = max((turn for turn in turns if turn.t_s <= t_s), key=lambda turn: turn.t_s)
    return (last.at_s + last.way * (t_s - last.t_s)) % tau0_s


def first_checkpoints_s(pairs: int, tau0_s: float) -> list[float]:
    """When each pair first has something of everybody, if each meeting exchanges all; inf if not within 3 T."""
    knows = [[0.0 if p == u else -math.inf for p in range(pairs)] for u in range(pairs)]
    first = [math.inf if pairs > 1 else 0.0] * pairs
    for meeting in swing(pairs, tau0_s, 3.0 * ring_time_s(pairs, tau0_s))[0]:
        u, v = meeting.first, meeting.second
        knows[u][u] = knows[v][v] = meeting.t_s
        both = [max(a, b) for a, b in zip(knows[u], knows[v], strict=True)]
        knows[u], knows[v] = list(both), list(both)
        for pair in (u, v):
            if first[pair] == math.inf and min(knows[pair]) > -math.inf:
                first[pair] = meeting.t_s
    return first


def search_time_bound_s(
    rate_hz: float, pairs: int, tau0_s: float, inter_ring_s: float, missed: float
) -> float:
    """DPRWA Theorem 2 (eq 9): the expected time until a source is found is at most this.

    `missed` is E[e^-lt / (1 - e^-lt)] of the time within the sensing circle a period (`planning.bounds.missed_tours`).
    As RWA's theorem it takes a source for found at the first packet heard near it, and supposes that the tour comes
    by every source, which only virtual ridges see to.
    """
    return (
        inter_ring_s
        + tau0_s / (2.0 * pairs)
        + 1.0 / rate_hz
        + (inter_ring_s + ring_time_s(pairs, tau0_s)) * missed
    )


def memory_bound(cells: int, robots: int, since_checkpoint_s: float, per_robot_and_s: float) -> float:
    """Lemma 1 and Theorem 1: n + m (t - t_checkpoint) entries, with the entries a robot makes each second."""
    return cells + robots * since_checkpoint_s * per_robot_and_s
