"""What it means that a source is no longer heard: gone silent, or moved.

With a rate known as Gamma(a + n, b + E) from n receptions in exposure E, nothing is heard in further exposure S with
probability ((b + E) / (b + E + S))^(a + n). Exposure counts only where somebody would have heard it.
"""

from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity.candidate import Candidate

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture

ALIKE_DB = 6.0
"""Sources whose powers are further apart are two."""


def listened_s(mixture: "Mixture", candidate: Candidate) -> float:
    """How long a source of its power at its place has been listened to."""
    summary = mixture.summary(candidate)
    row, column = mixture.grid.cell_of(*summary.mean_m.tolist())
    by_power = candidate.posterior().sum(axis=1)[:-1]
    return float(by_power @ mixture.exposure_s[:, row, column] / max(float(by_power.sum()), 1e-12))


def note_heard(mixture: "Mixture", candidate: Candidate) -> None:
    """Keep when the first and the last of what it claims was sent, and how long it had been listened to by then."""
    sent = [
        mixture.open[number].detection.t_ns
        for number, responsibility in candidate.responsibility.items()
        if responsibility >= mixture.tuning.claimed and number in mixture.open
    ]
    if not sent:
        return
    candidate.first_ns = min(sent) if candidate.first_ns is None else min(candidate.first_ns, *sent)
    if max(sent) > candidate.last_ns or candidate.exposure_then_s == 0.0:
        candidate.last_ns = max(sent)
        candidate.exposure_then_s = listened_s(mixture, candidate)


def silence_odds(mixture: "Mixture", candidate: Candidate) -> float:
    """P(nothing heard of it since it was last heard), had it gone on as before."""
    if candidate.first_ns is None:
        return 1.0
    since_s = max(0.0, listened_s(mixture, candidate) - candidate.exposure_then_s)
    before_s = mixture.rate_prior_s + candidate.exposure_then_s
    odds = (before_s / (before_s + since_s)) ** (mixture.tuning.rate_shape + candidate.receptions)
    return float(odds)


def words(mixture: "Mixture", candidate: Candidate, now_ns: int, odds: float) -> str:
    """What to say of a source that has gone silent, and where it may have moved."""
    since_s = (now_ns - candidate.last_ns) * 1e-9
    said = (
        f"gone silent: last heard {since_s:.0f} s ago, which would happen by chance with {100.0 * odds:.1g} %"
    )
    after = moved_to(mixture, candidate)
    if after is None:
        return said
    east, north = mixture.summary(after).mean_m
    return f"{said}; may have moved: source {after.ident} at {east:.1f}, {north:.1f} m has been heard since"


def moved_to(mixture: "Mixture", candidate: Candidate) -> Candidate | None:
    """A source of about the same power that was first heard after this one was last heard; the nearest."""
    here = mixture.summary(candidate)
    later = [
        other
        for other in mixture.candidates
        if other.first_ns is not None
        and other.first_ns > candidate.last_ns
        and abs(mixture.summary(other).power_db - here.power_db) <= ALIKE_DB
        and other.receptions >= 1.5
    ]
    return min(
        later,
        key=lambda each: float(np.hypot(*(mixture.summary(each).mean_m - here.mean_m))),
        default=None,
    )
