"""What devices say, as events. A device that fails is a fact for the mission, not its end."""

import asyncio
import logging
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Container, Iterable, Sequence
from dataclasses import replace
from typing import Any

from fieldkit.clock import Clock
from fieldkit.errors import DeviceError, FieldkitError
from fieldkit.messages import Event, Pose, ReceiverState, VehicleState
from fieldkit.ports import PositionSource, Receiver, VehicleLink
from mission.shell.dispatcher import Note

logger = logging.getLogger(__name__)

BY_SATELLITE = "gnss"
"""Origin of poses whose height is above the sea, and good to some ten metres."""


async def _room_for_all() -> None:
    """Nobody waits."""


def streams_of(
    receivers: Iterable[Receiver],
    links: Iterable[VehicleLink],
    positions: Iterable[PositionSource],
    clock: Clock,
    note: Note,
    flying: Container[str] = (),
    room: Callable[[], Awaitable[None]] = _room_for_all,
) -> list[tuple[str, AsyncIterator[Event]]]:
    """Every device's events, with its name. A robot that another source places has no poses from its link.

    `flying`: robots that leave the ground. What a satellite receiver says of the height of others is left out.
    `room` returns once another reception can be taken.
    """
    sources = tuple(positions)
    placed = {robot for source in sources for robot in source.robots}
    streams: list[tuple[str, AsyncIterator[Event]]] = [
        (f"receiver {r.robot}", paced(from_receiver(r, clock, note), room)) for r in receivers
    ]
    streams += [(f"link {' '.join(link.robots)}", from_link(link, clock, placed)) for link in links]
    streams += [(f"positions {' '.join(p.robots)}", from_positions(p, note, flying)) for p in sources]
    return streams


async def from_receiver(receiver: Receiver, clock: Clock, note: Note) -> AsyncIterator[Event]:
    """A receiver that fails is down. Why one is down is said, once for each reason: somebody can mend that."""
    why = ""
    try:
        async for reading in receiver.readings():
            if isinstance(reading, ReceiverState) and not reading.up:
                before, why = why, re.sub(r"\d+", "", reading.reason)  # for how long is no new reason
                if why != before:
                    logger.warning("%s: radio down: %s", receiver.robot, reading.reason)
                    note("warning", f"{receiver.robot}: radio down: {reading.reason}")
            yield reading
    except DeviceError as error:
        logger.warning("%s: receiver: %s", receiver.robot, error)
        yield ReceiverState(clock.now_ns(), receiver.robot, False, str(error))


async def paced(events: AsyncIterator[Event], room: Callable[[], Awaitable[None]]) -> AsyncIterator[Event]:
    """What a receiver says, no faster than it can be thought about: what its driver has no place for it counts.

    Else one that prints thousands of lines a second keeps everything from its turn: vehicles, the keyboard, a stop.
    """
    async for event in events:
        await room()
        yield event


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
