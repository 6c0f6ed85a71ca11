"""Position logs of any kind as one list of spots: CSV, GPX, tlog, dataflash .bin, ROS 2 bags, our own recordings."""

import logging
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.positions.table import Table, instant_ns, number, read_table, timed
from fieldkit.errors import DataError
from fieldkit.files import is_stream

logger = logging.getLogger(__name__)

GPS_SIGMA_M = 2.5
"""Standard deviation where a log does not say: a receiver without corrections."""
ONLY = "radio"
"""The robot's name where a log has but one, unnamed."""


@dataclass(frozen=True, slots=True)
class Spot:
    """Where somebody was: latitude and longitude in degrees, or east and north in metres."""

    t_ns: int
    robot: str
    first: float
    """Latitude (deg) or east (m)."""
    second: float
    """Longitude (deg) or north (m)."""
    up_m: float = 0.0
    heading_deg: float = 0.0
    sigma_m: float = GPS_SIGMA_M


@dataclass
class Track:
    """A position log. Spots are in order of time."""

    path: Path
    geodetic: bool
    """Whether spots are latitude and longitude."""
    spots: list[Spot] = field(default_factory=list)
    skipped: int = 0
    """Entries that could not be read or had no fix."""
    notes: list[str] = field(default_factory=list)
    """What was left out, in words."""
    heights: bool = False
    """Whether the log says how high."""


def read_track(path: Path, robot: str | None = None) -> Track:
    """Read a position log by its ending. `robot` renames the only one of a log without names.

    Raises `DataError` where it is missing, of an unknown kind, or holds no position.
    """
    kinds: dict[str, Callable[[Path], Track]] = {
        ".csv": _csv,
        ".gpx": _gpx,
        ".tlog": _tlog,
        ".bin": _dataflash,
        ".mcap": _mcap,
    }
    if is_stream(path):
        raise DataError(
            f"{path}: expected a file of positions, got a pipe or device; write it into a file first"
        )
    reader = _mcap if path.is_dir() else kinds.get(path.suffix.lower())
    if reader is None:
        raise DataError(f"{path}: expected one of {', '.join(kinds)}, got '{path.suffix}'")
    if not path.exists():
        raise DataError(f"{path}: no such file")
    track = reader(path)
    if not track.spots:
        raise DataError(f"{path}: no position in it ({track.skipped} entries could not be used)")
    track.spots.sort(key=lambda spot: spot.t_ns)
    if robot is not None:
        names = {spot.robot for spot in track.spots}
        if len(names) > 1:
            raise DataError(
                f"{path}: is of several robots ({', '.join(sorted(names))}); they keep their names"
            )
        track.spots = [renamed(spot, robot) for spot in track.spots]
    if track.skipped:
        logger.warning("%s: %d entries without a usable position", path, track.skipped)
    return track


def renamed(spot: Spot, robot: str) -> Spot:
    """The same place of another robot."""
    return Spot(spot.t_ns, robot, spot.first, spot.second, spot.up_m, spot.heading_deg, spot.sigma_m)


def add(track: Track, spot: Spot) -> None:
    """Keep a spot that can be: 0, 0 is what an autopilot says before it has a fix."""
    values = (spot.first, spot.second, spot.up_m, spot.heading_deg, spot.sigma_m)
    possible = all(math.isfinite(value) for value in values) and spot.sigma_m >= 0.0
    if possible and track.geodetic:
        possible = (
            abs(spot.first) <= 90.0 and abs(spot.second) <= 180.0 and (spot.first, spot.second) != (0, 0)
        )
    if possible:
        track.spots.append(spot)
    else:
        track.skipped += 1


def _csv(path: Path) -> Track:
    return track_of(read_table(path))


def track_of(table: Table) -> Track:
    """The positions of a CSV table. Raises `DataError` where it has no columns for them."""
    geodetic = {"lat_deg", "lon_deg"} <= table.names
    if not geodetic and not {"east_m", "north_m"} <= table.names:
        raise DataError(
            f"{table.path}: no columns say where: expected lat_deg and lon_deg, or east_m and north_m"
        )
    first, second = ("lat_deg", "lon_deg") if geodetic else ("east_m", "north_m")
    track = Track(table.path, geodetic)
    for line, t_ns, row in timed(table):
        one, other = number(row, first), number(row, second)
        if one is None or other is None:
            table.bad(line, f"no position in {row}")
            continue
        sigma_m = number(row, "sigma_m")
        sigma_m = (GPS_SIGMA_M if geodetic else 0.05) if sigma_m is None else sigma_m
        heading = (number(row, "heading_deg") or 0.0) % 360.0
        up_m = number(row, "up_m")
        if "up_m" in table.names and up_m is None:
            table.bad(line, "no height, and other rows have one")
            continue
        add(track, Spot(t_ns, row.get("robot") or ONLY, one, other, up_m or 0.0, heading, sigma_m))
    track.skipped += table.skipped
    track.notes += table.notes()
    track.heights = "up_m" in table.names
    return track


