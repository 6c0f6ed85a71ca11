"""Passes over the open detections: which to look at again, and what is done after them."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity import births
from fieldkit.engine.belief.intensity.candidate import Candidate
from fieldkit.engine.belief.intensity.nuisance import learnt_clutter
from fieldkit.engine.belief.intensity.responsibilities import Attribution, attribute
from fieldkit.engine.belief.intensity.unknown import log_unknown_of
from fieldkit.messages import FloatArray

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture

LITTLE_WORK = 10_000_000
"""Entries of all clouds times detections up to which every pass goes over everything."""
SHARE = 1e-3
"""A candidate that has less of a detection is not concerned by it."""


def sweep(
    mixture: "Mixture", sweeps: int, only: Iterable[int] | None = None, *, least_share: float = 0.0
) -> None:
    """Attribution of open detections, all or `only` these, by the predictions of the candidates and of the unknown.

    All but the last sweep look only at detections still in doubt or new. Who has less than `least_share` keeps it.
    """
    wanted = mixture.open if only is None else only
    numbers = [number for number in wanted if number not in mixture.named]
    mixture.unswept = least_share > 0.0 or len(numbers) < len(mixture.open) - len(mixture.named)
    log_unknown = log_unknown_of(mixture, numbers)
    more = learnt_clutter(mixture)
    log_clutter = np.array([mixture.open[number].log_clutter + more for number in numbers])
    left = Attribution(
        np.array([mixture.unclaimed[number] for number in numbers]),
        np.array([mixture.explained[number] for number in numbers]),
    )

    def mean_exposure_s() -> FloatArray:
        mixture.forget_summaries()
        return np.array([each.mean_exposure_s(each.posterior()) for each in mixture.candidates])

    attribute(
        mixture.arena,
        mixture.candidates,
        numbers,
        log_unknown,
        log_clutter,
        mean_exposure_s,
        mixture.tuning.rate_shape,
        mixture.rate_prior_s,
        left,
        passes=sweeps,
        least_share=least_share,
    )
    mixture.unclaimed.update(zip(numbers, left.unclaimed.tolist(), strict=True))
    mixture.explained.update(zip(numbers, left.explained.tolist(), strict=True))
    for candidate in mixture.candidates:
        candidate.prune()
        if births.is_coarse(mixture, candidate):
            births.refine(mixture, candidate)
            mixture.forget_summary(candidate)


def sweep_again(mixture: "Mixture", numbers: Iterable[int]) -> None:
    """Look again at those detections, among those that have a share of them; at all of them where that is little work.

    Seen later, finds that had moved were called silent later: seven false finds instead of none in twenty missions.
    """
    entries = sum(candidate.log_prior.size for candidate in mixture.candidates)
    if entries * len(mixture.open) <= LITTLE_WORK:
        sweep(mixture, mixture.tuning.sweeps)
        return
    sweep(mixture, mixture.tuning.sweeps, numbers, least_share=SHARE)


def shares_of(candidate: Candidate) -> list[int]:
    """Detections of which it has a share."""
    return [number for number, part in candidate.responsibility.items() if part > SHARE]


def concerned(mixture: "Mixture", new: list[int]) -> list[int]:
    """New detections, and those that may be seen otherwise since: of candidates that have a share of a new one.

    Most of what was heard in a large field has nothing to do with what comes in.
    """
    numbers = set(new)
    for candidate in mixture.candidates:
        if any(candidate.responsibility.get(number, 0.0) > SHARE for number in new):
            numbers.update(shares_of(candidate))
    return sorted(numbers.intersection(mixture.open))
