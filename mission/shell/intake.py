"""What devices say, as events. A device that fails is a fact for the mission, not its end."""

import asyncio
import logging
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Container, Iterable, Sequence
from dataclasses import replace
from typing import Any

from fieldkit.clock import Clock
from fieldkit.errors import DeviceError, FieldkitError
from fieldkit.messages import Event, Pose, ReceiverState, RssReading, VehicleState
from fieldkit.ports import PositionSource, Receiver, VehicleLink
from fieldkit.settings import LATENESS_S
from mission.shell.dispatcher import Note

logger = logging.getLogger(__name__)

BY_SATELLITE = "gnss"
"""Origin of poses whose height is above the sea, and good to some ten metres."""
PAUSE_S = 2.0
"""Mission time for which nothing is taken from a receiver that says more than can be thought about."""
AT_ONCE = 200
"""So many old readings are left out before others have their turn."""


async def _room_for_all() -> bool:
    """Nobody waits."""
    return False


def streams_of(
    receivers: Iterable[Receiver],
    links: Iterable[VehicleLink],
    positions: Iterable[PositionSource],
    clock: Clock,
    note: Note,
    flying: Container[str] = (),
    room: Callable[[], Awaitable[bool]] = _room_for_all,
    lateness_s: float = LATENESS_S.default,
) -> list[tuple[str, AsyncIterator[Event]]]:
    """Every device's events, with its name. A robot that another source places has no poses from its link.

    `flying`: robots that leave the ground. What a satellite receiver says of the height of others is left out.
    `room` returns once another reception can be taken, and says whether that was waited for. Receptions may be as late
    as `lateness_s`, in mission time.
    """
    sources = tuple(positions)
    placed = {robot for source in sources for robot in source.robots}
    streams: list[tuple[str, AsyncIterator[Event]]] = [
        (f"receiver {r.robot}", from_receiver(r, clock, note, room, lateness_s)) for r in receivers
    ]
    streams += [(f"link {' '.join(link.robots)}", from_link(link, clock, placed)) for link in links]
    streams += [(f"positions {' '.join(p.robots)}", from_positions(p, note, flying)) for p in sources]
    return streams


async def from_receiver(
    receiver: Receiver, clock: Clock, note: Note, room: Callable[[], Awaitable[bool]], lateness_s: float
) -> AsyncIterator[Event]:
    """A receiver that fails is down. Why one is down is said, once for each reason: somebody can mend that."""
    why = ""
    try:
        async for reading in paced(receiver.readings(), receiver.robot, clock, room, lateness_s):
            if isinstance(reading, ReceiverState) and not reading.up:
                before, why = why, re.sub(r"\d+", "", reading.reason)  # for how long is no new reason
                if why != before:
                    logger.warning("%s: radio down: %s", receiver.robot, reading.reason)
                    note("warning", f"{receiver.robot}: radio down: {reading.reason}")
            yield reading
    except DeviceError as error:
        logger.warning("%s: receiver: %s", receiver.robot, error)
        yield ReceiverState(clock.now_ns(), receiver.robot, False, str(error))


async def paced(
    events: AsyncIterator[RssReading | ReceiverState],
    robot: str,
    clock: Clock,
    room: Callable[[], Awaitable[bool]],
    lateness_s: float,
) -> AsyncIterator[RssReading | ReceiverState]:
    """What a receiver says, no faster than it can be thought about.

    Else one that prints thousands of lines a second keeps everything from its turn: vehicles, the keyboard, a stop.
    What has waited for so long that it would soon be too late is left out and counted. The receiver is down meanwhile:
    that nothing is taken from it does not mean that nothing was heard.
    """
    up_ns, left_out = 0, 0
    async for event in events:
        if isinstance(event, RssReading):
            if event.t_ns < up_ns:
                left_out += 1
                if left_out % AT_ONCE == 0:
                    await asyncio.sleep(0)
                continue
            if left_out:
                yield ReceiverState(event.t_ns, robot, True, f"{left_out} readings were left out")
                left_out = 0
        waited = await room()
        if waited and isinstance(event, RssReading) and _age_s(event, clock) > lateness_s / 2:
            yield ReceiverState(
                event.t_ns, robot, False, "it says more than can be thought about: readings are left out"
            )
            await clock.sleep(PAUSE_S)
            up_ns, left_out = clock.now_ns(), 1
            yield ReceiverState(up_ns, robot, True, "it is listened to again")
            continue
        yield event
        if waited:
            await asyncio.sleep(0)  # else whoever says little would be late for one that says much


def _age_s(reading: RssReading, clock: Clock) -> float:
    return (clock.now_ns() - reading.t_ns) * 1e-9


async def from_link(link: VehicleLink, clock: Clock, placed: Container[str]) -> AsyncIterator[Event]:
    """A link that fails is down for all its robots; the others go on.

    Poses of robots in `placed` come from elsewhere.
    """
    try:
        async for event in link.events():
            if not (isinstance(event, Pose) and event.robot in placed):
                yield event
    except DeviceError as error:
        logger.warning("%s: link: %s", ", ".join(link.robots), error)
        for robot in link.robots:
            yield VehicleState(clock.now_ns(), robot, "unknown", False, False, None, str(error))


async def from_positions(
    source: PositionSource, note: Note, flying: Container[str] = ()
) -> AsyncIterator[Event]:
    """A source that fails leaves its robots without a position: safety holds them."""
    try:
        async for pose in source.poses():
            # Somebody on a plain 500 m above the sea is not 500 m from a transmitter at their feet.
            on_the_ground = pose.origin == BY_SATELLITE and pose.robot not in flying
            yield replace(pose, up_m=0.0) if on_the_ground else pose
    except DeviceError as error:
        logger.warning("positions of %s: %s", ", ".join(source.robots), error)
        note("warning", f"positions of {', '.join(source.robots)}: {error}")


async def end_tasks(tasks: Sequence["asyncio.Task[Any]"]) -> None:
    """End the tasks that take in; what they still say goes to the log."""
    for task in tasks:
        task.cancel()
    for outcome in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(outcome, FieldkitError):
            logger.warning("while closing: %s", outcome)
