"""The present of a mission as GeoJSON (RFC 7946): sources with their 90 % region, robots and people, marks."""

from typing import Any

import numpy as np

from fieldkit.messages import SourceEstimate
from fieldkit.recording.shapes import iso, lon_lat, plain, region_90, spoken
from fieldkit.settings import ELLIPSE_90
from mission.maps.present import Present


def collection(present: Present) -> dict[str, Any]:
    """A FeatureCollection, JSON-ready."""
    features = [
        {"type": "Feature", "id": properties["id"], "geometry": shape, "properties": plain(properties)}
        for shape, properties in [*_sources(present), *_robots(present), *_marks(present)]
    ]
    return {
        "type": "FeatureCollection",
        "name": present.name,
        "time": iso(present.t_ns),
        "features": features,
    }


def error_90_m(source: SourceEstimate) -> float:
    """Radius of a circle that holds 90 % of a source's region and more: the ellipse's longer half axis."""
    return float(ELLIPSE_90 * np.sqrt(max(float(np.linalg.eigvalsh(source.cov_m2)[-1]), 0.0)))


Shape = tuple[dict[str, Any], dict[str, Any]]


def _sources(present: Present) -> list[Shape]:
    shapes: list[Shape] = []
    for source in present.sources:
        about = {
            "kind": "source",
            "name": f"source {source.ident} ({source.state})",
            "ident": source.ident,
            "state": source.state,
            "p_here": round(source.p_here, 4),
            "error_90_m": round(error_90_m(source), 2),
            "receptions": round(source.receptions, 1),
            "rate_hz": round(source.rate_hz, 5),
            "power_db": round(source.power_db, 2),
            "sender": source.name,
            "time": iso(present.t_ns),
        }
        where = (source.east_m, source.north_m)
        point = {"type": "Point", "coordinates": lon_lat(present.frame, *where)}
        shapes.append((point, {"id": f"source-{source.ident}", **about, **spoken(present.frame, *where)}))
        if np.all(np.isfinite(source.cov_m2)):
            ring = region_90(present.frame, *where, source.cov_m2)
            name = f"source {source.ident}, 90 %"
            region = {
                "id": f"region-{source.ident}",
                "kind": "source region",
                "name": name,
                "ident": source.ident,
            }
            shapes.append(({"type": "Polygon", "coordinates": [ring]}, region))
    return shapes


def _robots(present: Present) -> list[Shape]:
    return [
        (
            {"type": "Point", "coordinates": lon_lat(present.frame, pose.east_m, pose.north_m)},
            {
                "id": f"robot-{pose.robot}",
                "kind": "person" if pose.robot in present.on_foot else "robot",
                "name": pose.robot,
                "heading_deg": round(pose.heading_deg, 1),
                "sigma_m": round(pose.sigma_m, 2),
                "time": iso(pose.t_ns),
            },
        )
        for pose in present.poses
    ]


def _marks(present: Present) -> list[Shape]:
    return [
        (
            {"type": "Point", "coordinates": lon_lat(present.frame, mark.east_m, mark.north_m)},
            {
                "id": f"mark-{mark.number}",
                "kind": "mark",
                "name": f"{mark.by}: here",
                "time": iso(mark.t_ns),
                **spoken(present.frame, mark.east_m, mark.north_m),
            },
        )
        for mark in present.marks
    ]
