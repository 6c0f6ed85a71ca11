"""A radio that hears -50 dBm once a second of the clock it is given."""

from collections.abc import AsyncIterator, Mapping
from types import TracebackType
from typing import Any, Self

from fieldkit.errors import ConfigError
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext, Receiver


class Regular:
    """See the module. Options: `rss_dbm`."""

    def __init__(self, robot: str, rss_dbm: float, around: DriverContext) -> None:
        self.robot = robot
        self._rss_dbm = rss_dbm
        self._clock = around.clock
        self._open = False

    async def __aenter__(self) -> Self:
        self._open = True
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False

    async def readings(self) -> AsyncIterator[RssReading | ReceiverState]:
        yield ReceiverState(self._clock.now_ns(), self.robot, True)
        while self._open:
            await self._clock.sleep(1.0)
            yield RssReading(self._clock.now_ns(), self.robot, self._rss_dbm, via="other")


def open_receiver(robot: str, options: Mapping[str, Any], around: DriverContext) -> Receiver:
    """What the entry point names. Raises `ConfigError` for a strength that no radio reports."""
    rss_dbm = float(options.get("rss_dbm", -50.0))
    if not -130.0 <= rss_dbm <= 20.0:
        raise ConfigError(f"robot {robot!r}: rss_dbm: expected -130 to 20, got {rss_dbm}")
    return Regular(robot, rss_dbm, around)
