"""Robots by square markers: ArUco and AprilTag, through OpenCV's detector with sub-pixel corners."""

from typing import Any

import numpy as np

from drivers.camera.seen import Seen
from fieldkit.errors import ConfigError
from fieldkit.messages import FloatArray

WINDOW = 0.12
"""Half width of the window a corner is refined in, as a share of the marker's side."""

FAMILIES = {
    "aruco-4x4": "DICT_4X4_50",
    "aruco-5x5": "DICT_5X5_100",
    "aruco-6x6": "DICT_6X6_250",
    "apriltag-16h5": "DICT_APRILTAG_16h5",
    "apriltag-25h9": "DICT_APRILTAG_25h9",
    "apriltag-36h11": "DICT_APRILTAG_36h11",
}
"""Fewer, larger squares are read from further away: 4x4 needs the smallest picture."""


def dictionary(family: str) -> Any:
    """OpenCV's dictionary. Raises `ConfigError` naming those there are."""
    import cv2

    if family not in FAMILIES:
        raise ConfigError(f"markers: no family {family!r}; there are: {', '.join(FAMILIES)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[family]))


class MarkerFinder:
    """Finds the markers of known robots. `robots` maps a marker's number to its robot."""

    def __init__(self, family: str, robots: dict[int, str]) -> None:
        import cv2

        parameters = cv2.aruco.DetectorParameters()
        # Markers are 15 to 60 pixels wide here: larger threshold windows only cost time.
        parameters.adaptiveThreshWinSizeMin = 5
        parameters.adaptiveThreshWinSizeMax = 23
        parameters.adaptiveThreshWinSizeStep = 9
        parameters.minMarkerPerimeterRate = 0.02
        # OpenCV's own refinement looks at a pixel or two of so small a marker; see `_refined`.
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
        self._detector = cv2.aruco.ArucoDetector(dictionary(family), parameters)
        self._robots = robots

    def find(self, picture: Any) -> list[Seen]:
        """Every marker of ours in the picture (rows, columns, BGR), also one that is there twice."""
        import cv2

        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        corners, numbers, _ = self._detector.detectMarkers(grey)
        if numbers is None:
            return []
        seen = []
        for number, found in zip(np.ravel(numbers), corners, strict=True):
            robot = self._robots.get(int(number))
            if robot is not None:
                points = _refined(grey, np.asarray(found).reshape(4, 2))
                front, rear = (points[0] + points[1]) / 2, (points[2] + points[3]) / 2
                seen.append(Seen(robot, front, rear, points))
        return seen


def _refined(grey: Any, corners: Any) -> FloatArray:
    """(4, 2) corners to a fraction of a pixel, from a window of half a module to a module around each."""
    import cv2

    side_px = float(np.hypot(*(corners - np.roll(corners, 1, axis=0)).T).min())
    half = int(np.clip(round(side_px * WINDOW), 2, 6))
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 0.01)
    start = np.array(corners, dtype=np.float32)[:, None, :].copy()
    return np.asarray(cv2.cornerSubPix(grey, start, (half, half), (-1, -1), stop), dtype=float).reshape(4, 2)
