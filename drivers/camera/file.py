"""The camera's calibration file: known points, and the lens where it is known. Fitted each time it is read.

schema = 1
camera_m = [5.0, -1.0, 9.5]             # optional: east, north, up; needed to allow for the robots' height
points = [[212.0, 640.5, 0.0, 0.0], ...]    # x, y in pixels, then east, north in metres; four or more

[lens]                                  # optional, from cv2.calibrateCamera
fx = 700.0
fy = 700.0
cx = 640.0
cy = 360.0
distortion = [-0.2, 0.05]
"""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera.view import Lens, View, fit_view
from fieldkit.errors import ConfigError
from fieldkit.messages import FloatArray


def read_points(path: Path) -> tuple[FloatArray, FloatArray, Lens | None, tuple[float, float, float] | None]:
    """Pixels (n, 2), field points (n, 2), lens and camera's place. Raises `ConfigError` naming file and key."""
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; expected the camera's known points") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
    if raw.get("schema") != 1:
        raise ConfigError(f"{path}: schema: expected 1, got {raw.get('schema')!r}")
    unknown = set(raw) - {"schema", "camera_m", "points", "lens"}
    if unknown:
        raise ConfigError(f"{path}: {sorted(unknown)[0]}: no such key; known are camera_m, points, lens")
    points = np.array([_numbers(path, f"points[{n}]", row, 4) for n, row in enumerate(raw.get("points", []))])
    if not len(points):
        raise ConfigError(f"{path}: points: expected rows of x, y, east, north; got none")
    place = raw.get("camera_m")
    camera_m = None
    if place is not None:
        east, north, up = _numbers(path, "camera_m", place, 3)
        if up <= 0.0:
            raise ConfigError(f"{path}: camera_m: expected a height above the ground, got {up:g}")
        camera_m = (east, north, up)
    return points[:, :2], points[:, 2:], _lens(path, raw.get("lens")), camera_m


def read_view(path: Path) -> View:
    """The view the file's points give. Raises `ConfigError`, `CalibrationRefused`."""
    pixels, field_m, lens, camera_m = read_points(path)
    return fit_view(pixels, field_m, lens=lens, camera_m=camera_m)


def _lens(path: Path, table: Any) -> Lens | None:
    if table is None:
        return None
    if not isinstance(table, dict) or not {"fx", "fy", "cx", "cy"} <= set(table):
        raise ConfigError(f"{path}: lens: expected fx, fy, cx, cy and perhaps distortion, got {table!r}")
    fx, fy, cx, cy = _numbers(path, "lens", [table[name] for name in ("fx", "fy", "cx", "cy")], 4)
    bent = table.get("distortion", [])
    if not isinstance(bent, list) or len(bent) > 5:
        raise ConfigError(
            f"{path}: lens.distortion: expected up to 5 numbers (k1, k2, p1, p2, k3), got {bent!r}"
        )
    known = _numbers(path, "lens.distortion", bent, len(bent))
    return Lens(fx, fy, cx, cy, tuple(known + [0.0] * (5 - len(known))) if known else ())


def _numbers(path: Path, key: str, value: Any, count: int) -> list[float]:
    good = isinstance(value, list) and len(value) == count
    if not good or not all(
        isinstance(each, int | float) and not isinstance(each, bool) and abs(each) < 1e7 for each in value
    ):
        raise ConfigError(f"{path}: {key}: expected {count} finite numbers, got {value!r}")
    return [float(each) for each in value]
