"""`fieldkit survey`: where transmitters are, from any log of readings and any log of positions."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from drivers.positions.readings import Heard
from drivers.positions.sanity import looked_at
from drivers.positions.source import poses_of
from drivers.positions.tracks import Track
from fieldkit import settings as given
from fieldkit.channel.antenna_file import Receiver
from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread, assumed
from fieldkit.engine.association.packets import PacketLog, packets_of
from fieldkit.engine.location import survey as engine
from fieldkit.engine.location.ground import Ground, polygon
from fieldkit.engine.location.one_source import Radio
from fieldkit.engine.location.survey import Found
from fieldkit.errors import DataError
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, RssReading, SourceEstimate

Progress = Callable[[float], None]


@dataclass(frozen=True, slots=True)
class Settings:
    """How a survey is evaluated."""

    antenna: Antenna
    margin_m: float | None = None
    """The field reaches this far beyond the positions; None: as far as the path is wide, and no less than 20 m."""
    cell_m: float | None = None
    """Of the regions' outlines; None: as fine as the posterior needs."""
    power_levels_db: tuple[float, ...] = ()
    """Powers above the calibrated transmitter's, where they are known; empty: unknown."""
    rate_hz: float = given.RATE_HZ.default
    expected: float = 1.0
    window_s: float = given.WINDOW_S.default
    max_gap_s: float = given.SURVEY_GAP_S
    shift_s: float = 0.0
    """Added to the readings' times, where two clocks disagree."""
    sigma_m: float | None = None
    """Standard deviation of the positions; None: what the log says, in the middle."""
    spread: ChannelSpread | None = None
    """What readings have in common; None: assumed, and said so."""
    receivers: dict[str, Receiver] = field(default_factory=dict)
    """Each radio's own offset."""
    power_sd_db: float | None = None
    """How far the source's power may be from the calibrated ones'; None: unknown unless transmitters were compared."""
    source_up_m: float = 0.0
    """Height of the sources, in the frame of the positions' heights."""
    identity: bool = False
    """Whether each name in `frame_id` is one source."""
    found_within_m: float | None = None
    found_probability: float = given.FOUND_PROBABILITY.default


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
    found: list[Found] = field(default_factory=list)
    """Of each source its posterior and what is said of it."""
    notes: list[str] = field(default_factory=list)
    """What was left out, assumed or odd."""
    found_within_m: float = 0.0


def evaluate(
    heard: list[Heard], track: Track, settings: Settings, progress: Progress = lambda _: None
) -> Result:
    """The sources behind the whole log. Raises `DataError` where readings and positions do not meet."""
    track = looked_at(track)
    notes = list(track.notes)
    frame = _frame(track) if track.geodetic else None
    poses = poses_of(track, frame or FieldFrame(0.0, 0.0))
    shift_ns = round(settings.shift_s * 1e9)
    heard = [replace(item, t_ns=item.t_ns + shift_ns) for item in heard]
    _check_meet(heard, poses, track)
    readings = [item for item in heard if isinstance(item, RssReading)]
    if settings.spread is None:
        notes.append(assumed(settings.antenna).assumed)
    log = packets_of(
        readings,
        poses,
        window_s=settings.window_s,
        max_gap_s=settings.max_gap_s,
        offsets_db={name: radio.offset_db for name, radio in settings.receivers.items()},
    )
    notes += log.notes
    margin_m = settings.margin_m
    if margin_m is None:
        across = max(np.ptp([pose.east_m for pose in poses]), np.ptp([pose.north_m for pose in poses]))
        margin_m = max(20.0, float(across) * 0.6)
    ground = _borders(poses, margin_m)
    sigma_m = settings.sigma_m or float(np.median([pose.sigma_m for pose in poses]))
    if settings.identity and log.packets.count and not any(log.names):
        raise DataError("known senders were asked for (--identity address), and no reading carries a name")
    radio = engine.radio_of(
        settings.antenna,
        settings.spread,
        power_levels_db=settings.power_levels_db,
        power_sd_db=settings.power_sd_db,
        source_up_m=settings.source_up_m,
        place_sigma_m=sigma_m,
    )
    within_m = settings.found_within_m or engine.found_within_m(settings.antenna, ground)
    found = engine.sources_of(
        log, radio, ground, engine.Rules(within_m, settings.found_probability, settings.identity), progress
    )
    notes += _clock_notes(found, log, readings, poses, radio, ground, settings)
    return Result(
        sources=[each.estimate for each in found],
        frame=frame,
        readings=len(readings),
        detections=log.packets.count,
        without_place=log.without_place,
        duration_s=(heard[-1].t_ns - heard[0].t_ns) * 1e-9,
        field_m=ground,
        found=found,
        notes=notes,
        found_within_m=within_m,
    )


SHIFTS_S = (-7200.0, -3600.0, -60.0, -30.0, -10.0, -5.0, 5.0, 10.0, 30.0, 60.0, 3600.0, 7200.0)
"""By how much clocks of two logs are usually apart: hours by time zones, seconds by nobody having set them."""
CLEARLY_NATS = 12.0


