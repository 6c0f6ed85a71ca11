"""Who sent what in a whole log, when nobody says: as few sources as explain it.

All that was heard begins as one source's. A source is divided where two explain it better by more than saying of
each packet which of the two sent it costs; with the channel's own spread, and with as much more of it as one source
would need, so that a wrong sigma makes no second source.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fieldkit.channel.reml import design, min_range_m
from fieldkit.engine.location.ground import Ground
from fieldkit.engine.location.one_source import Located, OneSource, Radio, locate
from fieldkit.messages import FloatArray, IntArray

CLEARLY_NATS = 6.0
"""Evidence by which two sources must beat one."""
FEWEST_PACKETS = 3
MOST_SOURCES = 8
ROUNDS = 5
MOST_LOOKED_AT = 400
MOST_TOLD = 300
"""Packets of which a first guess is made."""
PLACES_SIDE, PLACE_ROUNDS = 22, 8
WIDER = (1.0, 1.6, 2.5)
"""Factors on all deviations under which one source is compared with two."""


@dataclass(frozen=True, slots=True, eq=False)
class Packets:
    """All that was heard: readings (n,) with the packet (n,) each belongs to, packets counted from 0."""

    place_m: FloatArray
    level_db: FloatArray
    packet: IntArray

    @property
    def count(self) -> int:
        return int(self.packet.max()) + 1 if self.packet.size else 0

    def of(self, packets: IntArray) -> OneSource:
        """The readings of some packets as one source's."""
        mine = np.isin(self.packet, packets)
        return OneSource(self.place_m[mine], self.level_db[mine])


