"""`fieldkit survey`: where transmitters are, from any log of readings and any log of positions."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.positions.readings import Heard
from drivers.positions.source import poses_of
from drivers.positions.tracks import Track
from fieldkit.channel.model import Antenna
from fieldkit.engine.association.detections import Associator
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import DataError
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, ReceiverState, RssReading, SourceEstimate

STEP_NS = 1_000_000_000
CELLS = 80
"""Cells along the longer side where no cell size is given."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How a survey is evaluated."""

    antenna: Antenna
    margin_m: float = 20.0
    """The field reaches this far beyond the positions."""
    cell_m: float | None = None
    power_levels_db: tuple[float, ...] = (0.0,)
    rate_hz: float = 0.05
    expected: float = 1.0
    window_s: float = 0.1
    max_gap_s: float = 5.0
    """Between positions further apart in time than this nobody knows where the radio was."""
    shift_s: float = 0.0
    """Added to the readings' times, where two clocks disagree."""
    sigma_m: float | None = None
    """Standard deviation of the positions; None: what the log says, in the middle."""


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What a survey found. Sources are in the frame of the positions, east and north of `frame`'s origin."""

    sources: list[SourceEstimate]
    frame: FieldFrame | None
    """Where the positions had latitude and longitude: the frame of all east and north here."""
    readings: int
    detections: int
    without_place: int
    """Readings at moments for which no position is known."""
    duration_s: float
    field_m: tuple[float, float, float, float]
    """West, south, east, north border of the field looked at."""


def evaluate(heard: list[Heard], track: Track, settings: Settings) -> Result:
    """Build the belief over the whole log. Raises `DataError` where readings and positions do not meet."""
    frame = _frame(track) if track.geodetic else None
    poses = poses_of(track, frame or FieldFrame(0.0, 0.0))
    shift_ns = round(settings.shift_s * 1e9)
    heard = [replace(item, t_ns=item.t_ns + shift_ns) for item in heard]
    _check_meet(heard, poses, track)
    west, south, east, north = _borders(poses, settings.margin_m)
    # The engine's field begins at 0, 0.
    poses = [replace(pose, east_m=pose.east_m - west, north_m=pose.north_m - south) for pose in poses]
    robots = tuple(sorted({pose.robot for pose in poses}))
    size = (east - west, north - south)
    engine = EngineSettings(
        grid=Grid(*size, settings.cell_m or max(size) / CELLS),
        antenna=settings.antenna,
        teams=tuple((robot,) for robot in robots),
        power_levels_db=settings.power_levels_db,
        reference_rate_hz=settings.rate_hz,
        expected_sources=settings.expected,
        pose_sigma_m=settings.sigma_m or float(np.median([pose.sigma_m for pose in poses])),
    )
    belief, detections = _belief(heard, poses, robots, engine, settings)
    readings = [item for item in heard if isinstance(item, RssReading)]
    return Result(
        sources=[_moved(each, west, south) for each in belief.sources()],
        frame=frame,
        readings=len(readings),
        detections=detections,
        without_place=_without_place(readings, poses, settings),
        duration_s=(heard[-1].t_ns - heard[0].t_ns) * 1e-9,
        field_m=(west, south, east, north),
    )


def _belief(
    heard: list[Heard], poses: list[Pose], robots: tuple[str, ...], engine: EngineSettings, settings: Settings
) -> tuple[IntensityBelief, int]:
    belief = IntensityBelief(engine)
    associator = Associator(
        robots,
        window_s=settings.window_s,
        lateness_s=max(1.0, settings.max_gap_s),
        max_pose_gap_s=settings.max_gap_s,
    )
    detected = 0
    events: list[Heard | Pose] = sorted([*poses, *heard], key=lambda event: event.t_ns)
    end_ns = events[-1].t_ns + round((settings.max_gap_s + settings.window_s + 2.0) * 1e9)
    next_ns = events[0].t_ns
    for event in (*events, None):
        t_ns = end_ns if event is None else event.t_ns
        if t_ns >= next_ns or event is None:
            detections, stretches = associator.advance(t_ns)
            for stretch in stretches:
                belief.listen(stretch)
            for detection in detections:
                belief.detect(detection)
            detected += len(detections)
            next_ns = t_ns + STEP_NS
        if isinstance(event, Pose):
            associator.pose(event)
        elif isinstance(event, RssReading):
            associator.reading(event)
        elif isinstance(event, ReceiverState):
            associator.receiver(event)
    return belief, detected


