"""Robots by two coloured patches, one ahead and one behind, distinguished from the ground by motion.

A colour alone is also grass, a jacket, a line on the ground: a patch counts if it moved against the learned
background, or lies where its robot was last believed to be (one that stands still sinks into the background).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.camera.seen import Seen
from drivers.camera.view import View
from fieldkit.errors import ConfigError
from fieldkit.messages import FloatArray

HUES = {"red": 0, "yellow": 30, "green": 60, "cyan": 90, "blue": 120, "magenta": 150}
"""OpenCV's hue, 0 to 180."""
HUE_WIDTH = 12
LEAST_SATURATION, LEAST_VALUE = 90, 50
SCALE = 4
"""Background is learned in a picture this much smaller: motion needs no sub-pixels."""
UNLIKE = 1.6
"""Ratio of the two patches' areas from which one is partly hidden, and its middle wrong."""
NEAR_M = 0.5
"""How near its last place a patch of a robot that stands still may be."""


@dataclass(frozen=True, slots=True, eq=False)
class Blob:
    """A patch in the picture: its middle (2,) and its area, in pixels."""

    middle: FloatArray
    area: float


class PatchFinder:
    """Finds robots by pairs of colours. `pairs` maps a robot to its front and rear colour."""

    def __init__(
        self,
        pairs: dict[str, tuple[str, str]],
        view: View,
        gap_m: dict[str, float],
        last_m: Callable[[str], tuple[float, float] | None],
    ) -> None:
        import cv2

        for robot, pair in pairs.items():
            for colour in pair:
                if colour not in HUES:
                    raise ConfigError(
                        f"patches of {robot}: no colour {colour!r}; there are: {', '.join(HUES)}"
                    )
        self._pairs, self._view, self._gap_m, self._last_m = pairs, view, gap_m, last_m
        self._background = cv2.createBackgroundSubtractorMOG2(
            history=300, varThreshold=25, detectShadows=False
        )
        self._kernel = np.ones((3, 3), np.uint8)

    def find(self, picture: Any) -> list[Seen]:
        """Every pair of patches that may be one of our robots, also where there are two."""
        import cv2

        moved = self._moved(picture)
        hsv = cv2.cvtColor(cv2.GaussianBlur(picture, (3, 3), 0), cv2.COLOR_BGR2HSV)
        colours = {colour for pair in self._pairs.values() for colour in pair}
        blobs = {colour: self._blobs(hsv, colour) for colour in colours}
        seen = []
        for robot, (front, rear) in self._pairs.items():
            for ahead in blobs[front]:
                for behind in blobs[rear]:
                    alike = 1 / UNLIKE < ahead.area / behind.area < UNLIKE
                    if alike and self._belong(robot, ahead.middle, behind.middle, moved):
                        seen.append(Seen(robot, ahead.middle, behind.middle))
        return seen

    def _moved(self, picture: Any) -> Any:
        import cv2

        small = cv2.resize(picture, None, fx=1 / SCALE, fy=1 / SCALE, interpolation=cv2.INTER_AREA)
        return cv2.dilate(self._background.apply(small), self._kernel, iterations=1)

    def _blobs(self, hsv: Any, colour: str) -> list[Blob]:
        """The connected patches of a colour."""
        import cv2

        low, high = HUES[colour] - HUE_WIDTH, HUES[colour] + HUE_WIDTH
        mask = cv2.inRange(hsv, (max(low, 0), LEAST_SATURATION, LEAST_VALUE), (high, 255, 255))
        if low < 0:
            mask |= cv2.inRange(hsv, (180 + low, LEAST_SATURATION, LEAST_VALUE), (180, 255, 255))
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, self._kernel)
        left, top, width, height = cv2.boundingRect(mask)  # most of a picture has no patch in it
        if not width:
            return []
        mask = np.ascontiguousarray(mask[top : top + height, left : left + width])
        count, _, boxes, middles = cv2.connectedComponentsWithStats(mask, connectivity=8)
        areas = boxes[:, cv2.CC_STAT_AREA]
        corner = np.array([left, top], dtype=float)
        return [Blob(middles[n] + corner, float(areas[n])) for n in range(1, count) if 12 <= areas[n] <= 5000]

    def _belong(self, robot: str, ahead: FloatArray, behind: FloatArray, moved: Any) -> bool:
        front, rear = self._view.to_field(np.vstack([ahead, behind]))
        gap_m = float(np.hypot(*(front - rear)))
        if not abs(gap_m / self._gap_m[robot] - 1.0) < 0.5:
            return False
        x, y = ((ahead + behind) / 2 / SCALE).astype(int)
        if moved[min(y, moved.shape[0] - 1), min(x, moved.shape[1] - 1)]:
            return True
        last = self._last_m(robot)
        return last is not None and float(np.hypot(*((front + rear) / 2 - last))) < NEAR_M
