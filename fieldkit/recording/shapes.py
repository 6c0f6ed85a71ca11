"""Tables as shapes on a map: GeoJSON (RFC 7946), KML by simplekml, GPX 1.1. Longitude and latitude in WGS-84."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any
from xml.etree import ElementTree

import numpy as np

from fieldkit.coordinates import coordinates
from fieldkit.extras import need
from fieldkit.geo import FieldFrame
from fieldkit.settings import ELLIPSE_90

Tables = Mapping[str, np.ndarray]
MASS = 0.99
"""Of the belief, the fewest cells that hold this share of all its probability are drawn."""
_GPX = "http://www.topografix.com/GPX/1/1"


def geojson(frame: FieldFrame, tables: Tables, name: str) -> str:
    """One feature a track, reading, detection, source (with its 90 % ellipse) and likely cell."""
    features = [
        {"type": "Feature", "geometry": shape, "properties": plain(properties)}
        for shape, properties in _features(frame, tables)
    ]
    whole = {"type": "FeatureCollection", "name": name, "features": features}
    return json.dumps(whole, separators=(",", ":"), allow_nan=False)


def kml(frame: FieldFrame, tables: Tables, name: str) -> str:
    """The same for Google Earth and the like, a folder for each kind."""
    simplekml = need("simplekml", "post")
    document = simplekml.Kml(name=name)
    folders: dict[str, Any] = {}
    for shape, properties in _features(frame, tables):
        kind = str(properties["kind"])
        if kind not in folders:
            folders[kind] = document.newfolder(name=kind)
        said = "\n".join(f"{key}: {value}" for key, value in plain(properties).items() if value is not None)
        title = str(properties.get("name", ""))
        match shape["type"]:
            case "Point":
                drawn = folders[kind].newpoint(name=title, coords=[shape["coordinates"]], description=said)
            case "LineString":
                drawn = folders[kind].newlinestring(name=title, coords=shape["coordinates"], description=said)
            case _:
                ring = shape["coordinates"][0]
                drawn = folders[kind].newpolygon(name=title, outerboundaryis=ring, description=said)
                drawn.style.polystyle.color = "500000ff"
        if "t_ns" in properties:
            drawn.timestamp.when = iso(int(properties["t_ns"]))
    return str(document.kml())


def gpx(frame: FieldFrame, tables: Tables, name: str) -> str:
    """Tracks with time; everything else that is a point as a way-point. GPX has no areas: they are left out."""
    ElementTree.register_namespace("", _GPX)
    root = ElementTree.Element(f"{{{_GPX}}}gpx", version="1.1", creator="fieldkit")
    ElementTree.SubElement(ElementTree.SubElement(root, f"{{{_GPX}}}metadata"), f"{{{_GPX}}}name").text = name
    for shape, properties in _features(frame, tables):
        if shape["type"] == "Point":
            point = _gpx_point(root, "wpt", shape["coordinates"], properties.get("t_ns"))
            ElementTree.SubElement(point, f"{{{_GPX}}}name").text = str(properties.get("name", ""))
    for robot, track in by_robot(tables.get("poses")):
        element = ElementTree.SubElement(root, f"{{{_GPX}}}trk")
        ElementTree.SubElement(element, f"{{{_GPX}}}name").text = robot
        segment = ElementTree.SubElement(element, f"{{{_GPX}}}trkseg")
        for row in track:
            where = lon_lat(frame, float(row["east_m"]), float(row["north_m"]))
            _gpx_point(segment, "trkpt", where, int(row["t_ns"]))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


def last_estimates(rows: np.ndarray | None) -> np.ndarray:
    """The last estimates."""
    return np.array([]) if rows is None or not len(rows) else rows[rows["t_ns"] == rows["t_ns"].max()]


def _gpx_point(parent: Any, tag: str, lon_lat: Any, t_ns: Any) -> Any:
    lon, lat = lon_lat
    point = ElementTree.SubElement(parent, f"{{{_GPX}}}{tag}", lat=f"{lat:.8f}", lon=f"{lon:.8f}")
    if t_ns is not None:
        ElementTree.SubElement(point, f"{{{_GPX}}}time").text = iso(int(t_ns))
    return point


Shape = tuple[dict[str, Any], dict[str, Any]]


def _features(frame: FieldFrame, tables: Tables) -> Iterator[Shape]:
    """(geometry, properties) of everything that has a place."""
    for robot, track in by_robot(tables.get("poses")):
        line = [lon_lat(frame, float(row["east_m"]), float(row["north_m"])) for row in track]
        times = [iso(int(t)) for t in track["t_ns"]]
        # A line needs two points.
        shape = {"type": "LineString", "coordinates": line if len(line) > 1 else line * 2}
        yield shape, {"kind": "track", "name": robot, "coordTimes": times if len(line) > 1 else times * 2}
    yield from _points(frame, tables.get("readings"), "reading")
    heard = tables.get("detections")
    yield from _points(frame, heard if heard is None else heard[~np.isnan(heard["rss_dbm"])], "detection")
    yield from _sources(frame, tables.get("sources"))
    yield from _cells(frame, tables.get("belief"))


def _points(frame: FieldFrame, rows: np.ndarray | None, kind: str) -> Iterator[Shape]:
    if rows is None:
        return
    for row in rows:
        if math.isfinite(row["east_m"]) and math.isfinite(row["north_m"]):
            where = lon_lat(frame, float(row["east_m"]), float(row["north_m"]))
            properties = {name: row[name].item() for name in rows.dtype.names or ()}
            yield (
                {"type": "Point", "coordinates": where},
                {"kind": kind, "name": f"{row['rss_dbm']:.0f} dBm", **properties},
            )


def _sources(frame: FieldFrame, rows: np.ndarray | None) -> Iterator[Shape]:
    """The last estimates: a point and an ellipse each."""
    last = last_estimates(rows)
    for row in last:
        east, north = float(row["east_m"]), float(row["north_m"])
        if not (math.isfinite(east) and math.isfinite(north)):
            continue
        properties = {name: row[name].item() for name in last.dtype.names or ()}
        properties |= spoken(frame, east, north)
        title = f"source {row['ident']} ({row['state']})"
        yield (
            {"type": "Point", "coordinates": lon_lat(frame, east, north)},
            {"kind": "source", "name": title, **properties},
        )
        cov = np.array([[row["cov_ee_m2"], row["cov_en_m2"]], [row["cov_en_m2"], row["cov_nn_m2"]]])
        if np.all(np.isfinite(cov)):
            ring = region_90(frame, east, north, cov)
            about = {"kind": "source region", "name": f"{title}, 90 %", "ident": int(row["ident"])}
            yield {"type": "Polygon", "coordinates": [ring]}, about


def region_90(frame: FieldFrame, east_m: float, north_m: float, cov_m2: np.ndarray) -> list[list[float]]:
    """The ellipse that holds 90 % of a plane normal, as a closed ring of longitudes and latitudes."""
    variances, axes = np.linalg.eigh(cov_m2)
    turn = np.linspace(0.0, 2.0 * math.pi, 37)
    half_axes_m = ELLIPSE_90 * np.sqrt(np.maximum(variances, 1e-6))
    circle = np.stack([np.cos(turn), np.sin(turn)]) * half_axes_m[:, None]
    ring = [lon_lat(frame, east_m + de, north_m + dn) for de, dn in (axes @ circle).T]
    ring[-1] = ring[0]
    return ring


def _cells(frame: FieldFrame, rows: np.ndarray | None) -> Iterator[Shape]:
    """The likely cells of the last belief."""
    if rows is None or not len(rows):
        return
    last = rows[rows["t_ns"] == rows["t_ns"].max()]
    order = np.argsort(-last["p"])
    share = np.cumsum(last["p"][order]) / max(float(last["p"].sum()), 1e-300)
    step = float(np.min(np.diff(np.unique(last["east_m"])), initial=np.inf)) / 2
    for row in last[order[: int(np.searchsorted(share, MASS)) + 1]]:
        east, north = float(row["east_m"]), float(row["north_m"])
        corners = ((-step, -step), (step, -step), (step, step), (-step, step), (-step, -step))
        ring = [lon_lat(frame, east + de, north + dn) for de, dn in corners]
        about = {"kind": "belief", "name": f"{row['p']:.3g}", "p": float(row["p"]), "t_ns": int(row["t_ns"])}
        yield {"type": "Polygon", "coordinates": [ring]}, about


def by_robot(poses: np.ndarray | None) -> Iterator[tuple[str, np.ndarray]]:
    """Each robot's track, in order of time."""
    if poses is None:
        return
    for robot in np.unique(poses["robot"]):
        track = poses[poses["robot"] == robot]
        yield str(robot), track[np.argsort(track["t_ns"], kind="stable")]


def lon_lat(frame: FieldFrame, east_m: float, north_m: float) -> list[float]:
    """A place as GeoJSON writes it."""
    lat, lon, _ = frame.to_geodetic(east_m, north_m)
    return [round(lon, 9), round(lat, 9)]


def spoken(frame: FieldFrame, east_m: float, north_m: float) -> dict[str, str]:
    """A place in the words of other maps."""
    lat_deg, lon_deg, _ = frame.to_geodetic(east_m, north_m)
    return asdict(coordinates(lat_deg, lon_deg))


def plain(properties: dict[str, Any]) -> dict[str, Any]:
    """Without numbers JSON has no word for."""
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in properties.items()}


def iso(t_ns: int) -> str:
    """UTC to the millisecond, as GPX, KML and GeoJSON's users write it."""
    seconds, rest = divmod(t_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest // 1_000_000:03d}Z"
