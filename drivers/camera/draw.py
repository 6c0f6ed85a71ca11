"""Pictures for people: one picture from a source, with the fitted grid or the robots drawn into it."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera.capture import is_file, open_video
from drivers.camera.seen import Fix
from drivers.camera.view import View
from fieldkit.errors import DataError, DeviceError
from fieldkit.messages import FloatArray

GRID, POINT, ROBOT = (80, 220, 80), (60, 60, 255), (255, 160, 0)
"""BGR."""


def one_picture(source: str) -> Any:
    """A picture (rows, columns, 3) from a picture file or a video source. Raises `DeviceError`."""
    import cv2

    if is_file(source) and Path(source).suffix.lower() in (".png", ".jpg", ".jpeg"):
        picture = cv2.imread(source)
        if picture is None:
            raise DeviceError(f"camera {source}: no such picture, or not one that can be read")
        return picture
    video = open_video(source)
    try:
        for _ in range(10):
            good, picture = video.read()
            if good:
                return picture
    finally:
        video.release()
    raise DeviceError(
        f"camera {source}: gives no pictures; expected a picture, a video file, a USB camera's number, or a URL "
        "that a video player can show"
    )


def draw_grid(picture: Any, view: View, pixels: FloatArray, field_m: FloatArray, cell_m: float) -> Any:
    """The fitted field grid over the known points, each with its residual in cm."""
    import cv2

    drawn = picture.copy()
    low, high = (
        np.floor(field_m.min(axis=0) / cell_m) * cell_m,
        np.ceil(field_m.max(axis=0) / cell_m) * cell_m,
    )
    for axis in (0, 1):
        for value in np.arange(low[axis], high[axis] + cell_m / 2, cell_m):
            line = np.linspace(low, high, 41)
            line[:, axis] = value
            points = view.to_picture(line)
            cv2.polylines(drawn, [_whole(points)], False, GRID, 1, cv2.LINE_AA, 4)
    for pixel, place, residual_m in zip(pixels, field_m, view.residual_m, strict=True):
        x, y = (round(float(each)) for each in pixel)
        cv2.drawMarker(drawn, (x, y), POINT, cv2.MARKER_CROSS, 16, 2)
        words = f"{place[0]:g},{place[1]:g} m: {100 * residual_m:.1f} cm"
        cv2.putText(drawn, words, (x + 8, y - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, POINT, 1, cv2.LINE_AA)
    return drawn


def draw_fixes(picture: Any, view: View, fixes: list[Fix]) -> Any:
    """Each robot's place, with an arrow half a metre long along its heading."""
    import cv2

    drawn = picture.copy()
    for fix in fixes:
        angle = math.radians(fix.heading_deg)
        east, north = fix.east_m, fix.north_m
        ahead = (east + 0.5 * math.sin(angle), north + 0.5 * math.cos(angle))
        tail, head = view.to_picture(np.array([(east, north), ahead]))
        ends = [tuple(round(float(each)) for each in point) for point in (tail, head)]
        cv2.arrowedLine(drawn, ends[0], ends[1], ROBOT, 2, cv2.LINE_AA)
        cv2.putText(drawn, fix.robot, ends[0], cv2.FONT_HERSHEY_SIMPLEX, 0.6, ROBOT, 2, cv2.LINE_AA)
    return drawn


def write_picture(path: Path, picture: Any) -> None:
    """Write a PNG. Raises `DataError` where that is impossible."""
    import cv2

    from fieldkit.files import write_whole

    good, data = cv2.imencode(".png", picture)
    if not good:
        raise DataError(f"{path}: the picture cannot be written")
    write_whole(path, bytes(data))


def _whole(points: FloatArray) -> Any:
    return np.round(np.clip(points, -1e6, 1e6) * 16).astype(np.int32)[:, None, :]
