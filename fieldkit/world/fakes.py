"""Stand-ins for the ports, in process: a radio that is a queue, vehicles that simply drive.

They pass the same conformance suite as the drivers, so that a mission cannot distinguish them but by speed.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping, Sequence
from types import TracebackType
from typing import Generic, Self, TypeVar

from fieldkit.checks import Check
from fieldkit.clock import Clock
from fieldkit.errors import DeviceError, DeviceTimeout, VehicleRefused
from fieldkit.messages import Pose, ReceiverState, RssReading, VehicleMode, VehicleState, Waypoint
from fieldkit.ports import Demands, StoredFence, Traits
from fieldkit.world.bodies import Rover

Item = TypeVar("Item")
STEP_S = 0.1
POSE_S = 0.25
STATE_S = 1.0


class _Stream(Generic[Item]):
    """A queue that can be closed under its consumer, and taken up again by another."""

    def __init__(self) -> None:
        self._items: list[Item] = []
        self._more = asyncio.Event()
        self._closed = False

    def put(self, item: Item) -> None:
        self._items.append(item)
        self._more.set()

    def close(self) -> None:
        self._closed = True
        self._more.set()

    async def items(self) -> AsyncIterator[Item]:
        while True:
            while self._items:
                yield self._items.pop(0)
            if self._closed:
                return
            self._more.clear()
            await self._more.wait()


class FakeReceiver:
    """A `Receiver` that hears what `hear` is given."""

    def __init__(self, robot: str, clock: Clock) -> None:
        self.robot = robot
        self._clock = clock
        self._stream: _Stream[RssReading | ReceiverState] = _Stream()

    async def __aenter__(self) -> Self:
        self._stream = _Stream()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.close()

    def readings(self) -> AsyncIterator[RssReading | ReceiverState]:
        """What was heard, and changes of state."""
        return self._stream.items()

    def hear(self, rss_dbm: float) -> None:
        """A transmission of this strength, now."""
        self._stream.put(RssReading(self._clock.now_ns(), self.robot, rss_dbm, "sim"))

    def set_up(self, up: bool, reason: str = "") -> None:
        """Unplug or plug in."""
        self._stream.put(ReceiverState(self._clock.now_ns(), self.robot, up, reason))


class FakeFleet:
    """A `VehicleLink` whose vehicles are `Rover`s stepped by a task; they always obey once control is acquired."""

    def __init__(self, rovers: Mapping[str, Rover], clock: Clock) -> None:
        self.robots = tuple(rovers)
        self.rovers = dict(rovers)
        self.beats = 0
        """Heartbeats from the steering loop."""
        self.silent: set[str] = set()
        """Robots whose link is lost: nothing is heard of them, and they do not answer."""
        self._clock = clock
        self._home = {name: (rover.east_m, rover.north_m) for name, rover in rovers.items()}
        self._mode: dict[str, VehicleMode] = dict.fromkeys(self.robots, "other")
        self._armed = dict.fromkeys(self.robots, False)
        self.fences: dict[str, StoredFence] = {}
        self._stream: _Stream[Pose | VehicleState] = _Stream()
        self._task: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        self._stream = _Stream()
        self._task = asyncio.create_task(self._drive(), name="fake fleet")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
            self._task = None
        self._stream.close()

    def events(self) -> AsyncIterator[Pose | VehicleState]:
        """Poses four times a second, states once a second and on change."""
        return self._stream.items()

    def beat(self) -> None:
        """Count it."""
        self.beats += 1

    async def acquire_control(self, robot: str, *, arm: bool = True) -> None:
        """Ours, and armed."""
        self._check(robot)
        self._armed[robot] = self._armed[robot] or arm
        self._set(robot, "guided")

    async def inspect(self, robot: str, demands: Demands = Demands()) -> list[Check]:
        """Nothing is ever wrong with it."""
        self._check(robot)
        return [Check(robot, "failsafe", "green", "stops when the program does")]

    async def traits(self, robot: str) -> Traits:
        """As its body is."""
        self._check(robot)
        body = self.rovers[robot]
        return Traits(False, body.arrive_m, 0.0, body.max_speed_m_s, body.max_speed_m_s)

    async def stored_fence(self, robot: str) -> StoredFence:
        """None, until it gets one."""
        self._check(robot)
        return self.fences.get(robot, StoredFence(robot, 0.0))

    async def put_fence(self, robot: str, corners_m: Sequence[tuple[float, float]]) -> None:
        """It takes any."""
        self._check(robot)
        rows = tuple((0.0, east_m, north_m, 0.0, 0.0, 0.0, 0.0, 0.0) for east_m, north_m in corners_m)
        self.fences[robot] = StoredFence(robot, 1.0, rows)

    async def restore_fence(self, stored: StoredFence) -> None:
        """Put a stored fence back."""
        self._check(stored.robot)
        self.fences[stored.robot] = stored

    def release(self, robot: str) -> None:
        """Not ours any more."""
        self._set(robot, "other")

    def stop(self, robot: str) -> None:
        """Stop, if it is there."""
        if robot in self.rovers and robot not in self.silent:
            self.rovers[robot].stop()
            self._set(robot, "hold")

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        """Drive there. Refused before `acquire_control`, and for targets that are no numbers."""
        self._check(robot)
        if not self._armed[robot]:
            raise VehicleRefused(f"{robot}: not ours to steer: take it over first")
        if not abs(waypoint.east_m) + abs(waypoint.north_m) + abs(waypoint.speed_m_s) < float("inf"):
            raise VehicleRefused(f"{robot}: a way-point that is no number: {waypoint}")
        self.rovers[robot].go_to(waypoint.east_m, waypoint.north_m, waypoint.speed_m_s)
        self._set(robot, "guided")

    async def hold(self, robot: str) -> None:
        """Stop."""
        self._check(robot)
        self.rovers[robot].stop()
        self._set(robot, "hold")

    async def take_off(self, robot: str, up_m: float) -> None:
        """They all drive."""
        self._check(robot)
        raise VehicleRefused(f"{robot}: does not fly")

    async def land(self, robot: str) -> None:
        """They all drive."""
        self._check(robot)
        raise VehicleRefused(f"{robot}: does not fly")

    async def return_home(self, robot: str) -> None:
        """Drive to where it started."""
        self._check(robot)
        self.rovers[robot].go_to(*self._home[robot], self.rovers[robot].max_speed_m_s)
        self._set(robot, "return")

    def _check(self, robot: str) -> None:
        if robot not in self.rovers:
            raise DeviceError(f"no vehicle {robot!r} on this link; there are: {', '.join(self.robots)}")
        if robot in self.silent:
            raise DeviceTimeout(f"{robot}: does not answer; is its link up?")

    def _set(self, robot: str, mode: VehicleMode) -> None:
        self._mode[robot] = mode
        self._state(robot)

    def _state(self, robot: str) -> None:
        if robot not in self.silent:
            self._stream.put(VehicleState(self._clock.now_ns(), robot, self._mode[robot], self._armed[robot]))

    async def _drive(self) -> None:
        last_s = pose_s = state_s = self._clock.elapsed_s()
        while True:
            now_s = self._clock.elapsed_s()
            while last_s + STEP_S <= now_s:
                last_s += STEP_S
                for rover in self.rovers.values():
                    rover.step(STEP_S)
            if now_s >= pose_s:
                pose_s = now_s + POSE_S
                for name, rover in self.rovers.items():
                    pose = Pose(
                        self._clock.now_ns(), name, rover.east_m, rover.north_m, 0.0, rover.heading_deg
                    )
                    if name not in self.silent:
                        self._stream.put(pose)
            if now_s >= state_s:
                state_s = now_s + STATE_S
                for name in self.robots:
                    self._state(name)
            await self._clock.sleep(STEP_S)
