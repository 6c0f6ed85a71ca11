"""Alarms while no tick shows them: vehicles are still being acquired, and one may have been ordered to stop."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from contextlib import asynccontextmanager

from fieldkit.clock import Clock

LOOK_EVERY_S = 0.5
LATE_STOP_S = 1.5
"""A stop that takes longer to be shown than over a poor link is an alarm."""


def late_stops(unconfirmed: Mapping[str, float]) -> list[str]:
    """Robots that have been ordered to stop, and for so many seconds have not shown it."""
    late = {name: late_s for name, late_s in unconfirmed.items() if late_s >= LATE_STOP_S}
    return [f"{name} has not shown for {late_s:.0f} s that it holds" for name, late_s in late.items()]


def unrecorded(failures: Iterable[str]) -> list[str]:
    """What is not written down any more, of several files, by why each has failed; "" where one has not."""
    return [f"NOT ALL IS RECORDED: {each}" for each in failures if each]


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
