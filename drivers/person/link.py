"""A person behind the vehicle port: way-points become advice, which the page shows as an arrow and a distance.

A person holds at once, cannot be armed, and goes where they like: ignoring advice is ordinary, and simply replanned.
Where they are comes from a position source (`gnss`), never from here.
"""

import asyncio
import math
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

from drivers.bounded_queue import BoundedQueue
from drivers.options import checked
from fieldkit.checks import Check
from fieldkit.errors import VehicleRefused
from fieldkit.messages import Pose, VehicleMode, VehicleState, Waypoint
from fieldkit.ports import Demands, DriverContext, StoredFence, Traits

STATE_S = 0.5
WALKS_M_S = 1.5
ARRIVES_M = 3.0


@dataclass(frozen=True, slots=True)
class PersonOptions:
    """A person has no settings."""


def open_people(address: str, robots: Mapping[str, Mapping[str, Any]], around: DriverContext) -> "PeopleLink":
    """People as a vehicle link; `address` is a name for the group. Raises `ConfigError` for options: there are none."""
    for robot, options in robots.items():
        checked(PersonOptions, options, f"vehicle of {robot} (person)")
    return PeopleLink(tuple(robots), around)


class PeopleLink:
    """Always there; what is asked of a person is done as soon as it is said."""

    def __init__(self, robots: tuple[str, ...], around: DriverContext) -> None:
        self.robots = robots
        self.advice: dict[str, Waypoint | None] = dict.fromkeys(robots)
        """Where each person is ordered to go; None: stay."""
        self._clock = around.clock
        self._mode: dict[str, VehicleMode] = dict.fromkeys(robots, "other")

    async def __aenter__(self) -> Self:
        self._queue: BoundedQueue[Pose | VehicleState] = BoundedQueue()
        self._mode = dict.fromkeys(self.robots, "other")
        self._task = asyncio.create_task(self._tell(), name="people")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._task.cancel()
        await asyncio.wait({self._task})
        self._queue.close()

    async def _tell(self) -> None:
        while True:
            for robot in self.robots:
                self._say(robot)
            await self._clock.sleep(STATE_S)

    def _say(self, robot: str) -> None:
        mode = self._mode[robot]
        self._queue.put(VehicleState(self._clock.now_ns(), robot, mode, mode != "other"))

    def _set(self, robot: str, mode: VehicleMode, advice: Waypoint | None = None) -> None:
        self._check(robot)
        self._mode[robot], self.advice[robot] = mode, advice
        self._say(robot)

    def _check(self, robot: str) -> None:
        if robot not in self.robots:
            raise VehicleRefused(f"{robot}: nobody of that name; there are: {', '.join(self.robots)}")

    async def events(self) -> AsyncIterator[Pose | VehicleState]:
        """States alone."""
        async for event in self._queue.items():
            yield event

    def beat(self) -> None:
        """Nobody waits for it: people stop by themselves when the page falls silent."""

    async def acquire_control(self, robot: str, *, arm: bool = True) -> None:
        """Somebody follows advice from now on."""
        self._set(robot, "guided")

    async def inspect(self, robot: str, demands: Demands = Demands()) -> list[Check]:
        """There is nothing to check of a person."""
        self._check(robot)
        return [Check(robot, "person", "green", "walks, and stops by themselves")]

    async def traits(self, robot: str) -> Traits:
        """As people walk."""
        self._check(robot)
        return Traits(False, ARRIVES_M, 0.0, WALKS_M_S, WALKS_M_S)

    async def stored_fence(self, robot: str) -> StoredFence:
        """None: a person has a map."""
        self._check(robot)
        return StoredFence(robot, None)

    async def put_fence(self, robot: str, corners_m: Sequence[tuple[float, float]]) -> None:
        """The page shows the fence; there is nothing to put it into."""
        self._check(robot)

    async def restore_fence(self, stored: StoredFence) -> None:
        """Nothing was taken away."""
        self._check(stored.robot)

    def release(self, robot: str) -> None:
        """No advice any more."""
        self._set(robot, "other")

    def stop(self, robot: str) -> None:
        """Stay where you are."""
        self._set(robot, "hold")

    async def hold(self, robot: str) -> None:
        """The same."""
        self._set(robot, "hold")

    async def take_off(self, robot: str, up_m: float) -> None:
        """Raises `VehicleRefused`."""
        self._check(robot)
        raise VehicleRefused(f"{robot}: people do not fly")

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        """Advice to go there. Raises `VehicleRefused` for what is no place."""
        self._check(robot)
        if not math.isfinite(waypoint.east_m + waypoint.north_m):
            raise VehicleRefused(f"{robot}: {waypoint.east_m}, {waypoint.north_m} is no place")
        self._set(robot, "guided", waypoint)

    async def return_home(self, robot: str) -> None:
        """Advice to go home."""
        self._set(robot, "return")

    async def land(self, robot: str) -> None:
        """Raises `VehicleRefused`."""
        self._check(robot)
        raise VehicleRefused(f"{robot}: people do not fly")