def separate(
    packets: Packets, radio: Radio, ground: Ground, progress: Callable[[float], None] = lambda _: None
) -> list[IntArray]:
    """Packets (numbers) by source, most packets first. Of very many some are looked at; the others follow."""
    step = -(-packets.count // MOST_LOOKED_AT)
    waiting = [np.arange(0, packets.count, step)]
    total = waiting[0].size
    settled: list[IntArray] = []
    while waiting:
        group = waiting.pop(0)
        progress(1.0 - sum(each.size for each in [group, *waiting]) / total)
        parts = None
        if group.size >= 2 * FEWEST_PACKETS and len(settled) + len(waiting) + 1 < MOST_SOURCES:
            parts = _divided(packets, group, radio, ground)
        if parts is None:
            settled.append(group)
        else:
            waiting += parts
    groups = _reunited(packets, settled, radio, ground)
    if step > 1:
        groups = _all_of(packets, groups, radio, ground)
    return sorted(groups, key=lambda each: -each.size)


def _all_of(packets: Packets, groups: list[IntArray], radio: Radio, ground: Ground) -> list[IntArray]:
    """Every packet to the source that explains it best, from those that some were given to."""
    everything = np.arange(packets.count)
    if len(groups) == 1:
        return [everything]
    logs = [_packet_logs(packets, everything, each, radio, ground) + math.log(each.size) for each in groups]
    best = np.argmax(np.column_stack(logs), axis=1)
    return [everything[best == k] for k in range(len(groups)) if (best == k).any()]


def _evidence(source: OneSource, radio: Radio, ground: Ground, wider: float) -> tuple[float, Located]:
    found = locate(source, _widened(radio, wider), ground, roughly=True)
    return found.posterior.log_evidence, found


def _widened(radio: Radio, factor: float) -> Radio:
    from dataclasses import replace

    if factor == 1.0:
        return radio
    spread = radio.spread
    wide = replace(
        spread,
        sigma_time_db=spread.sigma_time_db * factor,
        sigma_place_db=spread.sigma_place_db * factor,
    )
    return replace(radio, spread=wide, ways={})


def _divided(packets: Packets, group: IntArray, radio: Radio, ground: Ground) -> list[IntArray] | None:
    """Two groups where two sources explain this one better; None where not."""
    whole = packets.of(group)
    single = {factor: _evidence(whole, radio, ground, factor)[0] for factor in WIDER}
    best, best_parts = max(single.values()) + CLEARLY_NATS, None
    for first in [*_guesses(packets, group), *_two_places(packets, group, radio, ground)]:
        settled = _settled(packets, group, first, radio, ground)
        if settled is None:
            continue
        parts, score = settled
        for part in parts:
            score += max(_evidence(packets.of(part), radio, ground, factor)[0] for factor in WIDER[:2])
            score += part.size * math.log(part.size / group.size)
        if score > best:
            best, best_parts = score, parts
    return best_parts


def _two_places(packets: Packets, group: IntArray, radio: Radio, ground: Ground) -> list[np.ndarray]:
    """A guess from the two places and powers that together explain the packets best, every reading by itself.

    Coordinate ascent from the best single one, and from the best one for what that explains worst.
    """
    chosen = group[:: -(-group.size // MOST_TOLD)]
    mine = np.flatnonzero(np.isin(packets.packet, chosen))
    west, south, east, north = ground
    side = max(east - west, north - south) / PLACES_SIDE
    at_east, at_north = np.arange(west + side / 2, east, side), np.arange(south + side / 2, north, side)
    points = np.column_stack(
        [
            np.tile(at_east, at_north.size),
            np.repeat(at_north, at_east.size),
            np.full(at_east.size * at_north.size, radio.source_up_m),
        ]
    )
    draw = radio.draws(1)[0][0]
    apart = np.sqrt(((packets.place_m[mine, None] - points[None]) ** 2).sum(axis=-1))
    mean = draw.mean[0] - 10.0 * draw.mean[1] * np.log10(np.maximum(apart, 0.3 * side))
    sd_db = float(np.sqrt(draw.covariance[0, 0]))
    powers = np.linspace(-1.6, 1.6, 7) * sd_db
    off = (packets.level_db[mine, None] - mean)[:, :, None] - powers
    variance = draw.time_var + draw.place_var
    logs = (-0.5 * off**2 / variance).reshape(mine.size, -1)
    number = np.searchsorted(chosen, packets.packet[mine])
    by_packet = np.zeros((chosen.size, logs.shape[1]))
    np.add.at(by_packet, number, logs)
    like = np.exp(np.maximum(by_packet, -60.0)) + 1e-9
    single = np.log(like).sum(axis=0)
    found = []
    for first in (int(np.argmax(single)), int(np.argmax(like[int(np.argmin(like[:, np.argmax(single)]))]))):
        second = first
        for _ in range(PLACE_ROUNDS):
            first, second = second, int(np.argmax(np.log(like + like[:, first, None]).sum(axis=0)))
        first_sent = by_packet[:, first] > by_packet[:, second]
        # Packets that were left out follow the nearest in time that was not.
        nearest = np.clip(np.searchsorted(chosen, group), 0, chosen.size - 1)
        guess = first_sent[nearest]
        if FEWEST_PACKETS <= guess.sum() <= guess.size - FEWEST_PACKETS:
            found.append(guess)
    return found


def _guesses(packets: Packets, group: IntArray) -> list[np.ndarray]:
    """First guesses (packets of the group,) of which were sent by the first of two sources."""
    level = np.full(group.size, -np.inf)
    place = np.zeros((group.size, 2))
    at = np.full(packets.count, -1)
    at[group] = np.arange(group.size)
    for reading in np.flatnonzero(at[packets.packet] >= 0):
        k = at[packets.packet[reading]]
        if packets.level_db[reading] > level[k]:
            level[k], place[k] = packets.level_db[reading], packets.place_m[reading, :2]
    found = []
    offset = place - place.mean(axis=0)
    if np.ptp(place) > 0.0:
        axis = np.linalg.svd(offset, full_matrices=False)[2][0]
        found.append(offset @ axis > np.median(offset @ axis))
        # The strongest place, and the strongest one far from it.
        top = int(np.argmax(level))
        away = np.hypot(*(place - place[top]).T)
        far = away > 0.35 * away.max()
        if far.any():
            other = int(np.flatnonzero(far)[np.argmax(level[far])])
            found.append(away < np.hypot(*(place - place[other]).T))
    # Two levels at the same places: stronger and weaker than the neighbours'.
    near = np.argsort(
        np.sum((place[:, None] - place[None]) ** 2, axis=-1)
        if group.size <= 600
        else np.abs(np.arange(group.size)[:, None] - np.arange(group.size)[None]),
        axis=1,
    )[:, :9]
    found.append(level > np.median(level[near], axis=1))
    return [each for each in found if FEWEST_PACKETS <= each.sum() <= each.size - FEWEST_PACKETS]


def _settled(
    packets: Packets, group: IntArray, first: np.ndarray, radio: Radio, ground: Ground
) -> tuple[list[IntArray], float] | None:
    """Two groups that no packet wants to leave, from a first guess, and the entropy of who sent what."""
    entropy = 0.0
    for _ in range(ROUNDS):
        parts = [group[first], group[~first]]
        if min(part.size for part in parts) < FEWEST_PACKETS:
            return None
        logs = np.column_stack([_packet_logs(packets, group, part, radio, ground) for part in parts])
        logs += np.log([part.size / group.size for part in parts])
        turned = logs[:, 0] > logs[:, 1]
        odds = np.exp(-np.abs(logs[:, 0] - logs[:, 1]))
        share = odds / (1.0 + odds)
        # What either could have sent costs no saying of who did.
        entropy = float(-(share * np.log(share + 1e-12) + (1.0 - share) * np.log1p(-share)).sum())
        if np.mean(turned != first) < 0.01:
            break
        first = turned
    parts = [group[first], group[~first]]
    return (parts, entropy) if min(part.size for part in parts) >= FEWEST_PACKETS else None


def _packet_logs(
    packets: Packets, group: IntArray, part: IntArray, radio: Radio, ground: Ground
) -> FloatArray:
    """(packets of the group,) log density of each under a source placed by `part`, its shadowing learnt there too."""
    source = packets.of(part)
    found = locate(source, radio, ground, roughly=True)
    draw = radio.draws(1)[0][0]
    best = found.posterior.likeliest
    at = np.append(found.posterior.points_m[best], radio.source_up_m)
    coefficients = found.posterior.coefficients[best]
    mine = np.flatnonzero(np.isin(packets.packet, group))
    least = min_range_m(np.sqrt(((source.place_m - at) ** 2).sum(axis=1)))
    off = packets.level_db[mine] - design(packets.place_m[mine], at, least) @ coefficients
    own = source.level_db - design(source.place_m, at, least) @ coefficients
    expected, variance = _shadow(
        packets.place_m[mine], source.place_m, own, draw.place_var, draw.time_var, draw.correlation_m
    )
    logs = -0.5 * (off - expected) ** 2 / variance - 0.5 * np.log(2.0 * np.pi * variance)
    number = np.full(packets.count, -1)
    number[group] = np.arange(group.size)
    return np.asarray(np.bincount(number[packets.packet[mine]], logs, minlength=group.size), dtype=float)


def _shadow(
    at_m: FloatArray,
    known_m: FloatArray,
    known_db: FloatArray,
    place_var: float,
    time_var: float,
    length_m: float,
) -> tuple[FloatArray, FloatArray]:
    """Shadowing expected at places, and what remains unknown of a reading there, from residuals nearby.

    A weighted mean of what is within a correlation length stands for the exact conditioning: who sent what needs
    no more.
    """
    if place_var <= 0.0 or length_m <= 0.0:
        return np.zeros(at_m.shape[0]), np.full(at_m.shape[0], time_var + place_var)
    expected, variance = np.empty(at_m.shape[0]), np.empty(at_m.shape[0])
    for begin in range(0, at_m.shape[0], 256):
        apart = np.sqrt(((at_m[begin : begin + 256, None] - known_m[None]) ** 2).sum(axis=-1))
        weight = np.exp(-2.0 * apart / length_m)
        # A reading is no neighbour of its own.
        weight[apart < 1e-12] = 0.5
        total = weight.sum(axis=1)
        trust = total / (total + time_var / place_var)
        mean = (weight @ known_db) / np.maximum(total, 1e-9)
        expected[begin : begin + 256] = trust * mean
        variance[begin : begin + 256] = time_var + place_var * (1.0 - 0.8 * trust)
    return expected, variance


def _reunited(packets: Packets, groups: Sequence[IntArray], radio: Radio, ground: Ground) -> list[IntArray]:
    """Groups that one source explains as well put together again."""
    groups = list(groups)
    again = len(groups) > 1
    while again:
        again = False
        for i in range(len(groups)):
            for j in range(i + 1, len(groups)):
                both = np.sort(np.concatenate([groups[i], groups[j]]))
                for factor in WIDER[:2]:
                    together = _evidence(packets.of(both), radio, ground, factor)[0]
                    apart = sum(
                        _evidence(packets.of(each), radio, ground, factor)[0]
                        + each.size * math.log(each.size / both.size)
                        for each in (groups[i], groups[j])
                    )
                    if together + CLEARLY_NATS > apart:
                        groups = [each for k, each in enumerate(groups) if k not in (i, j)] + [both]
                        again = True
                        break
                if again:
                    break
            if again:
                break
    return groups
