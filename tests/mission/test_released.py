"""A robot that the operator has given to somebody else: no word to all takes it back, and no end stops it."""

import asyncio
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from small_field import Field

from fieldkit import jumploop
from fieldkit.clock import Clock, ScaledClock
from fieldkit.jumploop import LoopClock
from fieldkit.messages import Command, Hold, Operator, Tick
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from mission.core.kernel import Kernel, Outcome
from mission.lab.synthetic import small_mission
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places


def of(robot: str, commands: list[Command]) -> list[type[Command]]:
    return [type(command) for command in commands if getattr(command, "robot", "") == robot]


@pytest.mark.parametrize("action", ["resume", "return", "end"])
def test_a_word_to_all_leaves_it_alone_and_its_own_name_does_not(action: str) -> None:
    field = Field()
    field.at["a"] = (2.0, 12.0)
    field.tick(5)
    field.ask("release", "a")
    field.log.clear()
    field.ask(action)
    assert of("a", field.log) == []
    assert field.safety.robots["a"].ordered == "release" and field.safety.ours() == ["b"]
    field.ask(action, "a")
    assert field.safety.robots["a"].ordered != "release"


def test_hold_all_stops_it_and_it_stays_released() -> None:
    field = Field()
    field.ask("release", "a")
    field.log.clear()
    field.ask("hold")
    assert of("a", field.log) == of("b", field.log) == [Hold]
    field.ask("resume")
    assert field.safety.robots["a"].ordered == "release" and field.safety.robots["b"].ordered == ""


def test_the_end_stops_nobody_whom_somebody_else_steers() -> None:
    field = Field()
    field.send(("a", 2.0, 12.0))
    field.mode["a"] = "other"
    field.tick()
    field.log.clear()
    field.ask("end")
    assert of("a", field.log) == [] and of("b", field.log) == [Hold]
    field.ask("hold")
    assert of("a", field.log) == [Hold], "hold is meant for all"


def test_it_is_planned_for_no_more_until_its_own_name_is_called(tmp_path: Path) -> None:
    kernel = Kernel(small_mission(tmp_path).kernel)
    robot = kernel.robots["r1"]
    for action, name, held in (
        ("release", "r1", True),
        ("resume", None, True),
        ("withdraw", "r1", True),
        ("resume", None, True),
        ("resume", "r1", False),
        ("hold", None, True),
        ("resume", None, False),
    ):
        kernel.step(Operator(0, action, name))  # type: ignore[arg-type]
        assert robot.held == held, (action, name)


class Fleet(FakeFleet):
    """Keeps what it was told, as it was told."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.told: list[tuple[str, str]] = []

    def stop(self, robot: str) -> None:
        self.told.append((robot, "stop"))
        super().stop(robot)

    async def acquire_control(self, robot: str, *, arm: bool = True) -> None:
        self.told.append((robot, "acquire"))
        await super().acquire_control(robot, arm=arm)


def flown(
    folder: Path, act: Any, clock: Clock | None = None, overrun_s: float = 60.0
) -> tuple[Runner, Fleet]:
    """A mission on a loop whose time jumps, or on `clock`."""
    mission = small_mission(folder, duration_s=600.0)
    mission = replace(mission, safety=replace(mission.safety, overrun_s=overrun_s))
    run = jumploop.run if clock is None else asyncio.run
    clock = clock or LoopClock(1_000 * 10**9)
    fleet = Fleet({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
    setup = Setup(clock, tuple(FakeReceiver(name, clock) for name in mission.kernel.engine.robots), (fleet,))

    async def go(runner: Runner) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(act(runner, fleet))
            group.create_task(runner.run())

    with RecordingWriter(folder / "mission.mcap") as recorder:
        runner = Runner(mission, setup, recorder)
        run(go(runner))
    return runner, fleet


def test_resume_all_and_the_end_of_a_mission_send_it_nothing(tmp_path: Path) -> None:
    async def act(runner: Runner, fleet: Fleet) -> None:
        clock = runner.setup.clock
        await clock.sleep(10.0)
        runner.put(Operator(clock.now_ns(), "release", "r1"))
        await clock.sleep(2.0)
        fleet.told.clear()
        runner.put(Operator(clock.now_ns(), "resume"))
        await clock.sleep(5.0)
        runner.put(Operator(clock.now_ns(), "end"))

    _, fleet = flown(tmp_path, act)
    assert {robot for robot, _ in fleet.told} == {"r2", "r3", "r4"}


def test_the_end_is_on_the_wire_before_the_kernel_has_thought(tmp_path: Path) -> None:
    """Ctrl-C waits for nothing, as Enter does."""
    at_once: list[tuple[str, str]] = []

    async def act(runner: Runner, fleet: Fleet) -> None:
        await runner.setup.clock.sleep(10.0)
        fleet.told.clear()
        runner._signalled("SIGINT")
        at_once.extend(fleet.told)

    runner, _ = flown(tmp_path, act)
    assert at_once == [(robot, "stop") for robot in ("r1", "r2", "r3", "r4")]
    assert runner.unconfirmed == [] and runner.end_reason == "stopped by Ctrl-C"


@pytest.mark.timeout(120)
def test_a_late_kernel_holds_those_that_are_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    late, goes_on, genuine = threading.Event(), threading.Event(), Kernel.step

    def slowly(kernel: Kernel, event: Any) -> Outcome:
        if isinstance(event, Tick) and late.is_set():
            goes_on.wait(60.0)
        return genuine(kernel, event)

    monkeypatch.setattr(Kernel, "step", slowly)
    told: list[tuple[str, str]] = []

    async def act(runner: Runner, fleet: Fleet) -> None:
        clock = runner.setup.clock
        while runner.kernel.started_ns is None:
            await clock.sleep(0.5)
        runner.put(Operator(clock.now_ns(), "release", "r1"))
        while runner.safety.robots["r1"].ordered != "release":
            await clock.sleep(0.5)
        fleet.told.clear()
        late.set()
        while ("r4", "stop") not in fleet.told:
            await clock.sleep(0.5)
        told.extend(fleet.told)
        goes_on.set()
        runner.put(Operator(clock.now_ns(), "end"))

    flown(tmp_path, act, ScaledClock(5.0), overrun_s=3.0)
    assert {robot for robot, _ in told} == {"r2", "r3", "r4"}
