"""Received power against distance, and against heading where the receiver's antenna is directional."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fieldkit.channel import law
from fieldkit.messages import FloatArray

MIN_RANGE_M = 0.05
"""The model has no near field: shorter ranges are clamped to this."""


@dataclass(frozen=True, slots=True)
class Antenna:
    """A radio pair as calibrated: log-distance loss, Gaussian noise in dB, integer readings, a threshold.

    A reading is the nearest integer to a normal deviate of mean `mean_rss_dbm` and deviation `sigma_db`.
    It is received if and only if that integer exceeds `threshold_dbm`, and reported as at most
    `saturation_dbm` (PRWA eq 3 and 4, with the resolution that hearing depends on the reading, not on its mean).
    """

    path_loss_exponent: float
    """beta: 2 in free space, 1.5 to 4 near the ground."""
    power_at_1m_dbm: float
    """Mean received power at 1 m from the transmitter the calibration used, at its setting then."""
    sigma_db: float
    threshold_dbm: float
    """zeta: the strongest integer reading that is NOT received."""
    saturation_dbm: float | None = None
    """The receiver reports no more than this; None where it was never reached."""
    pattern_db: tuple[float, ...] = ()
    """Gain at evenly spaced headings clockwise from the antenna's front; empty: the same all round."""
    alike_within_m: float = 0.0
    """Nearer than this a directional antenna hears the same all round (RWA eq 6, d_a)."""

    @property
    def law(self) -> law.Law:
        """Its numbers; what elevation costs is no property of the antenna."""
        return law.Law(float(10.0 * self.path_loss_exponent), MIN_RANGE_M, 0.0, float(self.alike_within_m))

    def loss_db(self, range_m: ArrayLike) -> FloatArray:
        """By how much less is read at `range_m` than at 1 m."""
        return law.loss_db(_decades(range_m), self.law)

    def slope_db(self, range_m: ArrayLike) -> FloatArray:
        """By how much less is read there for each part by which the range grows."""
        return np.asarray(law.slope_db(_decades(range_m), self.law))

    def mean_rss_dbm(self, range_m: ArrayLike, power_db: ArrayLike = 0.0) -> FloatArray:
        """Mean reading at `range_m` from a source `power_db` above the calibrated transmitter."""
        result: FloatArray = self.power_at_1m_dbm + np.asarray(power_db, dtype=float) - self.loss_db(range_m)
        return result

    def gain_db(self, off_front_deg: ArrayLike, range_m: ArrayLike = np.inf) -> FloatArray:
        """Gain towards `off_front_deg`, clockwise from the antenna's front; 0 all round without a pattern."""
        off = np.asarray(off_front_deg, dtype=float)
        if not self.pattern_db:
            return np.zeros(np.broadcast_shapes(off.shape, np.shape(range_m)))
        at = np.arange(len(self.pattern_db)) * 360.0 / len(self.pattern_db)
        gain = np.interp(off, at, self.pattern_db, period=360.0)
        return np.where(np.asarray(range_m, dtype=float) <= self.alike_within_m, max(self.pattern_db), gain)

    def nominal_range_m(self, power_db: ArrayLike = 0.0) -> FloatArray:
        """Range at which the mean reading falls to the threshold: about half the packets are heard there."""
        margin_db = self.power_at_1m_dbm + np.asarray(power_db, dtype=float) - self.threshold_dbm
        result: FloatArray = np.power(10.0, law.decades_at(margin_db, self.law))
        return result


def _decades(range_m: ArrayLike) -> FloatArray:
    return np.asarray(np.log10(np.maximum(np.asarray(range_m, dtype=float), MIN_RANGE_M)))
