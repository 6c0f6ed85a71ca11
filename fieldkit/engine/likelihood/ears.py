"""How faint a source is at a receiver: by 3-D distance, elevation and azimuth, and by the receiver's own radio.

A receiver in one moment is a row of numbers, an ear: where it was, how high above the sources, where its antenna's
front pointed, its own threshold, how unsure its place is, whose it is and how unsure what it reports too much. What is
known of that is taken off its readings once, when they come in, and off its threshold: what is left follows the law of
one calibrated radio.

    attenuation = 10 beta log10 d3 - kappa 20 log10 cos(elevation) - gain(azimuth - heading)

`kappa` is the antenna file's elevation law (`channel.spread`; 2 for two vertical dipoles), which no robot on the ground
of the sources feels; cos is no less than 0.1, since no real null is deeper.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from zlib import crc32

import numpy as np

from fieldkit.channel import law
from fieldkit.channel.antenna_file import Receiver
from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.engine.likelihood.ears_loops import (
    COLUMNS,
    EAST,
    HEADING,
    LEAST_COS,
    NORTH,
    OFFSET,
    ROBOT,
    SIGMA,
    THRESHOLD,
    UP,
)
from fieldkit.messages import Detection, FloatArray, Listening


@dataclass(frozen=True, slots=True)
class Ears:
    """What turns robots' poses into rows of numbers (m, `COLUMNS`)."""

    antenna: Antenna
    source_up_m: float = 0.0
    elevation: float = 0.0
    """kappa."""
    receivers: Mapping[str, Receiver] = field(default_factory=dict)
    """Robots whose radio is not like the calibrated one."""
    point_sigma_m: float = 0.05
    """Half a point of the belief's cloud, as a deviation."""
    pose_sigma_m: float = 0.0
    """Deviation of a position that states none, or a smaller one."""
    receiver_db: float = 0.0
    """Deviation of the offsets of receivers that are not `measured`."""
    measured: frozenset[str] = frozenset()

    @property
    def law(self) -> law.Law:
        """The antenna's numbers, with what elevation costs."""
        return self.antenna.law._replace(elevation=float(self.elevation))

    @property
    def pattern_db(self) -> FloatArray:
        """(k,) gain at evenly spaced headings from the front; empty: the same all round."""
        return np.array(self.antenna.pattern_db, dtype=float)

    @property
    def best_db(self) -> float:
        """By how much the best receiver, in its best direction, hears more than the calibrated radio all round."""
        more = [self.antenna.threshold_dbm - self._threshold_dbm(robot) for robot in self.receivers]
        rising = 20.0 * max(0.0, -self.elevation) * -np.log10(LEAST_COS)
        return max(0.0, *more, 0.0) + max(0.0, *self.antenna.pattern_db, 0.0) + float(rising)

    def _threshold_dbm(self, robot: str) -> float:
        """The robot's own threshold, on the scale of the calibrated radio."""
        radio = self.receivers.get(robot)
        if radio is None:
            return self.antenna.threshold_dbm
        own = self.antenna.threshold_dbm if radio.threshold_dbm is None else radio.threshold_dbm
        return own - radio.offset_db

    def of(
        self,
        robots: Sequence[str],
        position_m: FloatArray,
        up_m: FloatArray,
        heading_deg: FloatArray,
        sigma_m: FloatArray,
    ) -> FloatArray:
        """(m, `COLUMNS`); `up_m`, `heading_deg` and `sigma_m` (m,), or empty where nothing is known of them."""
        m = position_m.shape[0]
        ears = np.zeros((m, COLUMNS))
        ears[:, EAST : NORTH + 1] = position_m
        if up_m.size:
            ears[:, UP] = up_m - self.source_up_m
        if heading_deg.size:
            ears[:, HEADING] = np.radians(heading_deg)
        ears[:, THRESHOLD] = [self._threshold_dbm(robot) for robot in robots]
        deviation_m = (
            np.maximum(sigma_m, self.pose_sigma_m) if sigma_m.size else np.full(m, self.pose_sigma_m)
        )
        ears[:, SIGMA] = np.hypot(deviation_m, self.point_sigma_m)
        ears[:, ROBOT] = [crc32(robot.encode()) for robot in robots]
        ears[:, OFFSET] = [0.0 if robot in self.measured else self.receiver_db**2 for robot in robots]
        return ears

    def of_detection(self, detection: Detection) -> FloatArray:
        """(m, `COLUMNS`) of a detection's robots."""
        d = detection
        return self.of(d.robots, d.position_m, d.up_m, d.heading_deg, d.sigma_m)

    def of_listening(self, listening: Listening) -> FloatArray:
        """(m, `COLUMNS`) of those who listened."""
        each = listening
        return self.of(each.robots, each.position_m, each.up_m, each.heading_deg, each.sigma_m)

    def corrected(self, detection: Detection) -> Detection:
        """The detection as calibrated radios would have reported it."""
        if not self.receivers:
            return detection
        more = np.array([self.receivers.get(robot, Receiver()).offset_db for robot in detection.robots])
        return replace(detection, rss_dbm=detection.rss_dbm - more) if more.any() else detection

    def uncorrected(self, detection: Detection) -> Detection:
        """A corrected detection as the receivers reported it."""
        more = np.array([self.receivers.get(robot, Receiver()).offset_db for robot in detection.robots])
        return replace(detection, rss_dbm=detection.rss_dbm + more) if more.any() else detection

    def attenuation_db(self, points_m: FloatArray, ears: FloatArray) -> FloatArray:
        """(n, m) from points (n, 2) to ears (m, `COLUMNS`): as the loops have it."""
        way = points_m[:, None, :] - ears[None, :, EAST : NORTH + 1]
        flat2, up = (way**2).sum(axis=-1), ears[None, :, UP]
        d2 = np.maximum(flat2 + up**2, MIN_RANGE_M**2)
        loss = law.loss_db(0.5 * np.log10(d2), self.law)
        cos = np.where(up != 0.0, np.maximum(np.sqrt(flat2 / d2), LEAST_COS), 1.0)
        loss = loss - self.elevation * 20.0 * np.log10(cos)
        if self.antenna.pattern_db:
            off_deg = np.degrees(np.arctan2(way[..., 0], way[..., 1]) - ears[None, :, HEADING])
            loss = loss - self.antenna.gain_db(off_deg, np.sqrt(d2))
        return np.asarray(loss)
