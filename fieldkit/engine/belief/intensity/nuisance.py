"""What the open detections say besides places: how many are nobody's, and how far positions may be off together."""

import math
from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity.candidate import Candidate

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture

SHARED_NS = 180_000_000_000
"""Positions err together for so long: three times the time in which such an error falls to 1/e.

Twice that time would do for readings that count alike. With it regions came out a sixth too narrow where positions
were off by 2 m and ranges 10 m: a few readings near the source count most.
"""


def learnt_clutter(mixture: "Mixture") -> float:
    """log of how much more clutter there is than was expected, by what neither a candidate nor the unknown claims.

    Gamma with the expected rate as its mean and one detection's weight; never less than was expected.
    """
    claimed = dict.fromkeys(mixture.open, 0.0)
    for candidate in mixture.candidates:
        for number, responsibility in candidate.responsibility.items():
            if number in claimed:
                claimed[number] += responsibility
    count = mixture.clutter_frozen + math.fsum(
        max(0.0, 1.0 - mixture.unclaimed[number] - responsibility)
        for number, responsibility in claimed.items()
    )
    prior_s = 1.0 / mixture.tuning.clutter_hz
    listened_s = max(0.0, (mixture.now_ns - mixture.since_ns) * 1e-9) if mixture.since_ns is not None else 0.0
    learnt_hz = (1.0 + count) / (prior_s + listened_s)
    return max(0.0, math.log(learnt_hz / mixture.tuning.clutter_hz))


def shared_sigma_m(mixture: "Mixture", candidate: Candidate) -> float:
    """How far the positions it was heard from may be off together.

    Errors of satellites last about a minute: readings nearer in time have one in common. Readings made nearer to
    the source say more of its place, by the Fisher information of a distance: a few of them may be all that counts.
    """
    own = [
        mixture.open[number]
        for number, responsibility in candidate.responsibility.items()
        if responsibility >= mixture.tuning.claimed and number in mixture.open
    ]
    if not own:
        return mixture.settings.pose_sigma_m
    sigma_m = max(mixture.settings.pose_sigma_m, float(np.mean([each.sigma_m for each in own])))
    middle = candidate.points_m[int(candidate.log_posterior().max(axis=0).argmax())]
    near_m = np.concatenate([each.near_m for each in own])
    first = np.cumsum([0, *(len(each.near_m) for each in own[:-1])])
    away2 = np.minimum.reduceat(((near_m - middle) ** 2).sum(axis=1), first)
    blocks = np.array([each.detection.t_ns for each in own], dtype=np.int64) // SHARED_NS
    _, which = np.unique(blocks, return_inverse=True)
    information = np.bincount(which, weights=1.0 / (away2 + sigma_m**2 + mixture.field.cell_m**2))
    return float(sigma_m * np.sqrt((information**2).sum()) / information.sum())
