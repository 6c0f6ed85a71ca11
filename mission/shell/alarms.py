"""Alarms while no tick shows them: vehicles are still being acquired, and one may have been ordered to stop."""

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager

from fieldkit.clock import Clock

LOOK_EVERY_S = 0.5


@asynccontextmanager
async def alarms_shown(
    alarms: Callable[[], Sequence[str]], show: Callable[[], None], clock: Clock
) -> AsyncIterator[None]:
    """Call `show` again and again while there are alarms, and once more when they have passed."""
    task = asyncio.create_task(_keep_showing(alarms, show, clock), name="alarms")
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait({task})


async def _keep_showing(alarms: Callable[[], Sequence[str]], show: Callable[[], None], clock: Clock) -> None:
    shown = False
    while True:
        await clock.sleep(LOOK_EVERY_S)
        there_are = bool(alarms())
        if there_are or shown:
            show()
        shown = there_are
