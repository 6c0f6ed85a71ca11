"""Where the receiver is while readings are collected: out of a vehicle's telemetry, or from a camera.

Both are found by entry-point name, as in a mission. Typed distances need nothing of this.
"""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fieldkit import plugins
from fieldkit.channel.model import MIN_RANGE_M
from fieldkit.errors import ConfigError
from fieldkit.messages import Pose, VehicleState
from fieldkit.ports import DriverContext, PositionSource, VehicleLink

MOVED_M = 0.3
"""A receiver that moved farther than this while listening was not at one place."""
CLOCK_OFF_S = 2.0


@dataclass(frozen=True, slots=True)
class Spot:
    """Distance to the transmitter, and the direction to it as the antenna sees it, clockwise from its front."""

    distance_m: float
    heading_deg: float


@dataclass(slots=True)
class PositionFeed:
    """Poses of one robot as they come. Use `following()`."""

    robot: str
    source: VehicleLink | PositionSource
    transmitter_m: tuple[float, float] | None = None
    """East and north; None until the robot has stood there."""
    poses: list[Pose] = field(default_factory=list)

    @asynccontextmanager
    async def following(self) -> AsyncIterator[None]:
        """Opens the source and collects its poses."""
        async with self.source:
            task = asyncio.create_task(self._follow())
            try:
                yield
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)

    async def _follow(self) -> None:
        stream: AsyncIterator[Pose | VehicleState]
        stream = self.source.poses() if isinstance(self.source, PositionSource) else self.source.events()
        async for event in stream:
            if isinstance(event, Pose) and event.robot == self.robot:
                self.poses.append(event)

    def stood(self, poses: list[Pose]) -> tuple[float, float] | str:
        """Where the robot stood while these poses came, east and north; or, in words, why that is not known."""
        if not poses:
            return "no position came meanwhile: is the vehicle on, with a fix, and is the address right?"
        place = np.array([(pose.east_m, pose.north_m) for pose in poses])
        middle = np.median(place, axis=0)
        moved = float(np.hypot(*(place - middle).T).max())
        if moved > max(MOVED_M, 4.0 * max(pose.sigma_m for pose in poses)):
            return f"the robot moved by {moved:.1f} m while listening; let it stand still and measure again"
        return float(middle[0]), float(middle[1])

    def spot(self, poses: list[Pose]) -> Spot | str:
        """Distance and direction to the transmitter, or why they are not known."""
        if self.transmitter_m is None:
            return "the transmitter's place is not known: put the robot there and answer t, or give --transmitter"
        stood = self.stood(poses)
        if isinstance(stood, str):
            return stood
        east, north = np.subtract(self.transmitter_m, stood)
        distance = float(np.hypot(east, north))
        if distance <= max(MIN_RANGE_M, 2.0 * max(pose.sigma_m for pose in poses)):
            return f"{distance:.2f} m from the transmitter, which its positions cannot distinguish from none: move away"
        bearing = float(np.degrees(np.arctan2(east, north)))
        return Spot(distance, (bearing - poses[-1].heading_deg) % 360.0)

    def clock_off_s(self, now_ns: int) -> float:
        """How far the newest pose's clock is from ours, in seconds, where that is too far; else 0."""
        off = (self.poses[-1].t_ns - now_ns) * 1e-9 if self.poses else 0.0
        return off if abs(off) > CLOCK_OFF_S else 0.0


def by_telemetry(
    driver: str, address: str, robot: str, options: Mapping[str, Any], around: DriverContext
) -> VehicleLink:
    """A vehicle's link, not opened yet, by its name in `fieldkit.vehicles`."""
    link: VehicleLink = plugins.load("fieldkit.vehicles", driver)(address, {robot: dict(options)}, around)
    return link


def by_position_source(
    name: str, address: str, robot: str, options: Mapping[str, Any], around: DriverContext
) -> PositionSource:
    """A source of positions such as a camera, by its name in `fieldkit.positions`; made as a vehicle's link is.

    Raises `ConfigError` that says so where none is installed.
    """
    if not plugins.names("fieldkit.positions"):
        raise ConfigError(
            f"--positions {name}: no source of positions is installed (entry-point group fieldkit.positions); "
            "install one, use a vehicle's telemetry (--vehicle mavlink), or type the distances"
        )
    source: PositionSource = plugins.load("fieldkit.positions", name)(address, {robot: dict(options)}, around)
    return source
