"""Who sent what: one pass over the open detections, each attributed among the candidates, the unknown and clutter.

The pass is compiled and runs in the order of the detections, each seeing what the ones before it changed (coordinate
ascent). A candidate's entries (power hypothesis by point) more than `ACTIVE_NATS` under its best one take no part.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fieldkit.engine.belief.intensity import loops
from fieldkit.engine.belief.intensity.arena import UNKNOWN, Arena, starts_table
from fieldkit.engine.belief.intensity.candidate import Candidate, active_entries
from fieldkit.messages import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Attribution:
    """What is left of each detection, in the order given; brought up to date by every pass."""

    unclaimed: FloatArray
    """(k,) probability that a source not yet known sent it."""
    explained: FloatArray
    """(k,) log of the intensity with which clutter and the candidates explain it."""


def attribute(
    arena: Arena,
    candidates: list[Candidate],
    numbers: list[int],
    log_unknown: FloatArray,
    log_clutter: FloatArray,
    mean_exposure_s: Callable[[], FloatArray],
    rate_shape: float,
    rate_prior_s: float,
    left: Attribution,
    *,
    passes: int,
    least_share: float = 0.0,
) -> None:
    """Passes over detections `numbers` (k) of candidates that keep what they know in `arena`.

    `log_unknown` and `log_clutter` (k,).
    `mean_exposure_s` gives (candidates,) as it is before each pass. All passes but the last leave alone what one
    candidate claims beyond doubt. Who has less than `least_share` of a detection keeps it.
    """
    rows, responsibility = known_responsibilities(candidates, numbers)
    little = (rows >= 0) & (responsibility < least_share)
    rows[little] = UNKNOWN
    whole = 1.0 - np.where(little, responsibility, 0.0).sum(axis=1)
    for turn in range(passes):
        active, start, post, log_exposure = entries_that_count(candidates)
        before = responsibility.copy()
        loops.attribute(
            arena.values,
            rows,
            responsibility,
            whole,
            active,
            start,
            post,
            log_exposure,
            np.array([candidate.receptions for candidate in candidates]),
            mean_exposure_s(),
            rate_shape,
            rate_prior_s,
            log_unknown,
            log_clutter,
            turn < passes - 1,
            left.unclaimed,
            left.explained,
        )
        responsibility = claim_what_moved(candidates, numbers, before, responsibility)


def known_responsibilities(
    candidates: list[Candidate], numbers: list[int]
) -> tuple[NDArray[np.int64], FloatArray]:
    """(k, c) where log-likelihoods begin, negative where a candidate knows none; (k, c) responsibilities."""
    shape = (len(candidates), len(numbers))
    rows = [[candidate.logs.get(number) for number in numbers] for candidate in candidates]
    responsibility = [
        [candidate.responsibility.get(number, 0.0) for number in numbers] for candidate in candidates
    ]
    return (
        starts_table(rows, len(numbers)),
        np.ascontiguousarray(np.array(responsibility, dtype=float).reshape(shape).T),
    )


def entries_that_count(
    candidates: list[Candidate],
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray]:
    """The active entries of all candidates, one after another, where each one's begin; log posterior and exposure."""
    active, post, log_exposure = [np.empty(0, dtype=np.int64)], [np.empty(0)], [np.empty(0)]
    for candidate in candidates:
        log = candidate.log_posterior().ravel()
        keep = active_entries(log)
        active.append(keep)
        post.append(log[keep])
        log_exposure.append(candidate.log_exposure.ravel()[keep])
    start = np.cumsum([keep.size for keep in active])
    return np.concatenate(active), start, np.concatenate(post), np.concatenate(log_exposure)


def claim_what_moved(
    candidates: list[Candidate], numbers: list[int], before: FloatArray, responsibility: FloatArray
) -> FloatArray:
    """Have the candidates claim `responsibility` (k, c) where it has moved; (k, c) as they claim now."""
    moved = np.abs(responsibility - before) > loops.MOVED
    for column, candidate in enumerate(candidates):
        changed = np.flatnonzero(moved[:, column])
        if changed.size:
            candidate.set_responsibilities(
                [numbers[index] for index in changed], responsibility[changed, column].tolist()
            )
    return np.where(moved, responsibility, before)
