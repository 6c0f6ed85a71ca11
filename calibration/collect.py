"""Guided collection with a real receiver: ask where, listen, say what came and what is still missing."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from calibration.collection import Place, from_csv, packets_from, still_missing, to_csv
from fieldkit.clock import Clock
from fieldkit.errors import DeviceError
from fieldkit.files import write_whole
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import Receiver
from fieldkit.recording import RecordingWriter

Ask = Callable[[str], str]
Say = Callable[[str], None]
QUESTION = "distance in m, heading if known (as '2.5' or '2.5 90'), u: undo, q: done"


@dataclass(frozen=True, slots=True)
class Beacon:
    """What the transmitter does."""

    period_s: float
    packets: int
    """How many to wait for at each place."""
    source: str = ""
    """Its address as frames carry it; others are not counted. Empty: take everything heard."""


async def collect(
    receiver: Receiver,
    clock: Clock,
    beacon: Beacon,
    out: Path,
    ask: Ask,
    say: Say,
    recorder: RecordingWriter | None = None,
) -> list[Place]:
    """Fill `out` place by place until the operator is done; an existing file of ours is gone on with.

    Raises `DeviceError` if the receiver is lost while listening: the place in hand is not written.
    """
    places = await asyncio.to_thread(_already, out)
    if places:
        say(f"{out}: going on after {len(places)} places")
    inbox: list[RssReading | ReceiverState] = []
    async with receiver:
        listening = asyncio.create_task(_listen(receiver, inbox, recorder, clock))
        try:
            while (answer := await asyncio.to_thread(ask, QUESTION)).strip() != "q":
                if answer.strip() == "u":
                    say(f"removed {places.pop().name}" if places else "there is nothing to undo")
                else:
                    await _one_place(answer, receiver, clock, beacon, inbox, places, say)
                write_whole(out, to_csv(places))
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)
    return places


def _already(out: Path) -> list[Place]:
    return from_csv(out) if out.exists() else []


async def _one_place(
    answer: str,
    receiver: Receiver,
    clock: Clock,
    beacon: Beacon,
    inbox: list[RssReading | ReceiverState],
    places: list[Place],
    say: Say,
) -> None:
    where = parse_answer(answer)
    if where is None:
        say(f"'{answer}' is not a distance above zero; {QUESTION}")
        return
    if places and (where[1] is None) != (places[0].heading_deg is None):
        say(
            "give the heading at every place or at none"
            if where[1] is None
            else "no heading: none was given before"
        )
        return
    inbox.clear()
    start_ns = clock.now_ns()
    await clock.sleep(beacon.period_s * beacon.packets)
    if any(isinstance(event, ReceiverState) and not event.up for event in inbox):
        raise DeviceError(
            f"the receiver of {receiver.robot} was lost; plug it in and start again: nothing is lost"
        )
    heard = [
        event
        for event in inbox
        if isinstance(event, RssReading)
        and event.t_ns >= start_ns
        and (event.frame_id or "").startswith(beacon.source)
    ]
    name = f"p{len(places) + 1:02d}"
    packets = packets_from(heard, start_ns, beacon.period_s, beacon.packets)
    places.append(Place(name, where[0], where[1], receiver.robot, packets))
    say(places[-1].summary())
    for wish in still_missing(places):
        say(f"  still wanted: {wish}")


def parse_answer(answer: str) -> tuple[float, float | None] | None:
    """Distance and heading out of '2.5' or '2.5 90'; None where it is neither."""
    try:
        values = [float(text) for text in answer.split()]
    except ValueError:
        return None
    if len(values) not in (1, 2) or not 0.0 < values[0] < 1e5:
        return None
    return values[0], values[1] if len(values) == 2 else None


async def _listen(
    receiver: Receiver,
    inbox: list[RssReading | ReceiverState],
    recorder: RecordingWriter | None,
    clock: Clock,
) -> None:
    number = 0
    async for event in receiver.readings():
        inbox.append(event)
        if recorder is not None:
            recorder.event(number, clock.now_ns(), event)
        number += 1