def _frame(track: Track) -> FieldFrame:
    """The frame whose origin is the positions' south-west corner."""
    return FieldFrame(min(spot.first for spot in track.spots), min(spot.second for spot in track.spots))


def _check_meet(heard: list[Heard], poses: list[Pose], track: Track) -> None:
    first, last = heard[0].t_ns, heard[-1].t_ns
    if last < poses[0].t_ns or first > poses[-1].t_ns:
        apart_s = (poses[0].t_ns - first) * 1e-9
        raise DataError(
            f"{track.path}: readings and positions do not overlap in time; the positions begin {apart_s:+.0f} s "
            "after the readings. If the clocks disagree give --shift-s (an hour is 3600)"
        )
    names = {item.robot for item in heard}
    if not names & {pose.robot for pose in poses}:
        raise DataError(
            f"readings are of {', '.join(sorted(names))}, positions of "
            f"{', '.join(sorted({pose.robot for pose in poses}))}: no robot has both"
        )


def _borders(poses: list[Pose], margin_m: float) -> tuple[float, float, float, float]:
    east = [pose.east_m for pose in poses]
    north = [pose.north_m for pose in poses]
    return min(east) - margin_m, min(north) - margin_m, max(east) + margin_m, max(north) + margin_m


def _without_place(readings: list[RssReading], poses: list[Pose], settings: Settings) -> int:
    times: dict[str, Any] = {}
    for robot in {pose.robot for pose in poses}:
        times[robot] = np.array([pose.t_ns for pose in poses if pose.robot == robot])
    lost = 0
    for reading in readings:
        known = times.get(reading.robot)
        lost += known is None or int(np.abs(known - reading.t_ns).min()) > settings.max_gap_s * 0.5e9
    return lost


def _moved(source: SourceEstimate, east_m: float, north_m: float) -> SourceEstimate:
    return replace(source, east_m=source.east_m + east_m, north_m=source.north_m + north_m)


def as_json(result: Result) -> dict[str, Any]:
    """Plain values, for printing."""
    return {
        "readings": result.readings,
        "detections": result.detections,
        "readings_without_place": result.without_place,
        "duration_s": round(result.duration_s, 3),
        "field_m": [round(each, 2) for each in result.field_m],
        "origin_deg": None
        if result.frame is None
        else [result.frame.origin_lat_deg, result.frame.origin_lon_deg],
        "candidates": [_candidate(each, result.frame) for each in result.sources],
    }


def _candidate(source: SourceEstimate, frame: FieldFrame | None) -> dict[str, Any]:
    spread_m = math.sqrt(max(0.0, float(np.trace(source.cov_m2)) / 2))
    plain: dict[str, Any] = {
        "ident": source.ident,
        "state": source.state,
        "east_m": round(source.east_m, 2),
        "north_m": round(source.north_m, 2),
        "sigma_m": round(spread_m, 2),
        "p_exists": round(source.p_exists, 4),
        "receptions": round(source.receptions, 1),
        "rate_hz": round(source.rate_hz, 4),
        "note": source.note,
    }
    if frame is not None:
        lat, lon, _ = frame.to_geodetic(source.east_m, source.north_m)
        plain |= {"lat_deg": round(lat, 7), "lon_deg": round(lon, 7)}
    return plain


def as_geojson(result: Result, track: Track) -> dict[str, Any]:
    """Candidates and the path walked as GeoJSON (RFC 7946). Raises `DataError` without latitude and longitude."""
    if result.frame is None:
        raise DataError("GeoJSON needs latitude and longitude, and the positions have only east and north")
    features = []
    for each in as_json(result)["candidates"]:
        place = [each.pop("lon_deg"), each.pop("lat_deg")]
        features.append(
            {"type": "Feature", "geometry": {"type": "Point", "coordinates": place}, "properties": each}
        )
    for robot in sorted({spot.robot for spot in track.spots}):
        path = [[spot.second, spot.first] for spot in track.spots if spot.robot == robot]
        line = {"type": "LineString", "coordinates": path if len(path) > 1 else path * 2}
        features.append({"type": "Feature", "geometry": line, "properties": {"robot": robot}})
    return {"type": "FeatureCollection", "features": features}
