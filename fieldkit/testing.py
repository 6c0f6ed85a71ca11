"""Conformance suites for driver authors: run them over your driver, over an emulator or the device itself.

A suite takes a function that makes a bench: an async context manager around a fresh, not yet opened driver
and what is needed to make things happen to it. A property that does not hold raises `AssertionError` naming
it. In a test:

    async def test_my_receiver_conforms():
        await check_receiver(my_bench)
"""

import asyncio
import math
import threading
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from fieldkit.clock import Clock
from fieldkit.errors import FieldkitError
from fieldkit.messages import Pose, ReceiverState, RssReading, VehicleState, Waypoint
from fieldkit.ports import PositionSource, Receiver, VehicleLink

Item = TypeVar("Item")
Act = Callable[[], Awaitable[None]]
Condition = Callable[[list[Any]], bool]

PATIENCE_S = 30.0
"""Wall time that a test waits for something to happen."""
UNPLUG_S = 2.0
"""Wall time within which a receiver must notice that its device is gone."""

SOURCE_BACK_S = 30.0
"""Wall time within which a position source must take its device back; a camera starts a process for it."""


@dataclass
class ReceiverBench:
    """A receiver, not yet opened, and a hand on its device."""

    receiver: Receiver
    transmit: Callable[[int], Awaitable[None]]
    """Have the device hear this many transmissions."""
    unplug: Act | None = None
    """Pull the plug; None where the device cannot be unplugged (a recording)."""
    replug: Act | None = None
    """Plug it in again."""
    of_itself: bool = False
    """Readings come without transmissions, as an energy survey's do: they are not counted against them."""


@dataclass
class VehicleLinkBench:
    """A link, not yet opened, with vehicles that answer; `clock` is the one the link was given."""

    link: VehicleLink
    clock: Clock
    start_m: dict[str, tuple[float, float]]
    """Robot to where it stands: east, north."""


@dataclass
class PositionSourceBench:
    """A position source, not yet opened, that will give poses of all its robots by itself."""

    source: PositionSource
    unplug: Act | None = None
    """Take its device away; None where there is none (a file, a recording)."""
    replug: Act | None = None
    """Bring it back."""


MakeReceiver = Callable[[], AbstractAsyncContextManager[ReceiverBench]]
MakeVehicleLink = Callable[[], AbstractAsyncContextManager[VehicleLinkBench]]
MakePositionSource = Callable[[], AbstractAsyncContextManager[PositionSourceBench]]


async def check_receiver(make: MakeReceiver) -> None:
    """Everything a `Receiver` promises: order, stamps, cancellation, closing twice, unplugging, no leaks."""
    for check in (_receives_in_order, _receiver_survives_cancelling, _receiver_closes, _receiver_comes_back):
        async with nothing_left(), make() as bench:
            await check(bench)


async def _receives_in_order(bench: ReceiverBench) -> None:
    async with bench.receiver as receiver, _Tap(receiver.readings()) as tap:
        await bench.transmit(20)
        # A radio that is asked for each strength may bring one every 1.5 s.
        readings = await tap.until(lambda seen: len(_readings(seen)) >= 20, "20 readings", 2.0 * PATIENCE_S)
        heard = _readings(readings)
        assert len(heard) == 20 or bench.of_itself, f"20 transmissions gave {len(heard)} readings"
        stamps = [reading.t_ns for reading in heard]
        assert stamps == sorted(stamps), "readings are not in the order of reception"
        for reading in heard:
            assert reading.robot == receiver.robot, f"reading of {reading.robot}, not of {receiver.robot}"
            assert -200.0 < reading.rss_dbm < 0.0, f"{reading.rss_dbm} is no received power in dBm"


async def _receiver_survives_cancelling(bench: ReceiverBench) -> None:
    async with bench.receiver as receiver:
        async with _Tap(receiver.readings()) as tap:
            await bench.transmit(3)
            await tap.until(lambda seen: len(_readings(seen)) >= 3, "3 readings")
        async with _Tap(receiver.readings()) as tap:
            await bench.transmit(3)
            await tap.until(lambda seen: len(_readings(seen)) >= 3, "3 readings after a cancelled consumer")


