"""What other people's viewers show: Foxglove's protobuf messages by their exact names.

Written in addition to our own topics and never read back by replay. The scene is in the frame `field`:
x east, y north, z up, metres from the field's south-west corner.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp

from fieldkit.geo import FieldFrame
from fieldkit.messages import FloatArray, Pose, SourceEstimate

FRAME = "field"
_LEVELS = {"debug": Log.DEBUG, "info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}
_COLOURS = {
    "found": (0.1, 0.6, 0.2),
    "candidate": (0.95, 0.6, 0.1),
    "inconsistent": (0.6, 0.6, 0.6),
    "outside": (0.3, 0.5, 0.8),
    "removed": (0.4, 0.4, 0.5),
}


PLACE_STEP_M, TURN_STEP, ANGLE_STEP_DEG = 2.0**-10, 2.0**-14, 2.0**-26
"""What viewers are shown is rounded to about a millimetre, in powers of two: the zeros at the end compress well."""


def stamp(t_ns: int) -> Timestamp:
    """Nanoseconds as protobuf's time stamp."""
    return Timestamp(seconds=t_ns // 1_000_000_000, nanos=t_ns % 1_000_000_000)


def pose_in_frame(pose: Pose) -> PoseInFrame:
    """A robot's pose. Viewers measure yaw counter-clockwise from east."""
    message = PoseInFrame(timestamp=stamp(pose.t_ns), frame_id=FRAME)
    _place(message.pose, pose.east_m, pose.north_m, pose.up_m, pose.heading_deg)
    return message


def transform(pose: Pose) -> FrameTransform:
    """The robot's own frame (x ahead) under `field`, so that viewers can follow it."""
    message = FrameTransform(timestamp=stamp(pose.t_ns), parent_frame_id=FRAME, child_frame_id=pose.robot)
    place = message.translation
    place.x, place.y, place.z = (_rounded(m, PLACE_STEP_M) for m in (pose.east_m, pose.north_m, pose.up_m))
    message.rotation.z, message.rotation.w = _turn(pose.heading_deg)
    return message


def location_fix(pose: Pose, frame: FieldFrame) -> LocationFix:
    """A robot's pose as latitude and longitude, for the map."""
    latitude, longitude, altitude = frame.to_geodetic(pose.east_m, pose.north_m, pose.up_m)
    variance = pose.sigma_m**2
    return LocationFix(
        timestamp=stamp(pose.t_ns),
        frame_id=pose.robot,
        latitude=_rounded(latitude, ANGLE_STEP_DEG),
        longitude=_rounded(longitude, ANGLE_STEP_DEG),
        altitude=_rounded(altitude, PLACE_STEP_M),
        position_covariance=[variance, 0, 0, 0, variance, 0, 0, 0, variance],
        position_covariance_type=LocationFix.DIAGONAL_KNOWN if variance else LocationFix.UNKNOWN,
    )


def grid(t_ns: int, values: FloatArray, cell_m: float, origin_m: tuple[float, float], name: str) -> Grid:
    """Values over the field (n_north, n_east), row 0 south, as float32."""
    rows = np.ascontiguousarray(values, dtype="<f4")
    message = Grid(
        timestamp=stamp(t_ns),
        frame_id=FRAME,
        column_count=rows.shape[1],
        row_stride=rows.shape[1] * 4,
        cell_stride=4,
        fields=[PackedElementField(name=name, offset=0, type=PackedElementField.FLOAT32)],
        data=rows.tobytes(),
    )
    _place(message.pose, *origin_m, 0.0, 90.0)
    message.pose.position.x, message.pose.position.y = origin_m
    message.cell_size.x = message.cell_size.y = cell_m
    return message


def grid_values(message: Grid) -> tuple[FloatArray, float, tuple[float, float], str]:
    """The opposite of `grid`: values (n_north, n_east), cell size, origin and name."""
    values = np.frombuffer(message.data, dtype="<f4").reshape(-1, message.column_count).astype(float)
    origin = (message.pose.position.x, message.pose.position.y)
    return values, message.cell_size.x, origin, message.fields[0].name


def scene(t_ns: int, sources: Sequence[SourceEstimate]) -> SceneUpdate:
    """Each source as a disc of its two-sigma ellipse, with its number; earlier discs are taken away."""
    update = SceneUpdate()
    everything = update.deletions.add()
    everything.timestamp.CopyFrom(stamp(t_ns))
    everything.type = everything.ALL
    for source in sources:
        entity = update.entities.add()
        entity.timestamp.CopyFrom(stamp(t_ns))
        entity.frame_id, entity.id = FRAME, f"source {source.ident}"
        red, green, blue = _COLOURS[source.state]
        disc = entity.cylinders.add()
        _place(disc.pose, source.east_m, source.north_m, 0.0, 90.0 - _ellipse(source.cov_m2)[2])
        disc.size.x, disc.size.y, disc.size.z = (*_ellipse(source.cov_m2)[:2], 0.02)
        disc.bottom_scale = disc.top_scale = 1.0
        disc.color.CopyFrom(Color(r=red, g=green, b=blue, a=0.6))
        text = entity.texts.add()
        _place(text.pose, source.east_m, source.north_m, 0.3, 90.0)
        text.billboard, text.scale_invariant, text.font_size = True, True, 14.0
        text.color.CopyFrom(Color(r=red, g=green, b=blue, a=1.0))
        text.text = f"{source.ident} {source.state} {source.p_here:.2f}"
    return update


def log(t_ns: int, level: str, text: str) -> Log:
    """A note as Foxglove's log line."""
    return Log(timestamp=stamp(t_ns), level=_LEVELS.get(level, Log.INFO), message=text, name="fieldkit")


def _ellipse(cov_m2: FloatArray) -> tuple[float, float, float]:
    """Two-sigma diameters (m) and the first axis' angle (deg, from east); at least 5 cm across."""
    if not np.all(np.isfinite(cov_m2)) or np.shape(cov_m2) != (2, 2):
        return 0.1, 0.1, 0.0
    variances, axes = np.linalg.eigh(cov_m2)
    major, minor = (max(0.05, 4.0 * math.sqrt(max(0.0, v))) for v in (variances[1], variances[0]))
    return major, minor, math.degrees(math.atan2(axes[1, 1], axes[0, 1]))


def _place(pose: Any, east_m: float, north_m: float, up_m: float, heading_deg: float) -> None:
    place = pose.position
    place.x, place.y, place.z = (_rounded(m, PLACE_STEP_M) for m in (east_m, north_m, up_m))
    pose.orientation.z, pose.orientation.w = _turn(heading_deg)


def _turn(heading_deg: float) -> tuple[float, float]:
    """A compass heading as z and w of a quaternion."""
    half = math.radians(90.0 - heading_deg) / 2.0
    return _rounded(math.sin(half), TURN_STEP), _rounded(math.cos(half), TURN_STEP)


def _rounded(value: float, step: float) -> float:
    """The nearest multiple of `step`; nan and infinities as they are."""
    return round(value / step) * step if math.isfinite(value) else value
