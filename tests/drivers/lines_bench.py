"""A receiver of printed lines, and what it gives as it comes."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from drivers.lines.receiver import open_receiver
from fieldkit.clock import RealClock
from fieldkit.geo import FieldFrame
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext


def context() -> DriverContext:
    return DriverContext(RealClock(), FieldFrame(0.0, 0.0))


class Collected:
    """What a receiver gives, as it comes."""

    def __init__(self) -> None:
        self.items: list[Any] = []

    @property
    def readings(self) -> list[RssReading]:
        return [item for item in self.items if isinstance(item, RssReading)]

    @property
    def states(self) -> list[ReceiverState]:
        return [item for item in self.items if isinstance(item, ReceiverState)]

    @property
    def is_up(self) -> bool:
        return not self.states or self.states[-1].up

    async def until(self, fits: Callable[["Collected"], bool]) -> None:
        async with asyncio.timeout(15.0):
            while not fits(self):  # noqa: ASYNC110 - it is the list that is watched
                await asyncio.sleep(0.01)


@asynccontextmanager
async def receiving(**options: Any) -> AsyncIterator[Collected]:
    seen = Collected()

    async def collect() -> None:
        async for item in receiver.readings():
            seen.items.append(item)

    async with open_receiver("ada", options, context()) as receiver:
        task = asyncio.create_task(collect())
        yield seen
    await task
