"""A recording behind the ports: a receiver and a position source that give again what was recorded."""

from collections.abc import AsyncIterator
from types import TracebackType
from typing import Self

from fieldkit.clock import Clock
from fieldkit.messages import Pose, ReceiverState, RssReading
from fieldkit.recording.reader import Recording


class _Player:
    """Opening starts at the beginning; closing ends the streams."""

    def __init__(self, recording: Recording, clock: Clock) -> None:
        self._recording = recording
        self._clock = clock
        self._open = False

    async def __aenter__(self) -> Self:
        self._open = True
        self._events = self._recording.events()
        self._began_ns = self._clock.now_ns()
        self._first_ns: int | None = None
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False

    async def _wait_for(self, log_ns: int) -> None:
        """Until the moment this event entered the recorded inbox, by the clock's rate."""
        if self._first_ns is None:
            self._first_ns = log_ns
        ahead_s = ((log_ns - self._first_ns) - (self._clock.now_ns() - self._began_ns)) * 1e-9
        if ahead_s > 0.0:
            await self._clock.sleep(ahead_s)


class PlayedReceiver(_Player):
    """One robot's recorded readings as a `Receiver`, at the recording's own pace."""

    def __init__(self, robot: str, recording: Recording, clock: Clock) -> None:
        super().__init__(recording, clock)
        self.robot = robot

    async def readings(self) -> AsyncIterator[RssReading | ReceiverState]:
        """Ends with the recording, or when closed. A consumer that was cancelled is followed up where it was."""
        for _, log_ns, event in self._events:
            if isinstance(event, RssReading | ReceiverState) and event.robot == self.robot:
                await self._wait_for(log_ns)
                if not self._open:
                    return
                yield event


class PlayedPositions(_Player):
    """Recorded poses as a `PositionSource`."""

    def __init__(self, robots: tuple[str, ...], recording: Recording, clock: Clock) -> None:
        super().__init__(recording, clock)
        self.robots = robots

    async def poses(self) -> AsyncIterator[Pose]:
        """Ends with the recording, or when closed."""
        for _, log_ns, event in self._events:
            if isinstance(event, Pose) and event.robot in self.robots:
                await self._wait_for(log_ns)
                if not self._open:
                    return
                yield event
