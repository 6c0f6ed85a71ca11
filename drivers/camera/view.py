"""Where a pixel is in the field: a homography fitted to known points, with the lens's distortion taken out first.

Pixels are (x right, y down) from the picture's top left corner; field points are (east, north) in metres on the
ground. What stands `height_m` above the ground is seen further from the camera's foot than it is; with the camera's
own place known that is corrected.
"""

from dataclasses import dataclass

import numpy as np

from fieldkit.errors import CalibrationRefused
from fieldkit.messages import FloatArray

FEWEST_POINTS = 4
FLATTEST = 0.02
"""Least ratio of the point cloud's width to its length; flatter counts as one line."""


@dataclass(frozen=True, slots=True)
class Lens:
    """Pinhole and distortion as `cv2.calibrateCamera` gives them: focal lengths and centre in pixels."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2, k3 as far as known."""

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) camera matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera's view of the field."""

    to_ground: FloatArray
    """(3, 3) homography from undistorted pixels to metres."""
    residual_m: FloatArray
    """(n,) distance between each known point and where the fit puts it."""
    lens: Lens | None = None
    camera_m: tuple[float, float, float] | None = None
    """Where the camera hangs: east, north, up."""

    @property
    def rms_m(self) -> float:
        """Root mean square residual per point; 0 with four points, which are always met."""
        return float(np.sqrt(np.mean(self.residual_m**2)))

    def to_field(self, pixels: FloatArray, height_m: float = 0.0) -> FloatArray:
        """(n, 2) field points of (n, 2) pixels that lie `height_m` above the ground."""
        ground = _apply(self.to_ground, self._straight(pixels))
        if height_m == 0.0 or self.camera_m is None:
            return ground
        east, north, up = self.camera_m
        return ground + (np.array([east, north]) - ground) * (height_m / up)

    def to_picture(self, field_m: FloatArray) -> FloatArray:
        """(n, 2) pixels of (n, 2) ground points."""
        straight = _apply(
            np.asarray(np.linalg.inv(self.to_ground), dtype=np.float64), np.asarray(field_m, dtype=float)
        )
        if self.lens is None or not self.lens.distortion:
            return straight
        import cv2

        lens = self.lens
        rays = np.column_stack([(straight - [lens.cx, lens.cy]) / [lens.fx, lens.fy], np.ones(len(straight))])
        bent, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), lens.matrix, np.array(lens.distortion))
        return np.asarray(bent, dtype=float).reshape(-1, 2)

    def metres_per_pixel(self, pixel: FloatArray) -> float:
        """The longest side of one pixel's patch of ground."""
        x, y = np.asarray(pixel, dtype=float)
        here, right, below = self.to_field(np.array([[x, y], [x + 1.0, y], [x, y + 1.0]]))
        return float(max(np.hypot(*(right - here)), np.hypot(*(below - here))))

    def _straight(self, pixels: FloatArray) -> FloatArray:
        return straightened(pixels, self.lens)


def straightened(pixels: FloatArray, lens: Lens | None) -> FloatArray:
    """(n, 2) pixels as a lens without distortion would have shown them."""
    points = np.asarray(pixels, dtype=float).reshape(-1, 2)
    if lens is None or not lens.distortion:
        return points
    import cv2

    found = cv2.undistortPoints(points[:, None, :], lens.matrix, np.array(lens.distortion), P=lens.matrix)
    return np.asarray(found, dtype=float).reshape(-1, 2)


def fit_view(
    pixels: FloatArray,
    field_m: FloatArray,
    *,
    lens: Lens | None = None,
    camera_m: tuple[float, float, float] | None = None,
) -> View:
    """Fit to known points: (n, 2) pixels and their (n, 2) ground points, n >= 4.

    Raises `CalibrationRefused` where the points cannot carry it: too few, on one line, or contradicting.
    """
    import cv2

    pixels = np.asarray(pixels, dtype=float).reshape(-1, 2)
    field_m = np.asarray(field_m, dtype=float).reshape(-1, 2)
    _check(pixels, field_m)
    straight = straightened(pixels, lens)
    found, _ = cv2.findHomography(straight, field_m, 0)
    if found is None or not np.all(np.isfinite(found)) or abs(np.linalg.det(found)) < 1e-12:
        raise CalibrationRefused("camera: no homography fits these points; are some of them swapped?")
    homography: FloatArray = np.asarray(found, dtype=np.float64)
    residual = np.hypot(*(_apply(homography, straight) - field_m).T)
    _check_side(homography, straight)
    return View(homography, residual, lens, camera_m)


def _check(pixels: FloatArray, field_m: FloatArray) -> None:
    if len(pixels) != len(field_m) or len(pixels) < FEWEST_POINTS:
        raise CalibrationRefused(
            f"camera: expected at least {FEWEST_POINTS} points, each with pixel and place, got {len(pixels)}"
        )
    if not (np.all(np.isfinite(pixels)) and np.all(np.isfinite(field_m))):
        raise CalibrationRefused("camera: a point is not a number")
    for name, points in (("in the picture", pixels), ("in the field", field_m)):
        if not _carries(points):
            raise CalibrationRefused(
                f"camera: the points lie (nearly) on one line {name}: a plane needs four of which no three are "
                "in line; add points off the line, best near the field's corners"
            )


def _carries(points: FloatArray) -> bool:
    """Whether the points span a plane: not all in line and, of only four, no three in line."""
    subsets = [points]
    if len(points) == FEWEST_POINTS:
        subsets = [np.delete(points, skip, axis=0) for skip in range(FEWEST_POINTS)]
    for subset in subsets:
        spread = np.linalg.svd(subset - subset.mean(axis=0), compute_uv=False)
        if spread[-1] <= FLATTEST * max(spread[0], 1e-12):
            return False
    return True


def _check_side(homography: FloatArray, pixels: FloatArray) -> None:
    """All points must lie on the camera's side of the horizon."""
    w = np.column_stack([pixels, np.ones(len(pixels))]) @ homography[2]
    if np.min(w) * np.max(w) <= 0.0:
        raise CalibrationRefused(
            "camera: the points contradict each other: some would lie beyond the horizon; are two swapped?"
        )


def _apply(homography: FloatArray, points: FloatArray) -> FloatArray:
    lifted = np.column_stack([points, np.ones(len(points))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(lifted[:, :2] / lifted[:, 2:])