async def _receiver_closes(bench: ReceiverBench) -> None:
    async with bench.receiver as receiver:
        consumer = asyncio.create_task(_collect(receiver.readings()))
        await asyncio.sleep(0)
    await asyncio.wait({consumer}, timeout=PATIENCE_S)
    assert consumer.done(), "readings() did not end when the receiver was closed"
    consumer.result()
    await receiver.__aexit__(None, None, None)


async def _receiver_comes_back(bench: ReceiverBench) -> None:
    if bench.unplug is None or bench.replug is None:
        return
    async with bench.receiver as receiver, _Tap(receiver.readings()) as tap:
        await bench.transmit(1)
        await tap.until(lambda seen: len(_readings(seen)) >= 1, "a reading")
        await bench.unplug()
        await tap.until(_is_down, "ReceiverState(up=False) after unplugging", UNPLUG_S)
        await bench.replug()
        await tap.until(lambda seen: not _is_down(seen), "ReceiverState(up=True) after plugging in again")
        before = len(_readings(tap.seen))
        await bench.transmit(1)
        await tap.until(lambda seen: len(_readings(seen)) > before, "a reading after plugging in again")


def _readings(seen: list[Any]) -> list[RssReading]:
    return [item for item in seen if isinstance(item, RssReading)]


def _is_down(seen: list[Any]) -> bool:
    states = [item for item in seen if isinstance(item, ReceiverState)]
    return bool(states) and not states[-1].up


async def check_vehicle_link(make: MakeVehicleLink) -> None:
    """Everything a `VehicleLink` promises: poses, take-over, goto, hold, return, refusals, closing."""
    for check in (
        _reports_poses,
        _steers_and_holds,
        _stops_and_gives_its_fence_back,
        _refuses_nonsense,
        _link_closes,
    ):
        async with nothing_left(), make() as bench:
            await check(bench)


async def _reports_poses(bench: VehicleLinkBench) -> None:
    async with bench.link as link, _beating(bench), _Tap(link.events()) as tap:
        for robot in link.robots:
            await tap.until(_has_poses(robot, 5), f"poses of {robot}")
            stamps = [pose.t_ns for pose in _poses(tap.seen, robot)]
            assert stamps == sorted(stamps), f"poses of {robot} are not in order"
            pose = _poses(tap.seen, robot)[-1]
            off_m = math.dist((pose.east_m, pose.north_m), bench.start_m[robot])
            assert off_m < 1.0 + 5.0 * pose.sigma_m, f"{robot} is reported {off_m:.1f} m from where it stands"
            assert abs(pose.t_ns - bench.clock.now_ns()) < 5e9 * max(1.0, bench.clock.rate), (
                "a pose's time is off"
            )


async def _steers_and_holds(bench: VehicleLinkBench) -> None:
    async with bench.link as link, _beating(bench), _Tap(link.events()) as tap:
        await asyncio.gather(*(link.acquire_control(robot) for robot in link.robots))
        for robot in link.robots:
            await tap.until(_is(robot, "guided"), f"{robot} guided")
            assert _state(tap.seen, robot).armed, f"{robot} is under our control and not armed"
        robot = link.robots[0]
        east_m, north_m = bench.start_m[robot]
        goal = (east_m + 2.0, north_m + 2.0)
        await link.goto(robot, Waypoint(*goal, speed_m_s=0.4))
        await tap.until(
            lambda seen: math.dist(_at(seen, robot), goal) < 1.5, f"{robot} comes nearer to its way-point"
        )
        await link.hold(robot)
        await link.hold(robot)
        await tap.until(_is(robot, "hold"), f"{robot} holds")
        await link.goto(robot, Waypoint(east_m, north_m, speed_m_s=0.4))
        await tap.until(_is(robot, "guided"), f"{robot} goes on after a hold")
        await link.return_home(robot)
        await tap.until(_is(robot, "return"), f"{robot} returns")