def _clock_notes(
    found: list[Found],
    log: PacketLog,
    readings: list[RssReading],
    poses: list[Pose],
    radio: Radio,
    ground: Ground,
    settings: Settings,
) -> list[str]:
    """A warning where shifting the readings makes one source fit much better."""
    if len(found) != 1 or log.packets.count < 15:
        return []
    # A reading each: other clocks may give other readings a place.
    count = log.packets.count
    as_is = engine.evidence(log.packets, radio, ground) / count
    best_s, best = 0.0, as_is + CLEARLY_NATS / count
    for shift_s in SHIFTS_S:
        moved = [replace(each, t_ns=each.t_ns + round(shift_s * 1e9)) for each in readings]
        other = packets_of(moved, poses, window_s=settings.window_s, max_gap_s=settings.max_gap_s)
        if other.packets.packet.size < log.packets.packet.size:
            continue
        score = engine.evidence(other.packets, radio, ground) / other.packets.count
        if score > best:
            best_s, best = shift_s, score
    if best_s == 0.0:
        return []
    return [
        f"the readings fit one source much better {best_s:+.0f} s later (by {(best - as_is) * count:.0f} nats): the "
        f"clocks of the two logs may disagree; check them, or give --shift-s {best_s:.0f}"
    ]


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


def as_json(result: Result) -> dict[str, Any]:
    """Plain values, for printing."""
    return {
        "readings": result.readings,
        "detections": result.detections,
        "readings_without_place": result.without_place,
        "duration_s": round(result.duration_s, 3),
        "field_m": [round(each, 2) for each in result.field_m],
        "found_within_m": round(result.found_within_m, 2),
        "origin_deg": None
        if result.frame is None
        else [result.frame.origin_lat_deg, result.frame.origin_lon_deg],
        "notes": result.notes,
        "candidates": [_candidate(each, result.frame) for each in result.found],
    }


def _candidate(found: Found, frame: FieldFrame | None) -> dict[str, Any]:
    source = found.estimate
    spread_m = math.sqrt(max(0.0, float(np.trace(source.cov_m2)) / 2))
    plain: dict[str, Any] = {
        "ident": source.ident,
        "name": found.name,
        "state": source.state,
        "east_m": round(source.east_m, 2),
        "north_m": round(source.north_m, 2),
        "sigma_m": round(spread_m, 2),
        "cov_m2": [[round(float(v), 3) for v in row] for row in source.cov_m2],
        "p_exists": round(source.p_exists, 4),
        "p_here": round(source.p_here, 4),
        "receptions": round(source.receptions, 1),
        "places": found.places,
        "rate_hz": round(source.rate_hz, 4),
        "power_db": round(source.power_db, 1),
        "fit": round(found.fit, 2),
        "note": source.note,
        "region_50": _rounded(polygon(found.posterior, 0.5)),
        "region_90": _rounded(polygon(found.posterior, 0.9)),
        "region_90_area_m2": round(source.region_90 * found.posterior.cell_m**2, 2),
    }
    if frame is not None:
        lat, lon, _ = frame.to_geodetic(source.east_m, source.north_m)
        plain |= {"lat_deg": round(lat, 7), "lon_deg": round(lon, 7)}
    return plain


def _rounded(rings: list[list[list[float]]]) -> list[list[list[float]]]:
    return [[[round(v, 3) for v in corner] for corner in ring] for ring in rings]


def as_geojson(result: Result, track: Track) -> dict[str, Any]:
    """Candidates, their 90 % regions and the path walked as GeoJSON (RFC 7946).

    Raises `DataError` without latitude and longitude.
    """
    if result.frame is None:
        raise DataError("GeoJSON needs latitude and longitude, and the positions have only east and north")
    features = []
    for each in as_json(result)["candidates"]:
        place = [each.pop("lon_deg"), each.pop("lat_deg")]
        rings = [[_degrees(corner, result.frame) for corner in ring] for ring in each.pop("region_90")]
        del each["region_50"]
        features.append(
            {"type": "Feature", "geometry": {"type": "Point", "coordinates": place}, "properties": each}
        )
        # Each outline and each hole as a polygon of its own: a hole's own direction marks it (RFC 7946, 3.1.6).
        features.append(
            {
                "type": "Feature",
                "geometry": {"type": "MultiPolygon", "coordinates": _with_holes(rings)},
                "properties": {"ident": each["ident"], "region": 0.9},
            }
        )
    for robot in sorted({spot.robot for spot in track.spots}):
        path = [[spot.second, spot.first] for spot in track.spots if spot.robot == robot]
        line = {"type": "LineString", "coordinates": path if len(path) > 1 else path * 2}
        features.append({"type": "Feature", "geometry": line, "properties": {"robot": robot}})
    return {"type": "FeatureCollection", "features": features}


def _degrees(corner: list[float], frame: FieldFrame) -> list[float]:
    lat, lon, _ = frame.to_geodetic(*corner)
    return [round(lon, 7), round(lat, 7)]


def _with_holes(rings: list[list[list[float]]]) -> list[list[list[list[float]]]]:
    """Rings as polygons: a clockwise one is a hole of the smallest outline that holds its first corner."""
    outlines = [[ring] for ring in rings if _area(ring) > 0.0]
    for hole in (ring for ring in rings if _area(ring) <= 0.0):
        around = [each for each in outlines if _inside(hole[0], each[0])]
        if around:
            min(around, key=lambda each: _area(each[0])).append(hole)
    return outlines


def _area(ring: list[list[float]]) -> float:
    x, y = np.array(ring).T
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _inside(corner: list[float], ring: list[list[float]]) -> bool:
    """Even-odd rule; rings run along cell edges, so a corner of a hole is never on an outline that holds it."""
    x, y = np.array(ring).T
    crosses = (y[:-1] > corner[1]) != (y[1:] > corner[1])
    at = x[:-1] + (corner[1] - y[:-1]) * (x[1:] - x[:-1]) / np.where(y[1:] == y[:-1], 1.0, y[1:] - y[:-1])
    return bool((crosses & (at > corner[0])).sum() % 2)
