"""The only way to a vehicle: what replaces what, and that a stop waits for nothing."""

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest

from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceTimeout, VehicleRefused
from fieldkit.messages import GoTo, Hold, Pose, Return, VehicleState, Waypoint
from fieldkit.ports import StoredFence, Traits
from mission.shell.dispatcher import ACQUIRE, RELEASE, STOP_PATIENCE_S, Dispatcher

RATE = 50.0


class Vehicles:
    """A link whose vehicles answer only when told to, and that keeps what was asked, in order."""

    def __init__(self, *robots: str) -> None:
        self.robots = robots
        self.asked: list[tuple[str, str]] = []
        self.answers = {robot: asyncio.Event() for robot in robots}
        """Set: this vehicle's holds are confirmed."""
        self.refuses: set[str] = set()
        self.slow = True
        """Acquiring control takes for ever."""
        self.beats = 0

    async def __aenter__(self) -> "Vehicles":
        return self

    async def __aexit__(self, *_: object) -> None: ...

    async def events(self) -> AsyncIterator[Pose | VehicleState]:
        return
        yield

    def beat(self) -> None:
        self.beats += 1

    async def acquire_control(self, robot: str, *, arm: bool = True) -> None:
        self.asked.append((robot, "acquire"))
        if robot in self.refuses:
            raise VehicleRefused(f"{robot}: not ready")
        await asyncio.sleep(3600.0 if self.slow else 0.0)

    async def inspect(self, robot: str, fence_m: object = ()) -> list[object]:
        return []

    def release(self, robot: str) -> None:
        self.asked.append((robot, "release"))

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        self.asked.append((robot, f"goto {waypoint.east_m:g}"))
        if robot in self.refuses:
            raise VehicleRefused(f"{robot}: go to a way-point: FAILED")
        await asyncio.sleep(3600.0)  # its acknowledgement is lost

    def stop(self, robot: str) -> None:
        self.asked.append((robot, "stop"))

    async def hold(self, robot: str) -> None:
        self.asked.append((robot, "hold"))
        if robot in self.refuses:
            raise DeviceTimeout(f"{robot}: did not show mode hold")
        await self.answers[robot].wait()

    async def return_home(self, robot: str) -> None:
        self.asked.append((robot, "return"))

    async def land(self, robot: str) -> None:
        self.asked.append((robot, "land"))

    async def take_off(self, robot: str, up_m: float) -> None:
        self.asked.append((robot, f"take off {up_m:g}"))

    async def traits(self, robot: str) -> Traits:
        return Traits()

    async def stored_fence(self, robot: str) -> StoredFence:
        return StoredFence(robot, None)

    async def put_fence(self, robot: str, corners_m: object) -> None: ...

    async def restore_fence(self, stored: StoredFence) -> None: ...


class Bench:
    def __init__(self, *robots: str) -> None:
        self.vehicles = Vehicles(*robots)
        self.notes: list[str] = []
        self.clock = ScaledClock(RATE)
        self.dispatcher = Dispatcher(
            (self.vehicles,), self.clock, lambda level, text: self.notes.append(text)
        )

    def goto(self, robot: str, east_m: float = 1.0) -> None:
        self.dispatcher.order(robot, GoTo(0, robot, Waypoint(east_m, 0.0, 1.0)))

    def hold(self, robot: str) -> None:
        self.dispatcher.order(robot, Hold(0, robot, "a reason"))

    async def until(self, condition: Callable[[], bool]) -> None:
        while not condition():  # noqa: ASYNC110 - what is waited for has no event
            await asyncio.sleep(0.001)

    async def settle(self) -> None:
        for _ in range(5):
            await asyncio.sleep(0)


async def test_a_stop_does_not_wait_for_an_order_that_is_still_being_confirmed() -> None:
    bench = Bench("a")
    bench.goto("a")
    await bench.settle()
    bench.hold("a")
    await bench.settle()
    assert bench.vehicles.asked == [("a", "goto 1"), ("a", "stop"), ("a", "hold")]
    await bench.dispatcher.close()


async def test_a_stop_does_not_wait_for_control_that_is_being_acquired() -> None:
    bench = Bench("a", "b")
    acquiring = asyncio.create_task(bench.dispatcher.acquire())
    await bench.settle()
    bench.dispatcher.freeze(["a", "b"], 0, "operator: hold")
    assert bench.vehicles.asked[2:] == [("a", "stop"), ("b", "stop")], "before anything else is done"
    await bench.settle()
    await acquiring  # no error: the stop came later
    assert bench.vehicles.asked[4:] == [("a", "hold"), ("b", "hold")]
    await bench.dispatcher.close()


async def test_a_newer_way_point_replaces_one_that_is_not_acknowledged() -> None:
    bench = Bench("a")
    for east_m in (1.0, 2.0):
        bench.goto("a", east_m)
        await bench.settle()
    assert bench.vehicles.asked == [("a", "goto 1"), ("a", "goto 2")]
    await bench.dispatcher.close()


async def test_orders_of_other_robots_go_on() -> None:
    bench = Bench("a", "b")
    bench.goto("a")
    bench.goto("b")
    await bench.settle()
    bench.hold("a")
    await bench.settle()
    assert bench.dispatcher.answers["b"] == ("GoTo", "...")
    await bench.dispatcher.close()


