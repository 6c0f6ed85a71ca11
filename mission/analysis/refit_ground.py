"""The ground, calibration and settings that the missions of a campaign have in common."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fieldkit.channel.antenna_file import Receiver
from fieldkit.engine.grid import Grid
from fieldkit.errors import DataError
from fieldkit.geo import FieldFrame
from fieldkit.geometry.polygons import NOWHERE
from fieldkit.messages import FloatArray
from mission.core.kernel_settings import KernelSettings
from mission.core.mission_file import Mission


def common_ground(missions: Sequence[Mission]) -> tuple[FieldFrame, Grid]:
    """The frame and grid that hold the fields of all. Raises `DataError` where that would be mostly empty ground."""
    first = missions[0].frame
    corners = []
    for mission in missions:
        field = mission.file.field
        matrix, _ = between(mission.frame, first)
        for east_m, north_m in ((0.0, 0.0), (field.size_east_m, field.size_north_m)):
            corners.append(matrix @ (east_m, north_m, 1.0))
    west_m, south_m = np.floor(np.min(corners, axis=0) * 100.0 + 0.5) / 100.0
    east_m, north_m = np.max(corners, axis=0)
    lat_deg, lon_deg, _ = first.to_geodetic(float(west_m), float(south_m))
    moved = (west_m, south_m) != (0.0, 0.0)
    frame = FieldFrame(lat_deg, lon_deg, first.origin_alt_m) if moved else first
    size_east_m, size_north_m = float(east_m - west_m), float(north_m - south_m)
    area_m2 = sum(each.file.field.size_east_m * each.file.field.size_north_m for each in missions)
    if size_east_m * size_north_m > 100.0 * area_m2:
        raise DataError(
            f"the fields lie {size_east_m:.0f} by {size_north_m:.0f} m apart and are small in that: they have nothing "
            "in common; refit each place by itself"
        )
    return frame, Grid(size_east_m, size_north_m, min(each.file.field.cell_m for each in missions))


def between(own: FieldFrame, common: FieldFrame) -> tuple[FloatArray, float]:
    """The map from one frame's east and north to another's, (2, 3), and what is added to heights.

    Both are tangent to the ellipsoid: over the kilometres of a field the map is affine to millimetres.
    """
    if own == common:
        return np.eye(2, 3), 0.0
    step_m = 1000.0
    at, east, north = (
        np.array(common.to_local(*own.to_geodetic(*place)))
        for place in ((0.0, 0.0), (step_m, 0.0), (0.0, step_m))
    )
    matrix = np.column_stack([(east - at)[:2] / step_m, (north - at)[:2] / step_m, at[:2]])
    return matrix, own.origin_alt_m - common.origin_alt_m


def check_one_calibration(missions: Sequence[Mission]) -> None:
    """Raises `DataError` where missions were made with different calibrations, naming two."""
    first = missions[0]
    for other in missions[1:]:
        if other.antenna.antenna != first.antenna.antenna:
            raise DataError(
                f"{other.where} and {first.where} were made with different calibrations: say by --antenna which one "
                "holds for all, or refit them apart"
            )


def joint(missions: Sequence[Mission], names: Sequence[Mapping[str, str]], grid: Grid) -> KernelSettings:
    """The settings of a mission that all robots are in; nothing ends it, and nobody is steered."""
    first = missions[0].kernel
    robots = [name for each in names for name in each.values()]
    receivers: dict[str, Receiver] = {}
    altitude_m: dict[str, float] = {}
    for mission, its in zip(missions, names, strict=True):
        receivers |= {its[robot]: each for robot, each in mission.kernel.engine.receivers.items()}
        altitude_m |= {its[robot]: each for robot, each in mission.kernel.altitude_m.items()}
    engines = [mission.kernel.engine for mission in missions]
    teams = engines[0].teams if len(missions) == 1 else tuple((name,) for name in robots)
    engine = replace(
        engines[0],
        grid=grid,
        teams=teams,
        power_levels_db=tuple(sorted({level for each in engines for level in each.power_levels_db})),
        expected_sources=max(each.expected_sources for each in engines),
        reference_rate_hz=min(each.reference_rate_hz for each in engines),
        pose_sigma_m=max(each.pose_sigma_m for each in engines),
        receivers=receivers,
        keep_out=NOWHERE,
    )
    return replace(
        first,
        engine=engine,
        altitude_m=altitude_m,
        max_duration_s=float("inf"),
        idle_limit_s=float("inf"),
        sources_expected=None,
        stop_probability_left=None,
        stop_after_periods=None,
    )
