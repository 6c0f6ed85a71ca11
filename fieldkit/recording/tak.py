"""A recording as a data package for ATAK, WinTAK and iTAK: sources and where everybody was last."""

from collections.abc import Mapping

import numpy as np

from fieldkit.geo import FieldFrame
from fieldkit.recording import cot
from fieldkit.recording.cot import Marker
from fieldkit.recording.shapes import by_robot, last_estimates, lon_lat
from fieldkit.settings import ELLIPSE_90

LASTS_S = 365 * 86_400.0
"""What stands in a package is not old until somebody deletes it."""


def tak_package(frame: FieldFrame, tables: Mapping[str, np.ndarray], name: str) -> bytes:
    """The package. Of sources that do not fit the model, or were taken away, no position is claimed."""
    rows = last_estimates(tables.get("sources"))
    markers = [_source(frame, row, name) for row in rows if row["state"] in ("found", "candidate")]
    markers += [_robot(frame, robot, track[-1], name) for robot, track in by_robot(tables.get("poses"))]
    return cot.data_package(name, markers)


def _source(frame: FieldFrame, row: np.void, name: str) -> Marker:
    cov = np.array([[row["cov_ee_m2"], row["cov_en_m2"]], [row["cov_en_m2"], row["cov_nn_m2"]]])
    error_m = None
    if np.all(np.isfinite(cov)):
        error_m = float(ELLIPSE_90 * np.sqrt(max(float(np.linalg.eigvalsh(cov)[-1]), 0.0)))
    said = f"{row['state']}, {row['receptions']:.0f} receptions"
    uid, title = f"source-{row['ident']}", f"source {row['ident']}"
    return _marker(frame, row, name, uid, (cot.UNKNOWN_GROUND, cot.FUSED), error_m, title, said)


def _robot(frame: FieldFrame, robot: str, row: np.void, name: str) -> Marker:
    error_m = float(ELLIPSE_90 * row["sigma_m"])
    uid = f"robot-{robot.replace(' ', '-')}"
    kind = (cot.FRIEND_GROUND, cot.BY_SATELLITE)
    return _marker(frame, row, name, uid, kind, error_m, robot, "last position")


def _marker(
    frame: FieldFrame,
    row: np.void,
    name: str,
    uid: str,
    kind: tuple[str, str],
    error_m: float | None,
    title: str,
    said: str,
) -> Marker:
    lon, lat = lon_lat(frame, float(row["east_m"]), float(row["north_m"]))
    t_ns = int(row["t_ns"])
    uid = f"fieldkit-{name}-{t_ns // 1_000_000_000}-{uid}"
    return Marker(uid, *kind, lat, lon, error_m, title, said, t_ns, LASTS_S)
