"""From a whole log to sources: who sent what, where each is, and what may be said of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import UNKNOWN_POWER_DB, ChannelSpread, assumed
from fieldkit.engine.location.ground import Ground, Posterior
from fieldkit.engine.location.one_source import Located, OneSource, Radio, Silence, locate
from fieldkit.engine.location.several import Packets, separate
from fieldkit.messages import IntArray, SourceEstimate

if TYPE_CHECKING:
    from fieldkit.engine.association.packets import PacketLog

FEWEST_RECEPTIONS = 3
FEWEST_PLACES = 3
MISFIT = 2.5
"""Mean squared standardised residual one step ahead above which the channel model does not explain the readings."""
NEAREST_FIND_M = 2.0
RANGE_SHARE = 0.1
MOST_SILENT = 250
OFFSET_TOLD_DB = 2.0
"""A common offset beyond so many of its own deviations is reported."""


@dataclass(frozen=True, slots=True)
class Rules:
    """What counts as found."""

    found_within_m: float
    found_probability: float
    identity: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """One source: the estimate, and its posterior over the ground."""

    estimate: SourceEstimate
    posterior: Posterior
    name: str
    fit: float
    places: int


def radio_of(
    antenna: Antenna,
    spread: ChannelSpread | None,
    *,
    power_levels_db: tuple[float, ...] = (),
    power_sd_db: float | None = None,
    source_up_m: float = 0.0,
    place_sigma_m: float = 0.0,
) -> Radio:
    """What is known of the channel; a power nobody knows is unknown, unless transmitters were compared."""
    chosen = spread or assumed(antenna)
    if power_levels_db:
        # Known levels are exact but for what differs between transmitters of one setting.
        chosen = replace(chosen, transmitter_db=min(chosen.transmitter_db, 3.0))
    elif power_sd_db is None and chosen.transmitters < 2:
        chosen = replace(chosen, transmitter_db=max(chosen.transmitter_db, UNKNOWN_POWER_DB))
    return Radio(antenna, chosen, power_sd_db or 0.0, power_levels_db, source_up_m, place_sigma_m)


def found_within_m(antenna: Antenna, ground: Ground) -> float:
    """2 m or a tenth of the typical range, whichever is larger; the range no longer than half the ground."""
    across_m = max(ground[2] - ground[0], ground[3] - ground[1])
    return max(NEAREST_FIND_M, RANGE_SHARE * min(float(antenna.nominal_range_m()), 0.5 * across_m))


def evidence(packets: Packets, radio: Radio, ground: Ground) -> float:
    """log evidence that one source sent all."""
    return locate(packets.of(np.arange(packets.count)), radio, ground, roughly=True).posterior.log_evidence


def sources_of(
    log: "PacketLog",
    radio: Radio,
    ground: Ground,
    rules: Rules,
    progress: Callable[[float], None] = lambda _: None,
) -> list[Found]:
    """Sources, those with most receptions first."""
    if log.packets.count == 0:
        return []
    if rules.identity:
        groups = [(name, _of_name(log, name)) for name in sorted(set(log.names))]
        groups.sort(key=lambda each: -each[1].size)
    else:
        groups = [
            ("", each) for each in separate(log.packets, radio, ground, lambda share: progress(0.6 * share))
        ]
    found = []
    for number, (name, group) in enumerate(groups):
        source = with_silence(log, group, radio)
        found.append(
            _judged(number + 1, name, group, source, locate(source, radio, ground), radio, rules, log)
        )
        progress(0.6 + 0.4 * (number + 1) / len(groups))
    return found


def _of_name(log: "PacketLog", name: str) -> IntArray:
    return np.array([k for k, each in enumerate(log.names) if each == name], dtype=np.int64)


def with_silence(log: "PacketLog", group: IntArray, radio: Radio) -> OneSource:
    """What was heard of a source, and the places where it was not: of the size of the correlation length."""
    source = log.packets.of(group)
    listened = log.listened
    if listened.duration_s.size == 0:
        return source
    size_m = max(radio.spread.correlation_m, float(radio.antenna.nominal_range_m()) / 20.0, 0.1)
    while True:
        key = np.floor(listened.place_m / size_m).astype(np.int64)
        _, inverse = np.unique(key, axis=0, return_inverse=True)
        inverse = inverse.ravel()
        if inverse.max() < MOST_SILENT:
            break
        size_m *= 1.3
    spent = np.asarray(np.bincount(inverse, listened.duration_s), dtype=float)
    middle = np.column_stack(
        [np.bincount(inverse, listened.place_m[:, axis]) / np.bincount(inverse) for axis in range(3)]
    )
    code = {tuple(cell): number for cell, number in zip(key.tolist(), inverse.tolist(), strict=True)}
    cells = np.floor(source.place_m / size_m).astype(np.int64).tolist()
    where = np.array([code.get(tuple(cell), -1) for cell in cells], dtype=np.int64)
    known = where >= 0
    count = np.bincount(where[known], minlength=spent.size).astype(float)
    level = np.bincount(where[known], source.level_db[known], minlength=spent.size) / np.maximum(count, 1.0)
    heard = count > 0.0
    listening_s = float(spent[heard].sum())
    rate_hz = group.size / listening_s if listening_s > 0.0 else 0.0
    return OneSource(
        source.place_m,
        source.level_db,
        Silence(middle[~heard], spent[~heard]),
        rate_hz,
        Silence(middle[heard], spent[heard]),
        level[heard],
        count[heard],
    )


def _judged(
    ident: int,
    name: str,
    group: IntArray,
    source: OneSource,
    located: Located,
    radio: Radio,
    rules: Rules,
    log: "PacketLog",
) -> Found:
    posterior = located.posterior
    centre = posterior.centre_m()
    here = posterior.within(centre, rules.found_within_m)
    notes = []
    explained = located.places < 5 or located.fit <= MISFIT
    enough = group.size >= FEWEST_RECEPTIONS and located.places >= FEWEST_PLACES
    placed = enough and here >= rules.found_probability
    if not explained:
        notes.append(
            f"the model does not explain these readings: residuals are {np.sqrt(located.fit):.1f} times as wide as "
            f"the calibration says ({located.places} places)"
        )
    spread_db = float(np.sqrt(radio.draws(1)[0][0].covariance[0, 0]))
    if not radio.power_levels_db and abs(located.power_db) > OFFSET_TOLD_DB * spread_db:
        notes.append(f"its readings are {located.power_db:+.0f} dB against the calibrated transmitter's")
    covered = np.concatenate([log.packets.place_m, log.listened.place_m])[:, :2]
    if (centre < covered.min(axis=0)).any() or (centre > covered.max(axis=0)).any():
        notes.append("outside the ground that was covered")
    listening_s = max(float(log.listened.duration_s.sum()), 1e-9)
    estimate = SourceEstimate(
        ident=ident,
        east_m=float(centre[0]),
        north_m=float(centre[1]),
        cov_m2=_about(posterior, centre),
        region_90=int(posterior.region(0.9).size),
        receptions=float(group.size),
        rate_hz=source.rate_hz or group.size / listening_s,
        p_exists=1.0 - float(np.exp(-group.size)),
        p_here=here,
        state=("found" if explained else "inconsistent")
        if placed
        else ("candidate" if explained else "inconsistent"),
        note="; ".join(notes),
        power_db=located.power_db,
    )
    return Found(estimate, posterior, name, located.fit, located.places)


def _about(posterior: Posterior, centre_m: np.ndarray) -> np.ndarray:
    """(2, 2) second moments about the place that is named."""
    offset = posterior.mean_m - centre_m
    return np.asarray(posterior.cov_m2 + np.outer(offset, offset))
