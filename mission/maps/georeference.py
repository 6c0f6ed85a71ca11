"""Where a picture's pixels are on Earth: from its world file, or from the tags of a GeoTIFF.

A world file has six numbers a line each and says nothing of the coordinates it is in: degrees are recognised,
all else must be named. GeoTIFF tags: OGC 19-008r4.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fieldkit.coordinates import from_utm
from fieldkit.errors import ConfigError

Corners = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
EARTH_M = 6_378_137.0
WORLD_ENDINGS = {
    ".png": (".pgw", ".pngw"),
    ".jpg": (".jgw", ".jpgw"),
    ".jpeg": (".jgw", ".jpegw"),
    ".webp": (".wpw", ".webpw"),
    ".tif": (".tfw", ".tifw"),
    ".tiff": (".tfw", ".tiffw"),
}
KNOWN = (
    "EPSG:4326 (degrees), EPSG:3857 (web maps), EPSG:326ZZ or 327ZZ (UTM), EPSG:258ZZ (ETRS89 / UTM), local"
)
_SCALE, _TIE, _MATRIX, _KEYS = 33550, 33922, 34264, 34735
_GEOGRAPHIC_KEY, _PROJECTED_KEY, _RASTER_KEY = 2048, 3072, 1025
_PIXEL_IS_POINT = 2


@dataclass(frozen=True, slots=True)
class PixelMap:
    """From columns and rows, counted from the outer corner at the upper left, to coordinates of `crs`."""

    crs: str
    numbers: tuple[float, float, float, float, float, float]
    """x = a u + b v + c, y = d u + e v + f, as (a, b, c, d, e, f)."""

    def at(self, u: float, v: float) -> tuple[float, float]:
        """Coordinates of a place in the picture."""
        a, b, c, d, e, f = self.numbers
        return a * u + b * v + c, d * u + e * v + f


def pixel_map(path: Path, image: Any, crs: str, where: str) -> PixelMap:
    """By the world file beside it, else by its own tags. Raises `ConfigError` with what is missing."""
    if (world := _world_file(path)) is not None:
        numbers = _world_numbers(world, where)
        found = crs or _guessed(numbers, image)
        if not found:
            raise ConfigError(
                f"{where}: {world.name} does not say in which coordinates it is: set background_crs to {KNOWN}"
            )
        return PixelMap(checked_crs(found, where), numbers)
    tags = getattr(image, "tag_v2", {})
    if _KEYS in tags:
        return _geotiff(tags, crs, where)
    endings = " or ".join(WORLD_ENDINGS[path.suffix.lower()])
    raise ConfigError(
        f"{where}: nothing says where it is: expected a world file beside it ({endings}, .wld), or a GeoTIFF"
    )


def _world_file(path: Path) -> Path | None:
    for ending in (*WORLD_ENDINGS[path.suffix.lower()], ".wld"):
        for name in (path.with_suffix(ending), path.with_suffix(ending.upper()), Path(f"{path}{ending}")):
            if name.is_file():
                return name
    return None


def _world_numbers(world: Path, where: str) -> tuple[float, float, float, float, float, float]:
    try:
        a, d, b, e, c, f = (float(part.replace(",", ".")) for part in world.read_text().split())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{where}: {world.name}: expected six numbers, one a line") from error
    # Its last two numbers are the middle of the first pixel.
    return a, b, c - (a + b) / 2, d, e, f - (d + e) / 2


def _guessed(numbers: tuple[float, float, float, float, float, float], image: Any) -> str:
    """Degrees, where they can be nothing else."""
    made = PixelMap("", numbers)
    ends = [made.at(0, 0), made.at(image.width, image.height)]
    small = max(abs(numbers[0]), abs(numbers[4])) < 0.01
    return "EPSG:4326" if small and all(abs(x) <= 180.0 and abs(y) <= 90.0 for x, y in ends) else ""


def _geotiff(tags: Any, crs: str, where: str) -> PixelMap:
    flat = list(tags[_KEYS])
    keys = {flat[k]: flat[k + 3] for k in range(4, len(flat) - 3, 4) if flat[k + 1] == 0}
    code = keys.get(_PROJECTED_KEY) or keys.get(_GEOGRAPHIC_KEY)
    found = crs or (f"EPSG:{code}" if code else "")
    if _MATRIX in tags:
        m = [float(value) for value in tags[_MATRIX]]
        numbers = (m[0], m[1], m[3], m[4], m[5], m[7])
    elif _SCALE in tags and _TIE in tags:
        scale, tie = [float(v) for v in tags[_SCALE]], [float(v) for v in tags[_TIE]]
        x0, y0 = tie[3] - tie[0] * scale[0], tie[4] + tie[1] * scale[1]
        numbers = (scale[0], 0.0, x0, 0.0, -scale[1], y0)
    else:
        raise ConfigError(f"{where}: its GeoTIFF tags do not place it (no pixel scale, no transformation)")
    if keys.get(_RASTER_KEY) == _PIXEL_IS_POINT:
        a, b, c, d, e, f = numbers
        numbers = (a, b, c - (a + b) / 2, d, e, f - (d + e) / 2)
    return PixelMap(checked_crs(found, where), numbers)


def checked_crs(crs: str, where: str) -> str:
    """A coordinate system that is known here. Raises `ConfigError`."""
    if crs.lower() == "local":
        return "local"
    name = crs.upper()
    if name in ("EPSG:4326", "EPSG:4258", "EPSG:3857") or _utm(name):
        return name
    raise ConfigError(
        f"{where}: its coordinates are {crs or 'not named'}; expected {KNOWN}: export it in one of these"
    )


def _utm(name: str) -> tuple[int, bool] | None:
    found = re.fullmatch(r"EPSG:(326|327|258)(\d\d)", name)
    if found is None or not 1 <= int(found[2]) <= 60:
        return None
    return int(found[2]), found[1] != "327"


def to_degrees(crs: str, x: float, y: float) -> tuple[float, float]:
    """Latitude and longitude; ETRS89 is taken for WGS-84, which is within a metre."""
    ways: dict[str, Callable[[], tuple[float, float]]] = {
        "EPSG:4326": lambda: (y, x),
        "EPSG:4258": lambda: (y, x),
        "EPSG:3857": lambda: (
            math.degrees(math.atan(math.sinh(y / EARTH_M))),
            math.degrees(x / EARTH_M),
        ),
    }
    if crs in ways:
        return ways[crs]()
    zone = _utm(crs)
    assert zone is not None
    return from_utm(x, y, zone[0], northern=zone[1])