async def _stops_and_gives_its_fence_back(bench: VehicleLinkBench) -> None:
    async with bench.link as link, _beating(bench), _Tap(link.events()) as tap:
        robot = link.robots[0]
        await tap.until(_has_poses(robot, 1), f"a pose of {robot}")
        await link.acquire_control(robot)
        east_m, north_m = bench.start_m[robot]
        await link.goto(robot, Waypoint(east_m + 5.0, north_m, speed_m_s=0.4))
        await tap.until(_is(robot, "guided"), f"{robot} guided")
        link.stop(robot)
        await tap.until(_is(robot, "hold"), f"{robot} holds though nobody waits for it")
        ours = [(east_m + e, north_m + n) for e, n in ((-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0))]
        before = await link.stored_fence(robot)
        await link.put_fence(robot, ours)
        assert await link.stored_fence(robot) != before, f"{robot} has not got the fence it was given"
        await link.restore_fence(before)
        assert await link.stored_fence(robot) == before, f"{robot} has not got its own fence back"
        if not (await link.traits(robot)).flies:
            assert await _refuses(link.take_off(robot, 5.0)), f"{robot} does not fly, and takes off"


async def _refuses_nonsense(bench: VehicleLinkBench) -> None:
    async with bench.link as link, _beating(bench), _Tap(link.events()):
        robot = link.robots[0]
        await link.acquire_control(robot)
        for waypoint in (Waypoint(math.nan, 0.0, 0.4), Waypoint(0.0, math.inf, 0.4)):
            assert await _refuses(link.goto(robot, waypoint)), f"{waypoint} was not refused"
        assert await _refuses(link.goto("nobody", Waypoint(1.0, 1.0, 0.4))), (
            "an unknown robot was not refused"
        )


async def _link_closes(bench: VehicleLinkBench) -> None:
    async with bench.link as link:
        consumer = asyncio.create_task(_collect(link.events()))
        await asyncio.sleep(0)
    await asyncio.wait({consumer}, timeout=PATIENCE_S)
    assert consumer.done(), "events() did not end when the link was closed"
    consumer.result()
    await link.__aexit__(None, None, None)
    link.beat()


def _poses(seen: list[Any], robot: str) -> list[Pose]:
    return [item for item in seen if isinstance(item, Pose) and item.robot == robot]


def _at(seen: list[Any], robot: str) -> tuple[float, float]:
    poses = _poses(seen, robot)
    return (poses[-1].east_m, poses[-1].north_m) if poses else (math.inf, math.inf)


def _state(seen: list[Any], robot: str) -> VehicleState:
    states = [item for item in seen if isinstance(item, VehicleState) and item.robot == robot]
    assert states, f"no state of {robot}"
    return states[-1]


def _is(robot: str, mode: str) -> Condition:
    def shown(seen: list[Any]) -> bool:
        states = [item for item in seen if isinstance(item, VehicleState) and item.robot == robot]
        return bool(states) and states[-1].mode == mode

    return shown


def _has_poses(robot: str, count: int) -> Condition:
    return lambda seen: len(_poses(seen, robot)) >= count


async def _refuses(action: Awaitable[None]) -> bool:
    try:
        await action
    except FieldkitError:
        return True
    return False


@asynccontextmanager
async def _beating(bench: VehicleLinkBench) -> AsyncIterator[None]:
    """The mission's heartbeat, without which vehicles hold by themselves."""

    async def beat() -> None:
        while True:
            bench.link.beat()
            await bench.clock.sleep(1.0)

    task = asyncio.create_task(beat())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait({task})


async def check_position_source(make: MakePositionSource) -> None:
    """Everything a `PositionSource` promises: order, names, finite poses, cancelling, unplugging, closing, no leaks."""
    for check in (_gives_poses, _source_survives_cancelling, _source_comes_back, _source_closes):
        async with nothing_left(), make() as bench:
            await check(bench)


