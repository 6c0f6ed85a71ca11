"""A picture of the ground under the page's map: tiles of an MBTiles file, or a geo-referenced picture. No internet.

Each picture is placed by three of its corners in the field's frame, so that the page draws it with one affine map: over
a field of some kilometres the projections bend by less than a pixel.
"""

import base64
import contextlib
import html
import io
import logging
import math
import re
import sqlite3
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from typing_extensions import TypedDict

from fieldkit.errors import ConfigError, os_words
from fieldkit.geo import FieldFrame
from mission.core.mission_file import Mission
from mission.maps.georeference import Corners, pixel_map, to_degrees

logger = logging.getLogger(__name__)

TILES = ".mbtiles"
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff")
MARGIN = 0.15
"""Of the field's size is shown beyond it."""
MOST_TILES = 64
TILE_KINDS = {b"\x89PNG": "image/png", b"\xff\xd8": "image/jpeg", b"RIFF": "image/webp"}
LARGEST_PX = 3000
"""Side of a picture that is sent."""
INLINE_PX, TILE_PX = 1400, 256
"""Side of a picture, and of one of many, that goes into a report: reports are sent by mail."""
ABOUT = "select name, value from metadata where name is not null and value is not null"
ZOOMS = """select distinct zoom_level from tiles where typeof(zoom_level) = 'integer' and zoom_level between 0 and 30
order by 1 desc"""
"""The finest first. What is no zoom, in a damaged file or somebody else's, is passed over."""
OVERVIEW_M = 25.0
"""A whole tile file of which a pixel is more than this is no map of a field."""


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture and where it lies."""

    name: str
    media_type: str
    data: bytes
    corners_m: Corners
    """(east, north) of its upper left, upper right and lower left corner."""


class PictureShown(TypedDict):
    """A picture as the page is sent it."""

    url: str
    corners_m: Corners
    """(east, north) of its upper left, upper right and lower left corner."""


class BackgroundShown(TypedDict):
    """All of them, and whom they are owed to."""

    credit: str
    pictures: list[PictureShown]


@dataclass(frozen=True, slots=True)
class Background:
    """What is under the map."""

    pictures: tuple[Picture, ...]
    credit: str
    covered: float
    """Share of the field that has a picture."""

    def described(self, folder: str = "background") -> BackgroundShown:
        """As the page is sent it; it fetches the pictures from `folder`."""
        return self._described((each, f"{folder}/{each.name}") for each in self.pictures)

    def smaller(self) -> Iterator[Picture]:
        """As they go into a report; damaged ones are passed over."""
        for each in self.pictures:
            try:
                data, media_type = _smaller(each, INLINE_PX if len(self.pictures) == 1 else TILE_PX)
            except _unreadable() as error:
                logger.warning("a picture under the map is left out (%s): %s", each.name, error)
            else:
                yield replace(each, data=data, media_type=media_type)

    def inlined(self) -> BackgroundShown:
        """As the page is given it where it has no server: with the pictures in it."""
        return self._described(
            (each, f"data:{each.media_type};base64,{base64.b64encode(each.data).decode()}")
            for each in self.smaller()
        )

    def _described(self, pictures: Iterable[tuple[Picture, str]]) -> BackgroundShown:
        return {
            "credit": self.credit,
            "pictures": [{"url": url, "corners_m": each.corners_m} for each, url in pictures],
        }


@dataclass(frozen=True, slots=True)
class Ground:
    """A field on Earth."""

    frame: FieldFrame
    size_east_m: float
    size_north_m: float


def read_background(mission: Mission) -> Background | None:
    """The background the mission file names, relative to itself; None where it names none. Raises `ConfigError`."""
    field = mission.file.field
    if not field.background:
        return None
    ground = Ground(mission.frame, field.size_east_m, field.size_north_m)
    return background_of(ground, Path(mission.where).parent / field.background, field.background_crs)


def background_of(ground: Ground, path: Path, crs: str = "") -> Background:
    """What a file has of the ground of a field; `crs` as `background_crs` names it. Raises `ConfigError`."""
    where = f"field.background: {path}"
    looks_like_a_map(path, where)
    return _read(ground, path, crs, _state(path))


def looks_like_a_map(path: Path, where: str) -> None:
    """Raises `ConfigError`, beginning with `where`, for what can be none whatever the field."""
    if not path.is_file():
        raise ConfigError(f"{where}: {'it is a folder' if path.is_dir() else 'no such file'}")
    if (ending := path.suffix.lower()) not in (TILES, *PICTURES):
        raise ConfigError(f"{where}: expected {TILES} or a picture ({', '.join(PICTURES)}), got '{ending}'")


@lru_cache(maxsize=2)
def _read(ground: Ground, path: Path, crs: str, state: tuple[tuple[str, int, int], ...]) -> Background:
    """Kept while its files are as they were: an editor asks at every change, and a large picture takes seconds."""
    where = f"field.background: {path}"
    if path.suffix.lower() == TILES:
        return _tiles(path, where, ground)
    return _picture(path, where, ground, crs)


def _state(path: Path) -> tuple[tuple[str, int, int], ...]:
    """Of a file and of what lies beside it by the same name, as world files do: name, bytes, time of change."""
    found = []
    for each in path.parent.iterdir():
        if each.stem == path.stem or each.name.startswith(path.name):
            with contextlib.suppress(OSError):  # gone since
                stat = each.stat()
                found.append((each.name, stat.st_size, stat.st_mtime_ns))
    return tuple(sorted(found))


def background_or_none(mission: Mission) -> Background | None:
    """The same for a mission that is to go on without a picture rather than not at all."""
    try:
        return read_background(mission)
    except ConfigError as error:
        logger.warning("the map has no background: %s", error)
        return None


# -- MBTiles 1.3: SQLite with tables tiles and metadata; rows count from the south (TMS) ------------------------


def _tiles(path: Path, where: str, ground: Ground) -> Background:
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as file:
            about = {str(name): str(value) for name, value in file.execute(ABOUT)}
            zooms = [row[0] for row in file.execute(ZOOMS)]
            if about.get("format") == "pbf":
                raise ConfigError(
                    f"{where}: its tiles are vectors; pictures are drawn (png, jpg, webp): export raster tiles"
                )
            for zoom in zooms:
                found = _at_zoom(file, zoom, ground)
                if found is not None:
                    pictures, covered = found
                    return Background(pictures, _plain(about.get("attribution", "")), covered)
    except sqlite3.Error as error:
        raise ConfigError(f"{where}: not an MBTiles file: {error}") from error
    raise ConfigError(f"{where}: {_elsewhere(about, zooms, ground)}")


def _at_zoom(file: sqlite3.Connection, zoom: int, ground: Ground) -> tuple[tuple[Picture, ...], float] | None:
    """The tiles over the field at one zoom, and the share of the field they cover; None: none, or too many."""
    west, south, east, north = _bounds_deg(ground)
    pixel_m = 40_075_016.7 * math.cos(math.radians(south)) / 2**zoom / 256
    columns = range(math.floor(_column(west, zoom)), math.floor(_column(east, zoom)) + 1)
    rows = range(math.floor(_row(north, zoom)), math.floor(_row(south, zoom)) + 1)
    if len(columns) * len(rows) > MOST_TILES or pixel_m > OVERVIEW_M:
        return None
    pictures = []
    for column in columns:
        for row in rows:
            data = _tile(file, zoom, column, row)
            if data is not None:
                media_type = next((kind for head, kind in TILE_KINDS.items() if data.startswith(head)), "")
                if media_type:
                    corners = _tile_corners(zoom, column, row, ground)
                    pictures.append(Picture(f"{zoom}-{column}-{row}", media_type, data, corners))
    if not pictures:
        return None
    return tuple(pictures), _covered([picture.corners_m for picture in pictures], ground)


def _plain(text: str) -> str:
    """Attributions are often HTML."""
    return html.unescape(re.sub(r"<[^>]*>", "", text)).strip()


def _tile(file: sqlite3.Connection, zoom: int, column: int, row: int) -> bytes | None:
    found = file.execute(
        "select tile_data from tiles where zoom_level = ? and tile_column = ? and tile_row = ?",
        (zoom, column, 2**zoom - 1 - row),
    ).fetchone()
    return found[0] if found is not None and isinstance(found[0], bytes) else None


def _column(lon_deg: float, zoom: int) -> float:
    return float((lon_deg + 180.0) / 360.0 * 2**zoom)


def _row(lat_deg: float, zoom: int) -> float:
    """Counted from the north."""
    return float((1.0 - math.asinh(math.tan(math.radians(lat_deg))) / math.pi) / 2.0 * 2**zoom)


def _tile_corners(zoom: int, column: int, row: int, ground: Ground) -> Corners:
    def place(x: int, y: int) -> tuple[float, float]:
        lat_deg = math.degrees(math.atan(math.sinh(math.pi * (1.0 - 2.0 * y / 2**zoom))))
        return ground.frame.to_local(lat_deg, x / 2**zoom * 360.0 - 180.0)[:2]

    return place(column, row), place(column + 1, row), place(column, row + 1)


def _bounds_deg(ground: Ground) -> tuple[float, float, float, float]:
    """West, south, east, north of the field and what is shown round it."""
    east_m, north_m = MARGIN * ground.size_east_m, MARGIN * ground.size_north_m
    low = ground.frame.to_geodetic(-east_m, -north_m)
    high = ground.frame.to_geodetic(ground.size_east_m + east_m, ground.size_north_m + north_m)
    return low[1], low[0], high[1], high[0]


def _elsewhere(about: dict[str, str], zooms: list[int], ground: Ground) -> str:
    """Why no tile is over the field, in words."""
    lat_deg, lon_deg = ground.frame.origin_lat_deg, ground.frame.origin_lon_deg
    field = f"the field is at {lat_deg:.4f}, {lon_deg:.4f}"
    if not zooms:
        return "it holds no tiles"
    try:
        west, south, east, north = (float(part) for part in about["bounds"].split(","))
    except (KeyError, ValueError):
        return f"none of its tiles is over the field in enough detail: {field}"
    if west <= lon_deg <= east and south <= lat_deg <= north:
        return f"it covers this region, but has no tiles of enough detail here (zoom {zooms[0]} at most); {field}"
    middle = ground.frame.to_local((south + north) / 2, (west + east) / 2)
    away_km = math.hypot(middle[0], middle[1]) / 1000
    return (
        f"is a map of elsewhere: latitude {south:.4f} to {north:.4f}, longitude {west:.4f} to {east:.4f}, "
        f"{away_km:.0f} km away; {field}"
    )


# -- one picture -------------------------------------------------------------------------------------------------


def _picture(path: Path, where: str, ground: Ground, crs: str) -> Background:
    from PIL import Image

    try:
        quiet = warnings.catch_warnings(action="ignore", category=Image.DecompressionBombWarning)
        with quiet, Image.open(path) as image:
            pixels = pixel_map(path, image, crs, where)
            place = _placer(pixels.crs, ground)
            corners = [place(*pixels.at(u, v)) for u, v in ((0, 0), (image.width, 0), (0, image.height))]
            whole: Corners = (corners[0], corners[1], corners[2])
            box = _box(whole, image.width, image.height, ground)
            covered = _covered([whole], ground)
            if box is None or covered == 0.0:
                away_km = math.hypot(*whole[0]) / 1000
                raise ConfigError(
                    f"{where}: is a picture of elsewhere, {away_km:.{0 if away_km > 1 else 2}f} km away: "
                    "is background_crs right?"
                )
            left, upper, right, lower = box
            inner = [place(*pixels.at(u, v)) for u, v in ((left, upper), (right, upper), (left, lower))]
            data, media_type = _encoded(image.crop(box))
    except ConfigError:
        raise
    except Image.DecompressionBombError as error:
        raise ConfigError(
            f"{where}: has more than {2 * (Image.MAX_IMAGE_PIXELS or 0) / 1e6:.0f} million pixels: cut it to the "
            "field, or make an .mbtiles of it"
        ) from error
    except _unreadable() as error:
        raise ConfigError(f"{where}: cannot be read as a picture: {os_words(error)}") from error
    picture = Picture("picture", media_type, data, (inner[0], inner[1], inner[2]))
    return Background((picture,), "", covered)


def _placer(crs: str, ground: Ground) -> Callable[[float, float], tuple[float, float]]:
    """From the picture's own coordinates to the field's."""
    if crs == "local":
        return lambda x, y: (x, y)
    return lambda x, y: ground.frame.to_local(*to_degrees(crs, x, y))[:2]


def _box(corners: Corners, width: int, height: int, ground: Ground) -> tuple[int, int, int, int] | None:
    """Pixels of the field and what is shown round it; None where the picture has none of it."""
    east_m, north_m = MARGIN * ground.size_east_m, MARGIN * ground.size_north_m
    found = [
        _pixel(corners, east, north)
        for east in (-east_m, ground.size_east_m + east_m)
        for north in (-north_m, ground.size_north_m + north_m)
    ]
    left, right = (bound(u for u, _ in found) * width for bound in (min, max))
    upper, lower = (bound(v for _, v in found) * height for bound in (min, max))
    box = (
        max(0, math.floor(left)),
        max(0, math.floor(upper)),
        min(width, math.ceil(right)),
        min(height, math.ceil(lower)),
    )
    return box if box[0] < box[2] and box[1] < box[3] else None


def _pixel(corners: Corners, east_m: float, north_m: float) -> tuple[float, float]:
    """Where a place is in a picture: shares of its width and height."""
    (x0, y0), (x1, y1), (x2, y2) = corners
    a, b, c, d = x1 - x0, x2 - x0, y1 - y0, y2 - y0
    whole = a * d - b * c
    if whole == 0.0:
        raise ValueError("its world file makes a line of it")
    dx, dy = east_m - x0, north_m - y0
    return (d * dx - b * dy) / whole, (a * dy - c * dx) / whole


def _unreadable() -> tuple[type[Exception], ...]:
    """What Pillow raises for a picture that it cannot read."""
    from PIL import Image

    return (Image.DecompressionBombError, OSError, SyntaxError, ValueError)


def _smaller(picture: Picture, side_px: int) -> tuple[bytes, str]:
    from PIL import Image

    with Image.open(io.BytesIO(picture.data)) as image:
        image.load()
        return _encoded(image, side_px)


def _encoded(image: Any, side_px: int = LARGEST_PX) -> tuple[bytes, str]:
    """As browsers show it, not larger than they need."""
    image.thumbnail((side_px, side_px))
    clear = image.mode in ("RGBA", "LA", "PA") or "transparency" in image.info
    out = io.BytesIO()
    if clear:
        image.convert("RGBA").save(out, "PNG")
        return out.getvalue(), "image/png"
    image.convert("RGB").save(out, "JPEG", quality=88)
    return out.getvalue(), "image/jpeg"


# -- both --------------------------------------------------------------------------------------------------------


def _covered(all_corners: list[Corners], ground: Ground, side: int = 20) -> float:
    """Share of the field's ground with a picture, looked at on a grid of places."""

    def lies_in(corners: Corners, place: tuple[float, float]) -> bool:
        u, v = _pixel(corners, *place)
        return 0.0 <= u <= 1.0 and 0.0 <= v <= 1.0

    places = list(_places(ground, side))
    return sum(any(lies_in(corners, place) for corners in all_corners) for place in places) / len(places)


def _places(ground: Ground, side: int) -> Iterator[tuple[float, float]]:
    for row in range(side):
        for column in range(side):
            yield (column + 0.5) / side * ground.size_east_m, (row + 0.5) / side * ground.size_north_m
