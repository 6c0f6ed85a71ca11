"""A bearing from one turn on the spot: a body, or an antenna held in front, lets less through from behind.

The level is taken as a + b cos(heading - bearing): the first harmonic of any such loss. The turn is believed only where
that harmonic stands out of the scatter, by an F test.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

FEWEST = 8
WIDEST_GAP_DEG = 90.0
"""A turn with a larger gap between headings was none."""
WORST_DEG = 60.0
NOT_BY_CHANCE = 0.01
ONE_SIDED = 0.97
"""0.95 would hold 90 % of all turns, but 86 % of those that look clear, because their scatter came out small."""


@dataclass(frozen=True, slots=True)
class Bearing:
    """What a turn says; `why` is empty where the bearing is clear."""

    bearing_deg: float
    error_90_deg: float
    """It is off by no more with 90 %."""
    swing_db: float
    """Between front and back."""
    why: str


def bearing_of(heading_deg: Sequence[float], rss_dbm: Sequence[float]) -> Bearing:
    """The bearing (deg from true north) of one transmitter by readings (n,) at headings (n,) of one turn."""
    heading, level = np.radians(np.asarray(heading_deg, dtype=float)), np.asarray(rss_dbm, dtype=float)
    nothing = Bearing(math.nan, math.nan, 0.0, "")
    if len(level) < FEWEST:
        return _because(nothing, f"heard {len(level)} times in the turn; it takes {FEWEST}")
    around = np.sort(np.degrees(heading) % 360.0)
    gap_deg = float(np.max(np.diff(np.append(around, around[0] + 360.0))))
    if gap_deg > WIDEST_GAP_DEG:
        return _because(
            nothing, f"no whole turn: nothing was heard over {gap_deg:.0f} degrees, or no compass turned"
        )
    design = np.stack([np.ones_like(heading), np.cos(heading), np.sin(heading)], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    mean, north, east = inverse @ design.T @ level
    off = level - design @ np.array([mean, north, east])
    freedom = len(level) - 3
    variance = max(float(off @ off) / freedom, 1.0 / 12.0)  # readings are whole decibels
    size = math.hypot(north, east)
    across = np.array([-east, north]) / max(size, 1e-9)
    sigma = math.sqrt(variance * float(across @ inverse[1:, 1:] @ across)) if size else math.inf
    # Of a direction, not of its first-order error: the part across it is nothing within Student's t (Fieller, 1954).
    error_90_deg = math.degrees(
        math.asin(min(1.0, float(stdtrit(freedom, ONE_SIDED)) * sigma / max(size, 1e-9)))
    )
    found = Bearing(math.degrees(math.atan2(east, north)) % 360.0, error_90_deg, 2.0 * size, "")
    both = np.array([north, east])
    strength = float(both @ np.linalg.inv(inverse[1:, 1:]) @ both) / (2.0 * variance)
    # The tail of F with 2 and n degrees of freedom has a closed form.
    chance = (1.0 + 2.0 * strength / freedom) ** (-freedom / 2.0)
    if chance > NOT_BY_CHANCE or error_90_deg > WORST_DEG:
        return _because(
            found, f"no clear bearing: {2.0 * size:.0f} dB between front and back is within the scatter"
        )
    return found


def _because(bearing: Bearing, why: str) -> Bearing:
    return Bearing(bearing.bearing_deg, bearing.error_90_deg, bearing.swing_db, why)