async def _gives_poses(bench: PositionSourceBench) -> None:
    async with bench.source as source, _Tap(source.poses()) as tap:
        for robot in source.robots:
            await tap.until(_has_poses(robot, 3), f"poses of {robot}")
            poses = _poses(tap.seen, robot)
            assert [pose.t_ns for pose in poses] == sorted(pose.t_ns for pose in poses), (
                "poses are not in order"
            )
            for pose in poses:
                numbers = (pose.east_m, pose.north_m, pose.up_m, pose.heading_deg, pose.sigma_m)
                assert all(math.isfinite(number) for number in numbers), f"{pose} is not finite"
                assert 0.0 <= pose.heading_deg < 360.0, f"heading {pose.heading_deg}"
        strangers = {pose.robot for pose in tap.seen} - set(source.robots)
        assert not strangers, f"poses of robots it does not announce: {strangers}"


async def _source_survives_cancelling(bench: PositionSourceBench) -> None:
    async with bench.source as source:
        for consumer in ("a consumer", "another after the first was cancelled"):
            async with _Tap(source.poses()) as tap:
                await tap.until(lambda seen: len(seen) >= 2, f"2 poses for {consumer}")


async def _source_comes_back(bench: PositionSourceBench) -> None:
    if bench.unplug is None or bench.replug is None:
        return
    async with bench.source as source, _Tap(source.poses()) as tap:
        await tap.until(lambda seen: len(seen) >= 1, "a pose")
        await bench.unplug()
        await asyncio.sleep(UNPLUG_S)  # what was under way may still come
        before = len(tap.seen)
        await asyncio.sleep(0.5)
        assert len(tap.seen) == before, "poses of a device that is gone"
        await bench.replug()
        await tap.until(lambda seen: len(seen) > before + 1, "poses after plugging in again", SOURCE_BACK_S)


async def _source_closes(bench: PositionSourceBench) -> None:
    async with bench.source as source:
        consumer = asyncio.create_task(_collect(source.poses()))
        await asyncio.sleep(0)
    await asyncio.wait({consumer}, timeout=PATIENCE_S)
    assert consumer.done(), "poses() did not end when the source was closed"
    consumer.result()
    await source.__aexit__(None, None, None)


class _Tap:
    """Consumes an iterator in the background; `seen` is what came."""

    def __init__(self, items: AsyncIterator[Any]) -> None:
        self.seen: list[Any] = []
        self._items = items
        self._came = asyncio.Event()

    async def __aenter__(self) -> "_Tap":
        self._task = asyncio.create_task(self._consume())
        return self

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.wait({self._task})
        if not self._task.cancelled() and (error := self._task.exception()) is not None:
            raise error

    async def _consume(self) -> None:
        async for item in self._items:
            self.seen.append(item)
            self._came.set()

    async def until(self, condition: Condition, what: str, timeout_s: float = PATIENCE_S) -> list[Any]:
        """What has been seen once `condition` holds; `AssertionError` naming `what` if it never does."""
        try:
            async with asyncio.timeout(timeout_s):
                while not condition(self.seen):
                    self._came.clear()
                    await self._came.wait()
        except TimeoutError:
            raise AssertionError(
                f"expected {what} within {timeout_s:g} s; last seen: {self.seen[-3:]}"
            ) from None
        return self.seen


async def _collect(items: AsyncIterator[Item]) -> list[Item]:
    return [item async for item in items]


@asynccontextmanager
async def nothing_left() -> AsyncIterator[None]:
    """Fail if what runs inside leaves a task or a thread behind."""
    tasks, threads = set(asyncio.all_tasks()), set(threading.enumerate())
    yield
    for _ in range(50):
        left_tasks = [task for task in asyncio.all_tasks() - tasks if not task.done()]
        # The loop's own executor keeps its threads until the loop ends.
        left_threads = [t for t in set(threading.enumerate()) - threads if not t.name.startswith("asyncio_")]
        if not left_tasks and not left_threads:
            return
        await asyncio.sleep(0.02)
    raise AssertionError(f"left behind: tasks {left_tasks}, threads {left_threads}")
