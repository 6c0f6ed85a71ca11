"""Benches for the in-process fakes and for recordings played through the ports."""

import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from fieldkit.clock import RealClock, ScaledClock
from fieldkit.messages import Pose, RssReading
from fieldkit.recording.player import PlayedPositions, PlayedReceiver
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.testing import PositionSourceBench, ReceiverBench, VehicleLinkBench
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver


@asynccontextmanager
async def fake_receiver() -> AsyncIterator[ReceiverBench]:
    receiver = FakeReceiver("ada", RealClock())

    async def transmit(count: int) -> None:
        for number in range(count):
            receiver.hear(-60.0 - number)

    async def unplug() -> None:
        receiver.set_up(False, "unplugged")

    async def replug() -> None:
        receiver.set_up(True)

    yield ReceiverBench(receiver, transmit, unplug, replug)


def recorded(folder: Path) -> Path:
    """A recording of 40 readings and poses, a millisecond apart."""
    path = folder / "log.mcap"
    with RecordingWriter(path) as writer:
        number = 0
        for k in range(40):
            for event in (Pose(k * 10**6, "ada", k * 0.01, 1.0), RssReading(k * 10**6, "ada", -60.0 - k)):
                number += 1
                writer.event(number, k * 10**6, event)
    return path


@asynccontextmanager
async def played_receiver() -> AsyncIterator[ReceiverBench]:
    with tempfile.TemporaryDirectory() as folder:
        receiver = PlayedReceiver("ada", open_recording(recorded(Path(folder))), ScaledClock(100.0))
        told = 0

        async def transmit(count: int) -> None:
            nonlocal told
            told += count  # a recording transmits by itself

        yield ReceiverBench(_Counted(receiver, lambda: told), transmit)


class _Counted:
    """Gives no more recorded readings than the bench has had transmitted."""

    def __init__(self, receiver: PlayedReceiver, allowed: object) -> None:
        self._receiver, self._allowed = receiver, allowed
        self.robot = receiver.robot
        self._given = 0

    async def __aenter__(self) -> "_Counted":
        await self._receiver.__aenter__()
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._receiver.__aexit__(None, None, None)

    async def readings(self) -> AsyncIterator[object]:
        if self._given >= self._allowed():  # type: ignore[operator]
            return
        async for item in self._receiver.readings():
            self._given += 1
            yield item
            if self._given >= self._allowed():  # type: ignore[operator]
                return


@asynccontextmanager
async def fake_fleet() -> AsyncIterator[VehicleLinkBench]:
    clock = ScaledClock(10.0)
    starts = {"ada": (1.0, 1.0), "bob": (5.0, 1.0)}
    link = FakeFleet({name: Rover(*place, max_speed_m_s=1.0) for name, place in starts.items()}, clock)
    yield VehicleLinkBench(link, clock, starts)


class FakePositions:
    """Poses by a clock, of robots that stand still."""

    def __init__(self, robots: tuple[str, ...]) -> None:
        self.robots = robots
        self._closed = True

    async def __aenter__(self) -> "FakePositions":
        self._closed = False
        return self

    async def __aexit__(self, *error: object) -> None:
        self._closed = True

    async def poses(self) -> AsyncIterator[Pose]:
        clock = RealClock()
        while not self._closed:
            for robot in self.robots:
                yield Pose(clock.now_ns(), robot, 1.0, 2.0)
            await clock.sleep(0.01)


@asynccontextmanager
async def fake_positions() -> AsyncIterator[PositionSourceBench]:
    yield PositionSourceBench(FakePositions(("ada", "bob")))


@asynccontextmanager
async def played_positions() -> AsyncIterator[PositionSourceBench]:
    with tempfile.TemporaryDirectory() as folder:
        recording = open_recording(recorded(Path(folder)))
        yield PositionSourceBench(PlayedPositions(("ada",), recording, ScaledClock(0.1)))
