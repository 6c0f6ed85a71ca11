"""A radio that prints thousands of lines at once keeps nobody else from their turn."""

import asyncio
from collections.abc import AsyncIterator
from itertools import pairwise
from pathlib import Path

from fieldkit import jumploop
from fieldkit.jumploop import LoopClock
from fieldkit.messages import Event, Operator, ReceiverState, RssReading, Tick
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from mission.core.kernel import NOTHING, Outcome
from mission.lab.synthetic import small_mission
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places
from mission.shell.ticks import MOST_HEARD

MANY = 5 * MOST_HEARD


class Chatty(FakeReceiver):
    """Once it may, it gives all at once and waits for nothing in between, as a full queue does."""

    may: asyncio.Event

    async def readings(self) -> AsyncIterator[RssReading | ReceiverState]:  # type: ignore[override]
        self.may = asyncio.Event()
        await self.may.wait()
        for number in range(MANY):
            yield RssReading(
                self._clock.now_ns(), self.robot, -80.0, "lines", frame_id=f"a/{number % 256:02x}"
            )


class Flooded(FakeReceiver):
    """It hears 2,000 a second for a while, and much later once more; what nobody takes waits."""

    EVERY_NS, FOR_S, LATER_S = 500_000, 6, 15.0

    async def readings(self) -> AsyncIterator[RssReading | ReceiverState]:  # type: ignore[override]
        await self._clock.sleep(3.0)
        began_ns = self._clock.now_ns()
        for number in range(self.FOR_S * 10**9 // self.EVERY_NS):
            t_ns = began_ns + number * self.EVERY_NS
            if (ahead_ns := t_ns - self._clock.now_ns()) > 0:
                await self._clock.sleep(ahead_ns * 1e-9)
            yield RssReading(t_ns, self.robot, -80.0, "lines")
        await self._clock.sleep(self.LATER_S)
        yield RssReading(self._clock.now_ns(), self.robot, -80.0, "lines")


class Light(Runner):
    """Thinks about no reading: what a thousand of them cost is not what is looked at."""

    def decide(self, event: Event) -> Outcome:
        return NOTHING if isinstance(event, RssReading) else super().decide(event)


def test_a_stop_that_is_asked_for_amid_a_flood_of_readings_is_stepped_before_the_flood_is_over(
    tmp_path: Path,
) -> None:
    mission = small_mission(tmp_path, duration_s=20.0)
    clock = LoopClock(1_000 * 10**9)
    robots = mission.kernel.engine.robots
    fleet = FakeFleet({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
    chatty = Chatty(robots[0], clock)
    setup = Setup(clock, (chatty, *(FakeReceiver(name, clock) for name in robots[1:])), (fleet,))

    async def fly(runner: Runner) -> None:
        async def press() -> None:
            await clock.sleep(6.0)
            chatty.may.set()
            await asyncio.sleep(0)  # the flood has begun
            runner.put(Operator(clock.now_ns(), "hold", None, "operator"))

        async with asyncio.TaskGroup() as group:
            group.create_task(press())
            group.create_task(runner.run())

    with RecordingWriter(
        tmp_path / "mission.mcap", mission_toml=mission.text, antenna_toml=mission.antenna_text
    ) as recorder:
        jumploop.run(fly(Light(mission, setup, recorder)))
    events = [step.event for step in open_recording(tmp_path / "mission.mcap").steps()]
    at = next(n for n, event in enumerate(events) if isinstance(event, Operator) and event.action == "hold")
    assert sum(isinstance(event, RssReading) for event in events[:at]) <= MOST_HEARD
    heard = [n for n, event in enumerate(events) if isinstance(event, RssReading)]
    ticks = [n for n, event in enumerate(events) if isinstance(event, Tick)]
    assert len(heard) == MANY
    assert max(sum(a < n < b for n in heard) for a, b in pairwise(ticks)) <= 2 * MOST_HEARD


def test_what_is_too_old_to_be_thought_about_is_left_out_counted_and_said(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, duration_s=30.0)
    clock = LoopClock(1_000 * 10**9)
    robots = mission.kernel.engine.robots
    fleet = FakeFleet({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
    quiet = FakeReceiver(robots[1], clock)
    others = [FakeReceiver(name, clock) for name in robots[2:]]
    setup = Setup(clock, (Flooded(robots[0], clock), quiet, *others), (fleet,))

    async def fly(runner: Runner) -> None:
        async def hear() -> None:
            for _ in range(20):
                await clock.sleep(0.6)
                quiet.hear(-70.0)

        async with asyncio.TaskGroup() as group:
            group.create_task(hear())
            group.create_task(runner.run())

    with RecordingWriter(
        tmp_path / "mission.mcap", mission_toml=mission.text, antenna_toml=mission.antenna_text
    ) as recorder:
        jumploop.run(fly(Light(mission, setup, recorder)))
    log = open_recording(tmp_path / "mission.mcap")
    events = [(step.log_time_ns, step.event) for step in log.steps()]
    late_ns = mission.kernel.association_lateness_s * 1e9
    heard = [(t_ns, event) for t_ns, event in events if isinstance(event, RssReading)]
    assert all(t_ns - event.t_ns <= late_ns for t_ns, event in heard), "none is worked off that is too late"
    assert sum(event.robot == robots[1] for _, event in heard) == 20
    states = [event for _, event in events if isinstance(event, ReceiverState)]
    assert {state.robot for state in states} == {robots[0]}, "nobody else is down"
    assert sum(not state.up for state in states) >= 2 and states[-1].up
    counted = sum(int(state.reason.split()[0]) for state in states if state.reason.endswith("were left out"))
    taken = sum(event.robot == robots[0] for _, event in heard)
    assert counted + taken == 6 * 2_000 + 1 and taken > MOST_HEARD
    said = [note.text for _, note in log.notes() if "more than can be thought about" in note.text]
    assert said == [f"{robots[0]}: radio down: it says more than can be thought about: readings are left out"]
