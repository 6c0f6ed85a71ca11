"""What numbers of receptions are worth where shadows belong to places: those of one place share a chance.

Without place noise every reception counts whole.
"""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity.candidate import Candidate
from fieldkit.engine.likelihood.places import redundancy
from fieldkit.messages import FloatArray

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture


def trust(mixture: "Mixture", candidate: Candidate, claimed: Iterable[int]) -> None:
    """Have a candidate's number of receptions say as much as the mean share of `claimed` detections.

    It holds from when the candidate is next exposed.
    """
    share = _share(mixture, list(claimed))
    if share.size:
        candidate.rate_trust = float(share.mean())


def settle(mixture: "Mixture", candidate: Candidate) -> None:
    """Bring a candidate up to date with what it claims by now."""
    mixture.condition_on_each_other(candidate)
    trust(mixture, candidate, mixture.claimed_by(candidate))
    candidate.expose(candidate.exposure_s)


def _share(mixture: "Mixture", numbers: list[int]) -> FloatArray:
    """(k,) of detections of one source; 1 of each that stands alone."""
    spread = mixture.settings.spread
    if mixture.places is None or spread is None:
        return np.ones(len(numbers))
    return redundancy([mixture.open[number].near_m for number in numbers], spread)
