"""Who sent what: one pass over the open detections, each shared out among the candidates, the unknown and clutter.

The pass is compiled and runs in the order of the detections, each seeing what the ones before it changed (coordinate
ascent). A candidate's entries (power hypothesis by point) more than `ACTIVE_NATS` under its best one take no part.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fieldkit.engine import kernels
from fieldkit.engine.belief.candidate import RATE_SHAPE, Candidate, active_entries
from fieldkit.messages import FloatArray

MOVED = 1e-6
"""A share that changes by less stays as it is, and the evidence with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Shares:
    """What is left of each detection, in the order given; brought up to date by every pass."""

    unclaimed: FloatArray
    """(k,) probability that a source not yet known sent it."""
    explained: FloatArray
    """(k,) log of the intensity with which clutter and the candidates explain it."""


def share_out(
    candidates: list[Candidate],
    numbers: list[int],
    log_unknown: FloatArray,
    log_clutter: FloatArray,
    mean_exposure_s: Callable[[], FloatArray],
    rate_prior_s: float,
    left: Shares,
    *,
    passes: int,
) -> None:
    """Passes over detections `numbers` (k); `log_unknown` and `log_clutter` (k,).

    `mean_exposure_s` gives (candidates,) as it is before each pass. All passes but the last leave alone what one
    candidate claims beyond doubt.
    """
    k, c = len(numbers), len(candidates)
    rows = np.zeros((k, c), dtype=np.int64)
    share = np.zeros((k, c))
    for column, candidate in enumerate(candidates):
        for index, number in enumerate(numbers):
            log_like = candidate.logs.get(number)
            if log_like is not None:
                rows[index, column] = kernels.address(log_like)
                share[index, column] = candidate.share[number]
    for turn in range(passes):
        active, post, log_exposure = [np.empty(0, dtype=np.int64)], [np.empty(0)], [np.empty(0)]
        for candidate in candidates:
            log = candidate.log_posterior().ravel()
            keep = active_entries(log)
            active.append(keep)
            post.append(log[keep])
            log_exposure.append(candidate.log_exposure.ravel()[keep])
        before = share.copy()
        kernels.share_out(
            rows,
            share,
            np.concatenate(active),
            np.cumsum([keep.size for keep in active]),
            np.concatenate(post),
            np.concatenate(log_exposure),
            np.array([candidate.receptions for candidate in candidates]),
            mean_exposure_s(),
            RATE_SHAPE,
            rate_prior_s,
            log_unknown,
            log_clutter,
            turn < passes - 1,
            left.unclaimed,
            left.explained,
        )
        moved = np.abs(share - before) > MOVED
        for index, column in np.argwhere(moved):
            candidates[column].set_share(numbers[index], float(share[index, column]))
        share = np.where(moved, share, before)
