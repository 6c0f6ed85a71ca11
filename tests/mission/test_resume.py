"""After a kill: the same belief as if nothing had happened, vehicles adopted, nothing armed that was not."""

import asyncio
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from fieldkit import jumploop
from fieldkit.checks import Check, Level
from fieldkit.errors import RecordingError
from fieldkit.messages import GoTo, Hold, Operator, ReceiverState
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from mission.core.mission_file import Mission
from mission.lab.synthetic import small_mission
from mission.replay.replay import replay, resumable
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places


class Scene:
    """Robots and radios that outlive the runner."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.mission: Mission = small_mission(folder, duration_s=200.0)
        self.clock = jumploop.LoopClock(1_000 * 10**9)
        rovers = {name: Rover(*place) for name, place in start_places(self.mission).items()}
        self.fleet = FakeFleet(rovers, self.clock)
        self.radios = [FakeReceiver(name, self.clock) for name in rovers]

    def later(self) -> None:
        """The time at which somebody starts the mission again: a new loop counts from 0."""
        self.clock.start_ns += 100 * 10**9

    def setup(self) -> Setup:
        return Setup(self.clock, tuple(self.radios), (self.fleet,))

    async def noise(self) -> None:
        for k in range(100):
            await self.clock.sleep(2.0)
            for radio in self.radios[: 1 + k % 3]:
                radio.hear(-63.0 - k % 5)

    def killed(self, after_s: float = 30.0, before_kill: Callable[[Runner], None] = lambda _: None) -> Path:
        """Run, and keep the file as a kill at this moment would leave it."""
        left = self.folder / "left.mcap"

        async def go(runner: Runner) -> None:
            running = asyncio.create_task(runner.run())
            noise = asyncio.create_task(self.noise())
            await self.clock.sleep(after_s)
            before_kill(runner)
            await self.clock.sleep(2.0)
            shutil.copy(self.folder / "first.mcap", left)
            for task in (running, noise):
                task.cancel()
            await asyncio.wait({running, noise})

        with self.recorder("first.mcap") as recorder:
            jumploop.run(go(Runner(self.mission, self.setup(), recorder)))
        self.later()
        return left

    def recorder(self, name: str) -> RecordingWriter:
        return RecordingWriter(
            self.folder / name, mission_toml=self.mission.text, antenna_toml=self.mission.antenna_text
        )

    def resumed(self, left: Path) -> tuple[Runner, str]:
        """Resume and fly to the end; the runner, and the belief it began with."""
        past = open_recording(left)
        assert not past.complete
        with self.recorder("second.mcap") as recorder:
            runner = Runner(resumable(past), self.setup(), recorder)
            runner.rebuild(past.steps())
            begun = runner.kernel.digest()
            jumploop.run(runner.run())
        return runner, begun


def test_the_belief_is_the_same_and_the_new_recording_holds_everything(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    left = scene.killed()
    whole = replay(tmp_path / "first.mcap", check=False, until_s=replay(left).duration_s)
    runner, begun = scene.resumed(left)
    assert begun == whole.kernel.digest()
    assert runner.kernel.detections >= whole.kernel.detections > 0
    done = replay(tmp_path / "second.mcap")
    assert done.complete and done.kernel.digest() == runner.kernel.digest()
    events = [event for _, _, event in open_recording(tmp_path / "second.mcap").events()]
    before = [event for _, _, event in open_recording(left).events()]
    assert events[: len(before)] == before
    assert isinstance(events[len(before)], ReceiverState) and not events[len(before)].up  # type: ignore[union-attr]


def test_robots_go_on_after_being_adopted(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    left = scene.killed()
    count = len(list(open_recording(left).commands()))
    scene.resumed(left)
    after = list(open_recording(tmp_path / "second.mcap").commands())[count:]
    assert {c.robot for *_, origin, c in after if isinstance(c, GoTo) and origin == "safety"}


def test_what_is_disarmed_or_held_stays_so_until_the_operator_says_otherwise(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    left = scene.killed(
        before_kill=lambda runner: runner.put(Operator(runner.setup.clock.now_ns(), "hold", "r2"))
    )
    count = len(list(open_recording(left).commands()))
    scene.fleet._armed["r1"] = False
    scene.resumed(left)
    assert not scene.fleet._armed["r1"], "nothing is armed unasked"
    after = list(open_recording(tmp_path / "second.mcap").commands())[count:]
    # The last orders before the kill are worked out again from what was observed: they are in no file that was left.
    sent = {
        c.robot
        for _, t_ns, origin, c in after
        if isinstance(c, GoTo) and origin == "safety" and t_ns >= scene.clock.start_ns
    }
    assert sent == {"r3", "r4"}


def test_a_robot_that_is_silent_at_the_resume_keeps_none_of_the_others_from_going_on(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    left = scene.killed()
    count = len(list(open_recording(left).commands()))
    scene.fleet.silent.add("r4")
    runner, _ = scene.resumed(left)
    after = list(open_recording(tmp_path / "second.mcap").commands())[count:]
    asked, sent = (
        {c.robot for *_, origin, c in after if isinstance(c, GoTo) and origin == who}
        for who in ("kernel", "safety")
    )
    assert asked == {"r1", "r2", "r3"} and sent, "they are planned for, and go where that is safe"
    # r4 may be anywhere by now: what is refused the others is refused for where their paths lead, and nothing else.
    resumed_ns = min(t_ns for _, t_ns, _, c in after if isinstance(c, GoTo))
    refused = {
        c.reason
        for _, t_ns, _, c in after
        if isinstance(c, Hold) and c.robot != "r4" and t_ns > resumed_ns and "mission is over" not in c.reason
    }
    assert all(" comes within " in reason for reason in refused), refused
    assert runner.safety.robots["r4"].ordered == "withdraw"
    assert replay(tmp_path / "second.mcap").complete


def test_a_mission_that_is_over_is_not_resumed(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    with scene.recorder("first.mcap") as recorder:
        runner = Runner(scene.mission, scene.setup(), recorder)

        async def go() -> None:
            runner.put(Operator(scene.clock.now_ns(), "end"))
            await runner.run()

        jumploop.run(go())
    with pytest.raises(RecordingError, match="is over"):
        resumable(open_recording(tmp_path / "first.mcap"))


def test_a_recording_with_a_hole_is_refused(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    left = scene.killed(after_s=10.0)
    steps = list(open_recording(left).steps())
    with scene.recorder("second.mcap") as recorder, pytest.raises(RecordingError, match="event 6 is missing"):
        Runner(scene.mission, scene.setup(), recorder).rebuild(steps[:5] + steps[6:])


def test_a_robot_that_is_not_ready_keeps_the_others_from_nothing(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    left = scene.killed()
    count = len(list(open_recording(left).commands()))

    async def inspect(robot: str, demands: object = None) -> list[Check]:
        level: Level = "red" if robot == "r1" else "green"
        return [Check(robot, "failsafe", level, "it would drive on when we fall silent")]

    scene.fleet.inspect = inspect  # type: ignore[method-assign, assignment]
    scene.resumed(left)
    log = open_recording(tmp_path / "second.mcap")
    after = list(log.commands())[count:]
    assert {c.robot for *_, origin, c in after if isinstance(c, GoTo) and origin == "safety"} == {
        "r2",
        "r3",
        "r4",
    }
    withdrawn = [e for *_, e in log.events() if isinstance(e, Operator) and e.action == "withdraw"]
    assert [(e.robot, "would drive on" in e.reason) for e in withdrawn] == [("r1", True)]
