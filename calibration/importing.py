"""Other logs as our readings CSV: a table under other names, or a mission with a known transmitter."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calibration.table import COLUMNS, read_table
from fieldkit.errors import DataError

_CELL_M = 0.5
"""Robots on the move: readings within one cell of this size count as one place."""


def csv_from_table(path: Path, names: Mapping[str, str], where: Mapping[str, str]) -> str:
    """A CSV of ours from one under other names; columns we have no use for are left out."""
    table = read_table(path, names=names, where=where)
    known = [name for name in COLUMNS if name in table.columns]
    if "rss_dbm" not in known:
        raise DataError(
            f"{path}: no column of readings; map yours: --column rss_dbm=NAME; there are "
            f"{', '.join(table.others)}"
        )
    rows = list(zip(*(table.columns[name] for name in known), strict=True))
    return _text(known, rows)


def csv_from_recording(path: Path, east_m: float, north_m: float) -> str:
    """Readings of a mission whose only transmitter stood at (east_m, north_m) in the field's frame.

    A robot that listened while another heard is a missed packet. What nobody heard is in no recording, so
    keep one robot near the transmitter to have every packet counted.
    """
    from fieldkit.recording import open_recording

    recording = open_recording(path)
    rows: list[tuple[str, ...]] = []
    for number, (_, _, detection) in enumerate(recording.detections()):
        for robot, (east, north), heading, rss in zip(
            detection.robots, detection.position_m, detection.heading_deg, detection.rss_dbm, strict=True
        ):
            distance = float(np.hypot(east - east_m, north - north_m))
            bearing = np.degrees(np.arctan2(east_m - east, north_m - north)) - heading
            place = f"{robot} {np.floor(east / _CELL_M):.0f} {np.floor(north / _CELL_M):.0f}"
            rows.append(
                (
                    place,
                    f"{max(distance, 1e-3):.4f}",
                    f"{bearing % 360.0:.1f}",
                    robot,
                    str(number),
                    f"{detection.t_ns * 1e-9:.3f}",
                    "" if np.isnan(rss) else f"{rss:g}",
                )
            )
    if not rows:
        raise DataError(f"{path}: the recording has no detection, so there is nothing to calibrate with")
    return _text(["place", "distance_m", "heading_deg", "receiver", "sample", "time", "rss_dbm"], rows)


def _text(header: list[str], rows: list[tuple[str, ...]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()