async def test_a_stop_is_ordered_until_the_vehicle_shows_it() -> None:
    bench = Bench("a")
    bench.vehicles.refuses.add("a")
    bench.hold("a")
    await bench.until(lambda: len(bench.vehicles.asked) >= 4)
    assert bench.dispatcher.unconfirmed().keys() == {"a"}
    bench.vehicles.refuses.clear()
    bench.vehicles.answers["a"].set()
    await bench.until(lambda: not bench.dispatcher.unconfirmed())
    assert bench.dispatcher.answers["a"] == ("Hold", "done")
    assert bench.notes == ["a: Hold: a: did not show mode hold"]  # said once, not as often as it was ordered


async def test_the_same_stop_again_starts_nothing_anew() -> None:
    bench = Bench("a")
    for _ in range(3):
        bench.hold("a")
        await bench.settle()
    assert bench.vehicles.asked == [("a", "stop"), ("a", "hold")]
    await bench.dispatcher.close()


async def test_while_frozen_only_stops_and_releases_pass() -> None:
    bench = Bench("a")
    bench.dispatcher.freeze(["a"], 0, "operator: hold")
    bench.goto("a")
    bench.dispatcher.order("a", Return(0, "a", "home"))
    bench.dispatcher.order("a", ACQUIRE)
    await bench.settle()
    assert bench.vehicles.asked == [("a", "stop"), ("a", "hold")]
    bench.dispatcher.order("a", RELEASE)
    bench.dispatcher.thaw(["a"])
    bench.goto("a")
    await bench.settle()
    assert bench.vehicles.asked[2:] == [("a", "release"), ("a", "goto 1")]
    await bench.dispatcher.close()


async def test_the_end_names_those_that_do_not_show_that_they_hold() -> None:
    bench = Bench("a", "b", "c")
    bench.vehicles.answers["a"].set()
    bench.vehicles.refuses.add("b")
    began_s = bench.clock.elapsed_s()
    silent = await bench.dispatcher.stop(["a", "b", "c"], 0, "over")
    assert silent == ["b", "c"]
    assert bench.clock.elapsed_s() - began_s >= STOP_PATIENCE_S
    assert bench.notes[-1].startswith("NOT CONFIRMED to hold: b, c")
    assert bench.vehicles.asked.count(("b", "hold")) > 5
    assert bench.vehicles.beats > 5  # the vehicles must not take us for dead meanwhile
    await bench.dispatcher.close()


async def test_whoever_loses_patience_waits_no_longer() -> None:
    bench = Bench("a")
    stopping = asyncio.create_task(bench.dispatcher.stop(["a"], 0, "over"))
    await bench.settle()
    bench.dispatcher.lose_patience()
    assert await stopping == ["a"]
    await bench.dispatcher.close()


async def test_a_vehicle_that_refuses_keeps_a_mission_from_starting() -> None:
    bench = Bench("a")
    bench.vehicles.refuses.add("a")
    with pytest.raises(VehicleRefused, match="not ready"):
        await bench.dispatcher.acquire()


async def test_a_refused_way_point_is_said_with_the_vehicles_words() -> None:
    bench = Bench("a")
    bench.vehicles.refuses.add("a")
    bench.goto("a")
    await bench.settle()
    assert bench.dispatcher.answers["a"][1].endswith("FAILED")
    assert bench.notes == ["a: GoTo: a: go to a way-point: FAILED"]


async def test_one_that_flies_climbs_once_it_is_ours() -> None:
    vehicles = Vehicles("a", "b")
    vehicles.slow = False
    dispatcher = Dispatcher((vehicles,), ScaledClock(RATE), lambda level, text: None, {"b": 13.0})
    await dispatcher.acquire()
    assert vehicles.asked == [("a", "acquire"), ("b", "acquire"), ("b", "take off 13")]


async def test_a_drivers_mistake_neither_confirms_a_stop_nor_keeps_others_from_theirs() -> None:
    bench = Bench("a", "b")

    class Faulty(Vehicles):
        def stop(self, robot: str) -> None:
            super().stop(robot)
            if robot == "a":
                raise KeyError(robot)

        async def hold(self, robot: str) -> None:
            await super().hold(robot)
            if robot == "a" and self.asked.count((robot, "hold")) < 3:
                raise ValueError("not a number")

    bench.vehicles = Faulty("a", "b")
    bench.dispatcher = Dispatcher((bench.vehicles,), bench.clock, lambda _, text: bench.notes.append(text))
    for answer in bench.vehicles.answers.values():
        answer.set()
    bench.dispatcher.freeze(["a", "b"], 0, "operator: hold")
    assert bench.vehicles.asked == [("a", "stop"), ("b", "stop")]
    await bench.until(lambda: bench.vehicles.asked.count(("a", "hold")) == 2)
    assert bench.dispatcher.unconfirmed().keys() == {"a"}
    await bench.until(lambda: not bench.dispatcher.unconfirmed())
    assert bench.vehicles.asked.count(("a", "hold")) == 3
    assert any("not a number" in note for note in bench.notes)
    await bench.dispatcher.close()


async def test_after_the_end_of_a_stop_one_frame_leaves_and_no_task_is_left() -> None:
    bench = Bench("a")
    await bench.dispatcher.close()
    before = asyncio.all_tasks()
    bench.hold("a")
    bench.goto("a")
    assert asyncio.all_tasks() == before
    assert bench.vehicles.asked == [("a", "stop")]
    assert bench.dispatcher.answers["a"] == ("GoTo", "the mission is over")