def _gpx(path: Path) -> Track:
    """Track points with a time. GPX 1.1; the name space is whatever the writer used."""
    from xml.etree import ElementTree

    text = path.read_bytes()
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise DataError(f"{path}: has a document type, which no GPX needs: it is not read")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise DataError(f"{path}: not valid GPX: {error}") from error
    track = Track(path, geodetic=True)
    for point in root.iter():
        if not point.tag.endswith("}trkpt") and point.tag != "trkpt":
            continue
        parts = {child.tag.rsplit("}", 1)[-1]: (child.text or "").strip() for child in point}
        t_ns = instant_ns(parts.get("time", "").replace("Z", "+00:00"))
        try:
            place = float(point.get("lat", "nan")), float(point.get("lon", "nan"))
        except ValueError:
            place = (math.nan, math.nan)
        if t_ns is None:
            track.skipped += 1
        else:
            add(track, Spot(t_ns, ONLY, *place))
    return track


def _tlog(path: Path) -> Track:
    """GLOBAL_POSITION_INT of each autopilot, by the log's time; named `system N` where there are several."""
    found = Track(path, geodetic=True)
    for message in _messages(path, "GLOBAL_POSITION_INT", found):
        heading = message.hdg / 100.0 if message.hdg != 65535 else 0.0
        name = f"system {message.get_srcSystem()}"
        place = message.lat * 1e-7, message.lon * 1e-7, message.relative_alt * 1e-3
        add(found, Spot(round(message._timestamp * 1e9), name, *place, heading % 360.0))
    if len({spot.robot for spot in found.spots}) == 1:
        found.spots = [renamed(spot, ONLY) for spot in found.spots]
    return found


def _dataflash(path: Path) -> Track:
    """POS (the autopilot's own estimate) with ATT's heading; GPS where there is no POS."""
    found = Track(path, geodetic=True)
    raw = Track(path, geodetic=True)
    heading = 0.0
    for message in _messages(path, ["POS", "GPS", "ATT"], found):
        kind = message.get_type()
        if kind == "ATT":
            heading = float(message.Yaw) % 360.0 if math.isfinite(message.Yaw) else heading
        elif kind == "POS":
            up_m = float(getattr(message, "RelHomeAlt", 0.0))
            add(found, Spot(round(message._timestamp * 1e9), ONLY, message.Lat, message.Lng, up_m, heading))
        elif message.Status >= 3 and getattr(message, "I", 0) == 0:
            add(raw, Spot(round(message._timestamp * 1e9), ONLY, message.Lat, message.Lng, 0.0, heading))
    return found if found.spots else raw


def _messages(path: Path, kinds: Any, track: Track) -> Any:
    """Messages out of a log by pymavlink's readers; what they cannot read ends the log, not us."""
    from pymavlink import mavutil

    environment = dict(os.environ)
    try:
        log = mavutil.mavlink_connection(str(path))
    except (OSError, ValueError, IndexError, KeyError, TypeError) as error:
        raise DataError(f"{path}: not a log pymavlink can read: {error}") from error
    try:
        while (message := log.recv_match(type=kinds)) is not None:
            yield message
    except (ValueError, IndexError, KeyError, TypeError, OverflowError) as error:
        track.skipped += 1
        logger.warning("%s: not readable to its end: %s", path, error)
    finally:
        log.close()
        # pymavlink notes the version it found in the environment, where whoever runs beside us would heed it.
        for name in ("MAVLINK20", "MAVLINK09", "MAVLINK_DIALECT"):
            os.environ.pop(name, None)
            if name in environment:
                os.environ[name] = environment[name]


def _mcap(path: Path) -> Track:
    """A ROS 2 recording, also a folder of its files, or one of ours."""
    from drivers.positions.bags import is_bag, read_bag

    return read_bag(path) if is_bag(path) else _recording(path)


def _recording(path: Path) -> Track:
    """Poses of a fieldkit recording: east and north."""
    from fieldkit.messages import Pose
    from fieldkit.recording.reader import open_recording

    track = Track(path, geodetic=False)
    for _, _, event in open_recording(path).events():
        if isinstance(event, Pose):
            place = event.east_m, event.north_m, event.up_m
            add(track, Spot(event.t_ns, event.robot, *place, event.heading_deg, event.sigma_m))
    return track
