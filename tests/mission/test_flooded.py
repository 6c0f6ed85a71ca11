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
