"""Other logs as our readings CSV: a table under other names, a recording, or a report of ours."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.clocks import Track, estimate_offset
from calibration.collect_log import places_of
from calibration.collection import to_csv
from calibration.embedded import readings_in
from calibration.table import COLUMNS, Table, as_csv, read_table
from fieldkit.errors import ConfigError, DataError
from fieldkit.messages import Detection, Pose
from fieldkit.recording import Recording

_CELL_M = 0.5
"""Robots on the move: readings within one cell of this size count as one place."""
_HEADER = ["place", "distance_m", "heading_deg", "receiver", "sample", "time", "rss_dbm"]
LONELY_SHARE = 0.2


def csv_from_table(
    path: Path, names: Mapping[str, str], where: Mapping[str, str], *, negate: bool = False
) -> str:
    """A CSV of ours from one under other names; columns we have no use for are left out."""
    table = read_table(path, names=names, where=where)
    need_readings(table)
    known = [name for name in COLUMNS if name in table.columns]
    columns = dict(table.columns)
    if negate:
        columns["rss_dbm"] = [text and f"{-float(text):g}" for text in columns["rss_dbm"]]
    return as_csv(known, list(zip(*(columns[name] for name in known), strict=True)))


def need_readings(table: Table) -> None:
    """Raise where a table has no readings at all."""
    if "rss_dbm" not in table.columns:
        raise DataError(
            f"{table.path}: no column of readings; map yours: --column rss_dbm=NAME; there are "
            f"{', '.join(table.others)}"
        )
    if not len(table):
        raise DataError(f"{table.path}: has a header and no rows; were any readings logged?")


def csv_from_report(path: Path) -> str:
    """The readings a calibration report carries; of a mission's report, those of the recording beside it."""
    text = readings_in(path)
    if text is not None:
        return text
    beside = path.with_name("mission.mcap")
    if beside.exists():
        return csv_from_recording(beside)[0]
    raise DataError(
        f"{path}: carries no readings and no mission.mcap is beside it; import the recording or the CSV it "
        "was made from"
    )


def csv_from_recording(
    path: Path, source_m: tuple[float, float] | None = None, clock_offset_s: float | None = None
) -> tuple[str, list[str]]:
    """Readings of a recording, and what is inconsistent about them, in words.

    Of a collection: the places as they were counted. Of a mission: what robots heard of its only transmitter,
    at `source_m` (east, north) or where the recording's metadata say ("truth"). A robot that listened while
    another heard is a missed packet; what nobody heard is in no recording. `clock_offset_s` is added to the
    readings' times before their positions are looked up in the poses.
    """
    from fieldkit.recording import open_recording

    recording = open_recording(path)
    if places := places_of(recording):
        return to_csv(places), []
    source = np.array(source_m if source_m is not None else _only_source(recording))
    detections = [detection for _, _, detection in recording.detections()]
    if not detections:
        raise DataError(f"{path}: the recording has no detection, so there is nothing to calibrate with")
    tracks = _tracks(recording)
    notes = _lonely(detections) + (
        [] if clock_offset_s is not None else _clock_notes(detections, tracks, source)
    )
    rows = [
        row
        for number, detection in enumerate(detections)
        for row in _rows(number, detection, tracks, source, clock_offset_s)
    ]
    return as_csv(_HEADER, rows), notes


def _only_source(recording: Recording) -> tuple[float, float]:
    """Where the recording's own metadata put its only transmitter."""
    truth = recording.metadata.get("truth")
    try:
        places = [(float(one["east_m"]), float(one["north_m"])) for one in truth or ()]
    except (KeyError, TypeError, ValueError):
        places = []
    if len(places) == 1:
        return places[0]
    if len(places) > 1:
        raise DataError(
            f"{recording.path}: had {len(places)} transmitters, and readings do not say whose they are: calibrate "
            "with one transmitter alone"
        )
    raise ConfigError(
        f"{recording.path}: does not say where its transmitter stood; give --source EAST NORTH in metres"
    )


def _tracks(recording: Recording) -> dict[str, Track]:
    poses: dict[str, list[Pose]] = {}
    for _, _, event in recording.events():
        if isinstance(event, Pose):
            poses.setdefault(event.robot, []).append(event)
    return {
        robot: Track(
            np.array([pose.t_ns * 1e-9 for pose in each]),
            np.array([(pose.east_m, pose.north_m) for pose in each]),
        )
        for robot, each in poses.items()
    }


def _rows(
    number: int,
    detection: Detection,
    tracks: Mapping[str, Track],
    source: np.ndarray,
    clock_offset_s: float | None,
) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for robot, place, heading, rss in zip(
        detection.robots, detection.position_m, detection.heading_deg, detection.rss_dbm, strict=True
    ):
        t_s = detection.t_ns * 1e-9
        if clock_offset_s is not None and robot in tracks:
            place = tracks[robot].at(np.array([t_s + clock_offset_s]))[0]
        east, north = source - place
        bearing = np.degrees(np.arctan2(east, north)) - heading
        cell = np.floor(place / _CELL_M)
        rows.append(
            (
                f"{robot} {cell[0]:.0f} {cell[1]:.0f}",
                f"{max(float(np.hypot(east, north)), 1e-3):.4f}",
                f"{bearing % 360.0:.1f}",
                robot,
                str(number),
                f"{t_s:.3f}",
                "" if np.isnan(rss) else f"{rss:g}",
            )
        )
    return rows


def _lonely(detections: list[Detection]) -> list[str]:
    """Packets that one robot alone heard: as likely there are some that none did, and they are nowhere."""
    share = float(np.mean([detection.heard.sum() < 2 for detection in detections]))
    if share <= LONELY_SHARE:
        return []
    return [
        f"{share:.0%} of the packets were heard by one robot alone, so some were surely heard by none and are "
        "missing here: keep one robot near the transmitter"
    ]


def _clock_notes(detections: list[Detection], tracks: Mapping[str, Track], source: np.ndarray) -> list[str]:
    names = sorted(tracks)
    heard: list[tuple[float, float, int]] = [
        (detection.t_ns * 1e-9, float(rss), names.index(robot))
        for detection in detections
        for robot, rss in zip(detection.robots, detection.rss_dbm, strict=True)
        if robot in tracks
    ]
    if not heard:
        return []
    t_s, rss_dbm, who = (np.array(column) for column in zip(*heard, strict=True))
    found = estimate_offset(t_s, rss_dbm, who, {names.index(r): track for r, track in tracks.items()}, source)
    return [] if found is None else [found.warning().replace("--positions and ", "")]
