"""A position log as a `PositionSource`: poses with the log's own times, at the log's own pace."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from drivers.options import REMEDY, checked
from drivers.positions.tracks import Spot, Track, read_track
from fieldkit.errors import ConfigError, DataError
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose
from fieldkit.ports import DriverContext


@dataclass(frozen=True, slots=True)
class FileOptions:
    """What a mission file says of a position log."""

    path: str = field(metadata={REMEDY: 'write the file of positions, as in path = "track.gpx"'})
    """CSV, GPX, tlog, dataflash .bin, a ROS 2 bag or a fieldkit recording."""
    robot: str | None = None
    """The robot whose positions they are, where the log names none."""
    at_once: bool = False
    """Give all poses at once, not at the log's pace."""


def open_file(options: Mapping[str, Any], around: DriverContext) -> "FilePositions":
    """A position log as a source. Raises `ConfigError`, also where the log cannot be read."""
    chosen = checked(FileOptions, options, "positions (file)")
    try:
        track = read_track(Path(chosen.path), chosen.robot)
    except DataError as error:
        raise ConfigError(f"positions (file): {error}") from error
    return FilePositions(track, around, at_once=chosen.at_once)


def poses_of(track: Track, frame: FieldFrame) -> list[Pose]:
    """The track in a field's frame, in order of time."""
    return [_pose(spot, track.geodetic, frame) for spot in track.spots]


def _pose(spot: Spot, geodetic: bool, frame: FieldFrame) -> Pose:
    east_m, north_m = spot.first, spot.second
    if geodetic:
        east_m, north_m, _ = frame.to_local(spot.first, spot.second)
    return Pose(spot.t_ns, spot.robot, east_m, north_m, spot.up_m, spot.heading_deg, spot.sigma_m, "file")


class FilePositions:
    """Opening starts at the beginning; closing ends the poses."""

    def __init__(self, track: Track, around: DriverContext, *, at_once: bool) -> None:
        self.robots = tuple(sorted({spot.robot for spot in track.spots}))
        self._poses = poses_of(track, around.frame)
        self._clock = around.clock
        self._at_once = at_once
        self._next = 0

    async def __aenter__(self) -> Self:
        self._closed = asyncio.Event()
        self._next = 0
        self._began_ns = self._clock.now_ns()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closed.set()

    async def poses(self) -> AsyncIterator[Pose]:
        """Ends with the log, or when closed. A consumer that was cancelled is followed up where it was."""
        while self._next < len(self._poses) and not self._closed.is_set():
            pose = self._poses[self._next]
            if not self._at_once:
                ahead_ns = pose.t_ns - self._poses[0].t_ns - (self._clock.now_ns() - self._began_ns)
                if ahead_ns > 0:
                    await self._clock.sleep(min(ahead_ns * 1e-9, 0.5))
                    continue
            self._next += 1
            yield pose
