"""The shell over in-process stand-ins: start, faults, end; and what it leaves behind."""

import asyncio
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from sizes import size

from fieldkit import jumploop
from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceError, DeviceTimeout
from fieldkit.jumploop import LoopClock
from fieldkit.messages import GoTo, Hold, Operator, Pose, ReceiverState, Tick, Waypoint
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from mission.lab.synthetic import small_mission
from mission.replay.replay import replay
from mission.shell.progress import Progress
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places


class Deaf(FakeReceiver):
    """A receiver whose device breaks as soon as it is listened to."""

    async def readings(self):  # type: ignore[no-untyped-def, override]
        raise DeviceError("usb 1-2: device not responding")
        yield


def setup_for(mission, receivers=FakeReceiver) -> Setup:  # type: ignore[no-untyped-def]
    """On a loop whose time jumps: a busy machine must not look like a late mission."""
    clock = LoopClock(1_000 * 10**9)
    fleet = FakeFleet({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
    return Setup(clock, tuple(receivers(name, clock) for name in mission.kernel.engine.robots), (fleet,))


def fly(folder: Path, setup_of=setup_for, duration_s: float = 40.0, act=None) -> tuple[Runner, Setup]:  # type: ignore[no-untyped-def]
    mission = small_mission(folder, duration_s=duration_s)
    setup = setup_of(mission)

    async def go(runner: Runner) -> None:
        if act is None:
            await runner.run()
            return
        async with asyncio.TaskGroup() as group:
            group.create_task(act(runner, setup))
            group.create_task(runner.run())

    with RecordingWriter(
        folder / "mission.mcap", mission_toml=mission.text, antenna_toml=mission.antenna_text
    ) as recorder:
        runner = Runner(mission, setup, recorder)
        jumploop.run(go(runner))
    return runner, setup


def test_a_mission_takes_over_steers_and_ends_with_all_holding(tmp_path: Path) -> None:
    runner, setup = fly(tmp_path)
    assert "time is up" in runner.end_reason
    fleet = setup.links[0]
    assert isinstance(fleet, FakeFleet)
    assert set(fleet._mode.values()) == {"hold"}
    assert 2 * 40 <= fleet.beats <= 2 * 40 + 12, (
        "two a second, and some while control is acquired and released"
    )
    steered = {
        c.robot for _, _, _, c in open_recording(tmp_path / "mission.mcap").commands() if isinstance(c, GoTo)
    }
    assert steered == set(runner.kernel.settings.engine.robots)


def test_its_recording_is_whole_and_replays(tmp_path: Path) -> None:
    async def noise(runner: Runner, setup: Setup) -> None:
        for k in range(6):
            await setup.clock.sleep(4.0)
            for receiver in setup.receivers[: 1 + k % 3]:
                receiver.hear(-64.0 - k)  # type: ignore[attr-defined]

    runner, _ = fly(tmp_path, act=noise)
    done = replay(tmp_path / "mission.mcap")
    assert done.complete
    assert done.kernel.detections == runner.kernel.detections > 0
    assert done.kernel.digest() == runner.kernel.digest()


def test_a_receiver_that_breaks_does_not_end_the_mission(tmp_path: Path) -> None:
    runner, _ = fly(tmp_path, setup_of=lambda mission: setup_for(mission, Deaf), duration_s=15.0)
    assert "time is up" in runner.end_reason


def test_the_operators_hold_reaches_every_vehicle(tmp_path: Path) -> None:
    async def press(runner: Runner, setup: Setup) -> None:
        await setup.clock.sleep(10.0)
        runner.put(Operator(setup.clock.now_ns(), "hold"))

    fly(tmp_path, act=press)
    recording = open_recording(tmp_path / "mission.mcap")
    commands = [
        (number, command) for number, _, origin, command in recording.commands() if origin == "safety"
    ]
    pressed = next(number for number, _, event in recording.events() if isinstance(event, Operator))
    assert {c.robot for n, c in commands if n == pressed and isinstance(c, Hold)} == {"r1", "r2", "r3", "r4"}
    assert not [c for n, c in commands if n > pressed and isinstance(c, GoTo)]


def test_a_position_source_takes_the_place_of_telemetry(tmp_path: Path) -> None:
    class Overhead:
        """Says that r1 stands still at a place of its own."""

        robots = ("r1",)

        def __init__(self, clock: LoopClock) -> None:
            self.clock = clock

        async def __aenter__(self) -> "Overhead":
            return self

        async def __aexit__(self, *_: object) -> None:
            pass

        async def poses(self):  # type: ignore[no-untyped-def]
            for _ in range(10_000):
                yield Pose(self.clock.now_ns(), "r1", 7.7, 7.7, origin="camera")
                await self.clock.sleep(0.25)

    def with_camera(mission) -> Setup:  # type: ignore[no-untyped-def]
        setup = setup_for(mission)
        return replace(setup, positions=(Overhead(setup.clock),))  # type: ignore[arg-type]

    fly(tmp_path, setup_of=with_camera, duration_s=10.0)
    poses = [e for _, _, e in open_recording(tmp_path / "mission.mcap").events() if isinstance(e, Pose)]
    assert {p.origin for p in poses if p.robot == "r1"} == {"camera"}
    assert {p.origin for p in poses if p.robot == "r2"} == {"sim"}


def test_every_reception_is_looked_at_as_soon_as_it_can_be(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, duration_s=10.0 + 1.5 * (turns := size(6, 20)))
    quick = replace(mission.kernel, association_window_s=0.01, association_lateness_s=0.01)
    mission = replace(mission, kernel=quick)
    setup = setup_for(mission)

    async def hear(after_s: float) -> None:
        await setup.clock.sleep(after_s)
        setup.receivers[0].hear(-64.0)  # type: ignore[attr-defined]

    async def go() -> None:
        async with asyncio.TaskGroup() as group:
            # The second comes while the first is still waited for, the third after that.
            for k in range(turns):
                for apart_s in (0.0, 0.015, 0.04):
                    group.create_task(hear(5.037 + 1.571 * k + apart_s))
            group.create_task(Runner(mission, setup, recorder).run())

    with RecordingWriter(tmp_path / "log.mcap") as recorder:
        jumploop.run(go())
    looked = list(open_recording(tmp_path / "log.mcap").detections())
    assert len(looked) == 3 * turns
    assert max(log_ns - detection.t_ns for _, log_ns, detection in looked) <= 23_000_000


def test_silent_vehicles_are_named_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mission.shell.start.READY_TIMEOUT_S", 5.0)

    class Mute(FakeFleet):
        async def _drive(self) -> None:
            await asyncio.Event().wait()

    def silent(mission) -> Setup:  # type: ignore[no-untyped-def]
        clock = LoopClock(1_000 * 10**9)
        rovers = {name: Rover(*place) for name, place in start_places(mission).items()}
        return Setup(clock, (), (Mute(rovers, clock),))

    with pytest.raises(DeviceTimeout, match="no telemetry from r1, r2, r3, r4"):
        fly(tmp_path, setup_of=silent)
    assert open_recording(tmp_path / "mission.mcap").complete


def test_a_mistake_in_the_kernel_holds_the_vehicles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fleets: list[FakeFleet] = []

    def keep(mission) -> Setup:  # type: ignore[no-untyped-def]
        setup = setup_for(mission)
        fleets.append(setup.links[0])  # type: ignore[arg-type]
        return setup

    from mission.core.kernel import Kernel

    genuine = Kernel._reason_to_end

    def fails(kernel: Kernel, now_ns: int, detections: bool) -> str:
        if kernel.elapsed_s(now_ns) > 5.0:
            raise ZeroDivisionError("a mistake")
        return genuine(kernel, now_ns, detections)

    monkeypatch.setattr(Kernel, "_reason_to_end", fails)
    with pytest.raises(ZeroDivisionError):
        fly(tmp_path, setup_of=keep)
    assert set(fleets[0]._mode.values()) == {"hold"}
    assert open_recording(tmp_path / "mission.mcap").complete


def test_progress_says_what_each_robot_does(tmp_path: Path) -> None:
    seen: list[Progress] = []
    mission = small_mission(tmp_path, duration_s=15.0)
    with RecordingWriter(tmp_path / "log.mcap") as recorder:
        jumploop.run(Runner(mission, setup_for(mission), recorder, seen.append).run())
    assert seen[-1].doing.keys() == set(mission.kernel.engine.robots)
    assert any(note.startswith("end:") for progress in seen for note in progress.notes)


def test_the_last_that_is_shown_is_the_last_look_at_the_belief(tmp_path: Path) -> None:
    """The page has it too: two surfaces must not say different things of one mission."""
    seen: list[Progress] = []
    mission = small_mission(tmp_path, duration_s=15.0)
    with RecordingWriter(tmp_path / "log.mcap") as recorder:
        runner = Runner(mission, setup_for(mission), recorder, seen.append)
        jumploop.run(runner.run())
    assert seen[-1].probability_left == runner.kernel.belief.probability_left()
    assert seen[-1].probability_left != seen[-2].probability_left


async def test_the_fake_fleet_refuses_what_a_vehicle_would(tmp_path: Path) -> None:
    clock = ScaledClock(20.0)
    async with FakeFleet({"a": Rover(0.0, 0.0)}, clock) as fleet:
        with pytest.raises(DeviceError, match="take it over"):
            await fleet.goto("a", Waypoint(1.0, 1.0, 0.3))
        with pytest.raises(DeviceError, match="no vehicle 'b'"):
            await fleet.hold("b")


def test_a_laptop_that_slept_holds_everybody_and_goes_on(tmp_path: Path) -> None:
    """A minute in which nothing ran: the clock has gone on, every position is old, the vehicles held by themselves."""

    async def sleep(runner: Runner, setup: Setup) -> None:
        await setup.clock.sleep(10.0)
        clock = setup.clock
        assert isinstance(clock, LoopClock)
        clock.start_ns += 60 * 10**9

    runner, _ = fly(tmp_path, act=sleep, duration_s=110.0)
    log = open_recording(tmp_path / "mission.mcap")
    assert log.complete and "time is up" in runner.end_reason
    woke_ns = next(
        after.t_ns
        for before, after in pairwise([e for *_, e in log.events() if isinstance(e, Tick)])
        if after.t_ns - before.t_ns > 30 * 10**9
    )
    allowed = [c for *_, origin, c in log.commands() if origin == "safety"]
    held = {c.robot for c in allowed if isinstance(c, Hold) and 0 <= c.t_ns - woke_ns < 3 * 10**9}
    assert held == set(runner.kernel.settings.engine.robots)
    assert any(isinstance(c, GoTo) and c.t_ns > woke_ns + 3 * 10**9 for c in allowed), "then it goes on"
    assert replay(tmp_path / "mission.mcap").complete


def test_after_a_sleep_radios_say_that_nobody_read_them_before_that_silence_is_thought_about(
    tmp_path: Path,
) -> None:
    """A reader thread looks ten times a second: it notices within 0.1 s of waking."""

    async def sleep(runner: Runner, setup: Setup) -> None:
        clock = setup.clock
        await clock.sleep(10.0)
        before_ns = clock.now_ns()
        loop = asyncio.get_running_loop()
        assert isinstance(loop, jumploop.JumpLoop)
        loop._jumping.now_s += 60.0
        await clock.sleep(0.1)
        for receiver in setup.receivers:
            assert isinstance(receiver, FakeReceiver)
            receiver._stream.put(ReceiverState(before_ns, receiver.robot, False, "nobody read it"))
            receiver.set_up(True, "it is read again")

    fly(tmp_path, act=sleep, duration_s=100.0)
    ticks: list[tuple[int, int]] = []
    said: list[int] = []
    for number, _, event in open_recording(tmp_path / "mission.mcap").events():
        if isinstance(event, Tick):
            ticks.append((number, event.t_ns))
        if isinstance(event, ReceiverState) and event.reason:
            said.append(number)
    woke = next(number for (_, before_ns), (number, t_ns) in pairwise(ticks) if t_ns - before_ns > 30 * 10**9)
    assert said and max(said) < woke


def test_a_full_disk_is_an_alarm_for_as_long_as_it_lasts_and_what_was_found_is_kept(tmp_path: Path) -> None:
    seen: list[Progress] = []
    mission = small_mission(tmp_path, duration_s=20.0)
    setup = setup_for(mission)

    class Full:
        def __getattr__(self, name: str) -> object:
            raise OSError(28, "No space left on device")

    async def go(runner: Runner, recorder: RecordingWriter) -> None:
        running = asyncio.create_task(runner.run())
        await setup.clock.sleep(8.0)
        recorder._mcap._Writer__stream = Full()  # type: ignore[attr-defined]
        await running

    with RecordingWriter(tmp_path / "log.mcap") as recorder:
        runner = Runner(mission, setup, recorder, seen.append)
        jumploop.run(go(runner, recorder))
    assert "time is up" in runner.end_reason
    late = [progress for progress in seen if progress.elapsed_s > 14.0]
    assert late and all("NOTHING IS RECORDED" in " ".join(progress.alarms) for progress in late)
    assert runner.result()["events"] > 0
    assert list(open_recording(tmp_path / "log.mcap").events()), "what was written before can be read"


def test_a_stop_that_is_not_shown_is_an_alarm_while_others_are_still_being_acquired(tmp_path: Path) -> None:
    """Before the first tick, which is what shows alarms otherwise."""

    class Slow(FakeFleet):
        async def acquire_control(self, robot: str, *, arm: bool = True) -> None:
            await asyncio.sleep(20.0)
            await super().acquire_control(robot, arm=arm)

        async def hold(self, robot: str) -> None:
            raise DeviceTimeout(f"{robot}: does not answer")

    mission = small_mission(tmp_path, duration_s=5.0)
    clock = LoopClock(1_000 * 10**9)
    fleet = Slow({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
    names = mission.kernel.engine.robots
    setup = Setup(clock, tuple(FakeReceiver(name, clock) for name in names), (fleet,))
    seen: list[tuple[bool, tuple[str, ...]]] = []
    flushed: list[float] = []

    class Page(RecordingWriter):
        def flush(self) -> None:
            flushed.append(clock.elapsed_s())

    async def go(runner: Runner) -> None:
        running = asyncio.create_task(runner.run())
        await clock.sleep(2.0)
        runner.put(Operator(clock.now_ns(), "hold", names[0]))
        await clock.sleep(6.0)
        fleet.hold = lambda robot: FakeFleet.hold(fleet, robot)  # type: ignore[method-assign]
        await running

    with RecordingWriter(tmp_path / "log.mcap") as recorder, Page(tmp_path / "page.mcap") as page:
        runner = Runner(mission, setup, recorder, followers=(page,))
        runner.on_progress = lambda progress: seen.append((runner.kernel.started_ns is None, progress.alarms))
        jumploop.run(go(runner))
    before = [alarms for is_before, alarms in seen if is_before]
    assert sum(f"{names[0]} has not shown" in " ".join(alarms) for alarms in before) > 3
    assert before[-1] == (), "and that it has passed is shown too"
    assert [s for s in flushed if 4.0 < s < 9.0]
