"""The path-loss law, in one place: what distance costs, how steeply, and how far that is.

Distances come in `decades`, the decimal logarithm of metres. Each function is plain arithmetic on numbers or arrays:
numpy callers run it as it stands, and `engine.likelihood.law_loops` compiles it for the loops (so none calls another:
compiled code calls compiled code alone). `law` holds the numbers of one antenna (`Antenna.law`).
"""

import math
from typing import NamedTuple, TypeVar

from fieldkit.messages import FloatArray

Number = TypeVar("Number", float, FloatArray)
_E_FOLDS = math.log(10.0)


class Law(NamedTuple):
    """The numbers of one antenna."""

    ten_beta: float
    """dB for each decade of distance."""
    least_range_m: float
    """Shorter ranges are clamped to this."""
    elevation: float
    """kappa of `engine.likelihood.ears`."""
    alike_within_m: float
    """Nearer than this azimuth does not count."""


def loss_db(decades: Number, law: Law) -> Number:
    """What is lost between 1 m and that distance (PRWA eq 3)."""
    lost: Number = law.ten_beta * decades
    return lost


def slope_db(decades: float | FloatArray, law: Law) -> float | FloatArray:
    """What is lost more for each part by which the distance grows: the derivative by its natural logarithm."""
    return law.ten_beta / _E_FOLDS


def decades_at(lost_db: Number, law: Law) -> Number:
    """At which distance so much is lost: the inverse of `loss_db`."""
    decades: Number = lost_db / law.ten_beta
    return decades


def as_far_m2(square_m2: Number, more_db: float, law: Law) -> Number:
    """The squared distance at which `more_db` more is lost than at `square_m2`."""
    further: Number = square_m2 * 10.0 ** (2.0 / law.ten_beta * more_db)
    return further
