"""Which detections are closed for good when there are too many: of sources that have many."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture


def freeze(mixture: "Mixture") -> None:
    """Close old detections beyond `max_open`: of sources that have many, so that no rare one is forgotten."""
    while len(mixture.open) > mixture.tuning.max_open:
        number = _to_freeze(mixture)
        responsibility = math.fsum(
            candidate.responsibility.get(number, 0.0) for candidate in mixture.candidates
        )
        mixture.clutter_frozen += max(0.0, 1.0 - mixture.unclaimed[number] - responsibility)
        for candidate in mixture.candidates:
            candidate.forget(number)
        mixture.named.discard(number)
        del mixture.open[number], mixture.unclaimed[number], mixture.explained[number]


def _to_freeze(mixture: "Mixture") -> int:
    """The oldest detection of whoever has most of the open ones, be that nobody."""
    owner = {
        number: max(mixture.candidates, key=lambda c: c.responsibility.get(number, 0.0), default=None)
        for number in mixture.open
    }
    of: dict[int, list[int]] = {}
    for number, candidate in owner.items():
        claimed = (
            candidate is not None and candidate.responsibility.get(number, 0.0) >= mixture.tuning.claimed
        )
        of.setdefault(candidate.ident if claimed and candidate is not None else 0, []).append(number)
    return max(of.values(), key=len)[0]
