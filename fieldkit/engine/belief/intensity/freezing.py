"""Which detections are closed for good when there are too many: of sources that have many."""

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture


FEWEST_OPEN = 20
"""So many detections are kept open, whatever they take."""


def freeze(mixture: "Mixture") -> None:
    """Close old detections beyond `max_open` or `kept_mb`: of sources that have many, so no rare one is forgotten."""
    while len(mixture.open) > mixture.tuning.max_open or (
        len(mixture.open) > FEWEST_OPEN and kept_bytes(mixture) > 1e6 * mixture.tuning.kept_mb
    ):
        number = _to_freeze(mixture)
        responsibility = math.fsum(
            candidate.responsibility.get(number, 0.0) for candidate in mixture.candidates
        )
        mixture.clutter_frozen += max(0.0, 1.0 - mixture.unclaimed[number] - responsibility)
        for candidate in mixture.candidates:
            candidate.forget(number)
        mixture.named.discard(number)
        mixture.log_unknown.pop(number, None)
        del mixture.open[number], mixture.unclaimed[number], mixture.explained[number]


def kept_bytes(mixture: "Mixture") -> int:
    """What the likelihoods of the open detections take, over the ground and of the candidates."""
    return (mixture.arena.held() + mixture.open_arena.held()) * mixture.arena.values.itemsize


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
