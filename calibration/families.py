"""Families of radiation patterns: how gain depends on heading, what each fits with, where its search begins.

Orders stay low or are smoothed on purpose: a free high order oscillates between the headings that were sampled.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from fieldkit.channel.pattern import dipole_gain_db, lobe_gain_db
from fieldkit.messages import FloatArray

Family = Literal["circle", "ellipse", "lobe", "dipole", "fourier", "spline"]
FAMILIES: tuple[Family, ...] = ("circle", "ellipse", "lobe", "dipole", "fourier", "spline")
Gain = Callable[[FloatArray], FloatArray]
"""Heading (deg, any shape) to gain in dB."""
Basis = Callable[[FloatArray], FloatArray]
"""Heading (n,) to columns (n, k): a gain is linear in their weights."""

FOURIER_ORDERS = (1, 2, 3, 4)
SPLINE_KNOTS = 12
STIFFNESS_DB = (3.0, 10.0, 30.0, 100.0)
"""A spline's second derivative is expected to be about this large, in dB per square radian."""
SHAPE_OF: dict[str, Callable[..., FloatArray]] = {"lobe": lobe_gain_db, "dipole": dipole_gain_db}


def fourier(order: int) -> Basis:
    """Cosines and sines up to an order."""

    def basis(heading_deg: FloatArray) -> FloatArray:
        angle = np.radians(heading_deg)
        return np.stack([f(k * angle) for k in range(1, order + 1) for f in (np.cos, np.sin)], axis=-1)

    return basis


def spline(knots: int = SPLINE_KNOTS) -> Basis:
    """Periodic cubic splines through `knots` even headings, one fewer than knots: they sum to zero."""
    from scipy.interpolate import CubicSpline

    through = CubicSpline(
        np.linspace(0.0, 360.0, knots + 1), np.vstack([np.eye(knots), np.eye(knots)[:1]]), bc_type="periodic"
    )

    def basis(heading_deg: FloatArray) -> FloatArray:
        values = through(np.asarray(heading_deg) % 360.0)
        result: FloatArray = values[..., :-1] - values[..., -1:]
        return result

    return basis


def roughness(knots: int = SPLINE_KNOTS) -> FloatArray:
    """(knots - 1, knots - 1): w' R w is the mean square of a spline's second derivative, dB^2 per rad^4."""
    step_deg = 1.0
    at = np.arange(0.0, 360.0, step_deg)
    bend = np.diff(spline(knots)(np.concatenate([[-step_deg], at, [360.0]])), 2, axis=0)
    bend /= np.radians(step_deg) ** 2
    return np.asarray(bend.T @ bend / len(at))


def ellipse(exponent: float) -> Callable[[float, float], Gain]:
    """Range is an ellipse round the antenna: exp(log_ratio) times as far ahead as to the side."""

    def shape(log_ratio: float, front_deg: float) -> Gain:
        def gain(heading_deg: FloatArray) -> FloatArray:
            angle = np.radians(np.asarray(heading_deg) - front_deg)
            range2 = 1.0 / (np.cos(angle) ** 2 * np.exp(-2.0 * log_ratio) + np.sin(angle) ** 2)
            return np.asarray(5.0 * exponent * np.log10(range2))

        return gain

    return shape


def starts(family: Family) -> list[FloatArray]:
    """A coarse grid to search from, for the families that are not linear."""
    if family == "ellipse":
        return [np.array([ratio, front]) for ratio in (0.2, 0.6) for front in np.arange(0.0, 180.0, 22.5)]
    fronts = np.arange(0.0, 360.0, 22.5)
    if family == "dipole":
        return [np.array([f, ratio, floor]) for f in fronts for ratio in (1.4, 6.0) for floor in (8.0, 16.0)]
    return [
        np.array([f, narrow, floor]) for f in fronts for narrow in (0.7, 1.5, 3.0) for floor in (6.0, 14.0)
    ]
