"""Gain by heading: the shapes of the papers' directional antennas, and any shape as a table.

Headings are degrees clockwise from the antenna's front, scalars or arrays of any shape; gains are in dB.
"""

import numpy as np
from numpy.typing import ArrayLike

from fieldkit.messages import FloatArray

_FAINT = 1e-6


def lobe_gain_db(
    heading_deg: ArrayLike, front_deg: float, narrowness: float, floor_db: float, offset_db: float = 0.0
) -> FloatArray:
    """cos^2(narrowness * angle) within the lobe, never more than `floor_db` under its peak.

    RWA eq 5 and 6 (Song, Kim and Yi, IEEE T-RO 2012): narrowness 4, floor -20 log10 cos 80 degrees = 15.2 dB.
    Their d_a, within which the antenna hears the same all round, is left to the sensing model.
    """
    angle = np.radians(_turned(heading_deg, front_deg)) * narrowness
    level = 20.0 * np.log10(np.maximum(np.cos(np.clip(angle, -np.pi / 2, np.pi / 2)), _FAINT))
    return np.maximum(level, -abs(floor_db)) + offset_db


def dipole_gain_db(
    heading_deg: ArrayLike,
    front_deg: float,
    front_to_back_db: float,
    floor_db: float,
    offset_db: float = 0.0,
) -> FloatArray:
    """A half-wave dipole's |cos| that is weaker behind: a log-periodic array at one frequency.

    Song, Kim and Yi, "Simultaneous localization of multiple unknown CSMA-based wireless sensor network
    nodes", eq 3: 1.4825 cos ahead and 1.0654 |cos| behind, so front to back 1.43 dB. The floor fills the
    nulls at the sides, which no real antenna has.
    """
    angle = np.radians(_turned(heading_deg, front_deg))
    level = 10.0 * np.log10(np.maximum(np.abs(np.cos(angle)), _FAINT))
    level = level - np.where(np.cos(angle) < 0.0, front_to_back_db, 0.0)
    return np.maximum(level, -abs(floor_db)) + offset_db


def table_db(heading_deg: ArrayLike, table_heading_deg: ArrayLike, table_value_db: ArrayLike) -> FloatArray:
    """A table (k,) over headings, linear in between and going on round the circle."""
    at, value = np.asarray(table_heading_deg, dtype=float), np.asarray(table_value_db, dtype=float)
    result: FloatArray = np.interp(np.asarray(heading_deg, dtype=float), at, value, period=360.0)
    return result


def _turned(heading_deg: ArrayLike, front_deg: float) -> FloatArray:
    """-180 to 180 from where the antenna points."""
    return (np.asarray(heading_deg, dtype=float) - front_deg + 180.0) % 360.0 - 180.0
