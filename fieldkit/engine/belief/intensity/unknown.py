"""How well sources not yet known explain the open detections: computed once for as long as the exposure stays."""

from typing import TYPE_CHECKING

import numpy as np

from fieldkit.engine.belief.intensity import loops
from fieldkit.engine.belief.intensity.arena import starts
from fieldkit.messages import FloatArray

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture


def log_unknown_of(mixture: "Mixture", numbers: list[int]) -> FloatArray:
    """(k,) log intensity with which sources not yet known explain each of these open detections."""
    known = mixture.log_unknown
    if new := [number for number in numbers if number not in known]:
        stored = [mixture.open[number] for number in new]
        logs = np.empty(len(stored))
        loops.log_expected(
            mixture.open_arena.values,
            starts([each.like for each in stored]),
            np.array([each.box for each in stored], dtype=np.int64),
            mixture.model.n_known,
            mixture.unknown_rate(),
            logs,
        )
        known.update(
            (number, float(log) + each.log_scale) for number, log, each in zip(new, logs, stored, strict=True)
        )
    return np.array([known[number] for number in numbers])
