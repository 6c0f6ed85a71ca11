"""What it means that a source is no longer heard: gone silent, or moved.

With a rate known as Gamma(a + n, b + E) from n receptions in exposure E, nothing is heard in further exposure S with
probability ((b + E) / (b + E + S))^(a + n). Exposure counts only where somebody would have heard it.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity.candidate import Candidate

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture

ALIKE_DB = 6.0
"""Sources whose powers are further apart are two."""
WORTH_COUNTING = 0.05
"""Detections that a source has less probably sent are not counted for it."""
SURELY_GONE = 0.99
"""Only then others are taken to sleep as well."""
CERTAINLY = 1e-6
"""Odds at which nothing earlier is looked at."""


def listened_s(mixture: "Mixture", candidate: Candidate) -> float:
    """How long a source of its power at its place has been listened to."""
    summary = mixture.summary(candidate)
    row, column = mixture.grid.cell_of(*summary.mean_m.tolist())
    by_power = candidate.posterior().sum(axis=1)[:-1]
    return float(by_power @ mixture.exposure_s[:, row, column] / max(float(by_power.sum()), 1e-12))


def note_heard(mixture: "Mixture", candidate: Candidate) -> None:
    """Keep when the first and the last of what it claims was sent, and how long it had been listened to by then."""
    may_be_its = [n for n, r in candidate.responsibility.items() if r >= WORTH_COUNTING and n in mixture.open]
    new = [number for number in may_be_its if number not in candidate.listened_at]
    if new:
        candidate.listened_at.update(dict.fromkeys(new, listened_s(mixture, candidate)))
    claimed = [n for n in may_be_its if candidate.responsibility[n] >= mixture.tuning.claimed]
    if not claimed:
        return
    sent = {number: mixture.open[number].detection.t_ns for number in claimed}
    first, last = min(sent, key=sent.__getitem__), max(sent, key=sent.__getitem__)
    candidate.first_ns = sent[first] if candidate.first_ns is None else min(candidate.first_ns, sent[first])
    if sent[last] > candidate.last_ns or candidate.exposure_then_s == 0.0:
        candidate.last_ns, candidate.exposure_then_s = sent[last], candidate.listened_at[last]


@dataclass(frozen=True, slots=True)
class Silence:
    """Since when a source is silent, if it is."""

    since_ns: int
    """The last detection that it surely sent."""
    odds: float
    """P(as little heard since then) had it gone on as before."""


def silence(mixture: "Mixture", candidate: Candidate) -> Silence:
    """The least probable silence up to now.

    A detection that others explain about as well does not end a silence: going back beyond one that it sent with
    probability r makes its having gone on 1 / (1 - r) times as probable.
    """
    if candidate.first_ns is None:
        return Silence(candidate.last_ns, 1.0)
    shape = mixture.tuning.rate_shape + candidate.receptions
    listened = listened_s(mixture, candidate)

    def odds(receptions_since: float, listened_then_s: float) -> float:
        before_s = mixture.rate_prior_s + listened_then_s
        since_s = max(0.0, listened - listened_then_s)
        return float((before_s / (before_s + since_s)) ** max(shape - receptions_since, 0.0))

    may_be_its = sorted(
        (
            (mixture.open[number].detection.t_ns, candidate.responsibility[number], then_s)
            for number, then_s in candidate.listened_at.items()
            if number in mixture.open and candidate.responsibility.get(number, 0.0) >= WORTH_COUNTING
        ),
        reverse=True,
    )
    in_favour, since, claims = 1.0, 0.0, []
    for t_ns, responsibility, then_s in may_be_its:
        if responsibility >= mixture.tuning.claimed:
            claims.append(Silence(t_ns, min(1.0, in_favour * odds(since, then_s))))
        in_favour /= 1.0 - min(responsibility, 1.0 - CERTAINLY)
        since += responsibility
        if in_favour > 1.0 / CERTAINLY:
            break
    if not claims:  # all that it sent are marginalised
        return Silence(candidate.last_ns, min(1.0, in_favour * odds(since, candidate.exposure_then_s)))
    return min(claims, key=lambda each: each.odds)


def expected_asleep(mixture: "Mixture", silent: Collection[int]) -> float:
    """How many sources nobody has heard because they sleep, where of those heard some have gone silent (by identity).

    Of as many as were expected at first, the share that is silent of those that are known. One that is heard from
    another place sleeps not; and of many that are listened to for long some are silent by chance for a while.
    """
    known = [each for each in mixture.candidates if is_known(mixture, each)]
    asleep = [
        candidate
        for candidate in known
        if candidate.ident in silent
        and gone_probability(mixture, candidate) >= SURELY_GONE
        and moved_to(mixture, candidate, silence(mixture, candidate).since_ns) is None
    ]
    return mixture.settings.expected_sources * len(asleep) / max(len(known), 1)


def gone_probability(mixture: "Mixture", candidate: Candidate, silent: Silence | None = None) -> float:
    """P(it has ended or was moved since it was last heard): such things happen now and then, and it is silent since.

    `silent`: its silence, where that has been worked out.
    """
    silent = silence(mixture, candidate) if silent is None else silent
    quiet_s = max(0.0, (mixture.now_ns - silent.since_ns) * 1e-9)
    stayed = float(np.exp(-quiet_s / mixture.stay_s))
    return (1.0 - stayed) / (1.0 - stayed + stayed * silent.odds)


def gone_silent(mixture: "Mixture") -> set[int]:
    """Of which sources (by identity) it is to be said that they have gone silent; from then on others go sooner.

    Of those whose silence is by chance too improbable, or which are more probably gone than there: the longer ago one
    was heard, the more often such things happen, and the shorter a silence tells of one.
    """
    tuning = mixture.tuning
    known = [(each, silence(mixture, each)) for each in mixture.candidates if is_known(mixture, each)]
    silent = {
        each.ident: its.since_ns
        for each, its in known
        if its.odds < tuning.silent_odds or gone_probability(mixture, each, its) >= tuning.surely_silent
    }
    mixture.stay_s = mean_stay_s(mixture, silent)
    return set(silent)


def mean_stay_s(mixture: "Mixture", silent: Mapping[int, int]) -> float:
    """How long a source stays on average, by those known so far: where one has gone, others go sooner.

    `silent`: since when a source (by identity) has been silent. Ends at a rate known as Gamma(1 + those that went,
    `change_s` + the time that all were there).
    """
    there_s = sum(
        silent.get(each.ident, mixture.now_ns) * 1e-9 - each.first_ns * 1e-9
        for each in mixture.candidates
        if each.first_ns is not None and is_known(mixture, each)
    )
    return (mixture.tuning.change_s + there_s) / (1.0 + len(silent))


def is_known(mixture: "Mixture", candidate: Candidate) -> bool:
    """Whether it was heard often enough to say that it is a source."""
    return candidate.receptions >= mixture.settings.min_receptions - 0.1


def words(mixture: "Mixture", candidate: Candidate, silent: Silence) -> str:
    """What to say of a source that has gone silent, and where it may have moved."""
    since_s = (mixture.now_ns - silent.since_ns) * 1e-9
    said = (
        f"gone silent: last heard {since_s:.0f} s ago, "
        f"which would happen by chance with {100.0 * silent.odds:.1g} %"
    )
    after = moved_to(mixture, candidate, silent.since_ns)
    if after is None:
        return said
    east, north = mixture.summary(after).mean_m
    return f"{said}; may have moved: source {after.ident} at {east:.1f}, {north:.1f} m has been heard since"


def moved_to(mixture: "Mixture", candidate: Candidate, since_ns: int) -> Candidate | None:
    """A source of about the same power that was first heard after this one was last heard; the nearest."""
    here = mixture.summary(candidate)
    later = [
        other
        for other in mixture.candidates
        if other.first_ns is not None
        and other.first_ns > since_ns
        and abs(mixture.summary(other).power_db - here.power_db) <= ALIKE_DB
        and other.receptions >= 1.5
    ]
    return min(
        later,
        key=lambda each: float(np.hypot(*(mixture.summary(each).mean_m - here.mean_m))),
        default=None,
    )
