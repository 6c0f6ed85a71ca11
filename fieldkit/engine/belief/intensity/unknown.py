"""Sources not yet known: how well they explain what was heard, and how many of them there may be where."""

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter

from fieldkit.engine.belief.intensity import loops
from fieldkit.engine.belief.intensity.arena import starts
from fieldkit.messages import FloatArray

if TYPE_CHECKING:
    from fieldkit.engine.belief.intensity.mixture import Mixture


CERTAIN = 1e6
"""Odds of so much are as good as any: sums over ground that has some of more would lose what has little."""


def log_unknown_of(mixture: "Mixture", numbers: list[int]) -> FloatArray:
    """(k,) log intensity with which sources not yet known explain each of these open detections.

    It is computed once for as long as the exposure stays.
    """
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


def another_source(mixture: "Mixture", rate_hz: float | None = None) -> FloatArray:
    """(known levels, n_north, n_east) of the ground: odds of one more source of this rate, against none.

    Prior times likelihood ratio: silence lowers it, detections that the candidates explain badly raise it. So
    it covers unsearched ground, unclaimed detections, and sources that hide behind a found neighbour.
    """
    rate_hz = rate_hz or mixture.settings.reference_rate_hz
    ratio = np.empty((mixture.model.n_known, *mixture.grid.shape))
    numbers = [number for number in mixture.open if number not in mixture.named]
    stored = [mixture.open[number] for number in numbers]
    scale = np.array([s.log_scale for s in stored]) - np.array([mixture.explained[k] for k in numbers])
    loops.another_source_llr(
        mixture.open_arena.values,
        starts([s.like for s in stored]),
        np.array([s.box for s in stored], dtype=np.int64).reshape(-1, 4),
        rate_hz * np.exp(scale),
        mixture.known_exposure_s(),
        rate_hz,
        ratio,
    )
    return np.asarray(_prior(mixture) * np.exp(np.minimum(ratio, 50.0)))


def expected_unknown(mixture: "Mixture", rate_hz: float | None = None) -> FloatArray:
    """(n_north, n_east) of the ground: expected number of sources of this rate that are not among the candidates.

    With place noise the odds that detections speak for are those of one source: what a shadow does to the readings of
    a known one lets dozens seem likely beside it, each for the same readings. So whatever is to be had from detections
    within hearing comes to one at the most.
    """
    odds: FloatArray = another_source(mixture, rate_hz).sum(axis=0)
    if mixture.places is None:
        return odds
    rate_hz = rate_hz or mixture.settings.reference_rate_hz
    unheard: FloatArray = (_prior(mixture) * np.exp(-rate_hz * mixture.known_exposure_s())).sum(axis=0)
    heard = np.clip(odds - unheard, 0.0, CERTAIN)
    width = 2 * int(np.ceil(mixture.model.reach_m / mixture.grid.cell_m)) + 1
    nearby = uniform_filter(heard, size=width, mode="constant") * width**2
    return np.asarray(unheard + heard / (1.0 + np.maximum(nearby, heard)))


def _prior(mixture: "Mixture") -> float:
    """Expected number of sources of one known level in a cell of the ground."""
    expected: float = (
        mixture.settings.expected_sources * mixture.ground.sources_a_cell / mixture.model.n_known
    )
    return expected
