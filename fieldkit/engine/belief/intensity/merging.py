"""When two candidates are one: where that explains better what both sent."""

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity.candidate import Candidate, merged_gain
from fieldkit.engine.belief.intensity.shadowed import settle

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture

LITTLE = 0.05
"""Receptions that change nothing about whether two candidates are one."""


def merge(mixture: "Mixture") -> list[Candidate]:
    """Let one candidate speak for two where that explains better what both sent; those that do."""
    done = False
    speak: dict[int, Candidate] = {}
    while not done:
        done = True
        for first in mixture.candidates:
            for second in mixture.candidates:
                if first.ident >= second.ident or first.name or second.name:
                    continue
                close = _close(mixture, first, second)
                if not (close or _one_in_shadow(mixture, first, second)):
                    continue
                if not _may_be_one(mixture, first, second, close):
                    continue
                keep, drop = (first, second) if first.receptions >= second.receptions else (second, first)
                settled = partial(settle, mixture) if mixture.places is not None else None
                gain = merged_gain(keep, drop, settled)
                if gain == -np.inf:
                    keep, drop = drop, keep
                    gain = merged_gain(keep, drop, settled)
                if gain > 0.0:
                    for number, responsibility in drop.responsibility.items():
                        if number in keep.responsibility and responsibility > 0.0:
                            keep.set_responsibility(
                                number, min(1.0, keep.responsibility[number] + responsibility)
                            )
                    if drop.frozen_receptions > 0.0:
                        keep.take_in_frozen(drop)
                    keep.first_ns = min(
                        (t for t in (keep.first_ns, drop.first_ns) if t is not None), default=None
                    )
                    keep.listened_at = drop.listened_at | keep.listened_at
                    if drop.last_ns > keep.last_ns:
                        keep.last_ns, keep.exposure_then_s = drop.last_ns, drop.exposure_then_s
                    if (due := mixture.revise_at.get(drop.ident)) is not None:
                        # Two that were just made of one, and are one again: not to be divided again at once.
                        mixture.revise_at.setdefault(keep.ident, due)
                    mixture.remove(drop)
                    mixture.forget_summary(keep)
                    speak.pop(drop.ident, None)
                    speak[keep.ident] = keep
                    done = False
                    break
            if not done:
                break
    return list(speak.values())


def _one_in_shadow(mixture: "Mixture", first: Candidate, second: Candidate) -> bool:
    """Whether the smaller may be nothing but what shadows do to the larger, wherever it seems to be."""
    if mixture.places is None:
        return False
    small, large = sorted((first, second), key=lambda each: each.receptions)
    return all(
        number in large.logs
        for number, responsibility in small.responsibility.items()
        if responsibility > 0.02
    )


def _may_be_one(mixture: "Mixture", first: Candidate, second: Candidate, close: bool) -> bool:
    """Whether anything was heard of two neighbours since they were last found to be two; with place noise, enough.

    Conditioning all they claim on each other takes time. Two that have come close since are looked at all the same.
    """
    pair, heard = (first.ident, second.ident, close), first.receptions + second.receptions
    if mixture.places is not None:
        if heard < mixture.merge_at.get(pair, 0.0):
            return False
        mixture.merge_at[pair] = max(heard + 0.9, 1.1 * heard)
        return True
    if abs(heard - mixture.merge_at.get(pair, 0.0)) < LITTLE:
        return False
    mixture.merge_at[pair] = heard
    return True


def _close(mixture: "Mixture", first: Candidate, second: Candidate) -> bool:
    a, b = mixture.summary(first), mixture.summary(second)
    spread = np.sqrt(np.trace(a.cov_m2)) + np.sqrt(np.trace(b.cov_m2))
    result: bool = float(np.hypot(*(a.mean_m - b.mean_m))) < 3.0 * mixture.field.cell_m + 2.0 * spread
    return result
