"""Guided collection with a real receiver: ask where, listen, say what came and what is still missing."""

import asyncio
import contextlib
import threading
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from calibration.collect_log import CollectLog
from calibration.collection import Place, from_csv, packets_from, still_missing, to_csv
from calibration.positions import PositionFeed, Spot
from fieldkit.clock import Clock
from fieldkit.errors import DataError, DeviceError
from fieldkit.files import write_whole
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import Receiver

Ask = Callable[[str], str]
Say = Callable[[str], None]
QUESTION = "distance in m, heading if known (as '2.5' or '2.5 90'), u: undo, q: done"
QUESTION_TRACKED = "Enter: measure here, t: the robot stands at the transmitter, u: undo, q: done"
TURN = "turn the antenna until the transmitter is {:.0f} deg clockwise of its front; Enter: done, s: skip"
STAND_S = 2.0
"""How long to look at positions when the robot stands at the transmitter."""
SHOW_S = 1.0


@dataclass(frozen=True, slots=True)
class Beacon:
    """What the transmitter does."""

    period_s: float
    packets: int
    """How many to wait for at each place."""
    source: str = ""
    """Its address as frames carry it; others are not counted. Empty: take everything heard."""


@dataclass(slots=True)
class Collector:
    """One collection. `run` fills `out` place by place until the operator is done."""

    receiver: Receiver
    clock: Clock
    beacon: Beacon
    out: Path
    ask: Ask
    say: Say
    collect_log: CollectLog | None = None
    positions: PositionFeed | None = None
    """None: distances are typed."""
    headings_deg: Sequence[float] = ()
    """Ask for the antenna to be turned to each of these at every place."""
    show: Say = lambda text: None
    """Told how it goes while listening, about once a second."""
    begun: bool = False
    """Whether the receiver was there."""
    places: list[Place] = field(default_factory=list)
    inbox: list[RssReading | ReceiverState] = field(default_factory=list)

    async def run(self) -> list[Place]:
        """Go on with an existing file of ours, or begin one; written after every place.

        Raises `DeviceError` if the receiver is lost while listening: the place in hand is not written.
        """
        self.places = await asyncio.to_thread(_already, self.out)
        if self.places:
            self.say(f"{self.out}: going on after {_plural(self.places)}")
            for wish in still_missing(self.places):
                self.say(f"  still wanted: {wish}")
        for place in self.places:
            self._note(place)
        question = QUESTION if self.positions is None else QUESTION_TRACKED
        async with AsyncExitStack() as stack:
            await stack.enter_async_context(self.receiver)
            self.begun = True
            if self.positions is not None:
                await stack.enter_async_context(self.positions.following())
            listening = asyncio.create_task(self._listen())
            try:
                while (answer := await self._asked(question)) != "q":
                    await self._answered(answer)
                    await asyncio.to_thread(write_whole, self.out, to_csv(self.places))
            finally:
                listening.cancel()
                await asyncio.gather(listening, return_exceptions=True)
        return self.places

    async def _asked(self, question: str) -> str:
        """What was answered. In a thread that nobody waits for: Ctrl-C must not need Enter as well."""
        loop = asyncio.get_running_loop()
        answered: asyncio.Future[str] = loop.create_future()

        def settle(answer: str, error: Exception | None) -> None:
            if answered.done():
                return
            if error is None:
                answered.set_result(answer)
            else:
                answered.set_exception(error)

        def ask() -> None:
            answer, problem = "", None
            try:
                answer = self.ask(question).strip()
            except Exception as error:
                problem = error
            with contextlib.suppress(RuntimeError):  # the loop is over
                loop.call_soon_threadsafe(settle, answer, problem)

        threading.Thread(target=ask, name="question", daemon=True).start()
        return await answered

    async def _answered(self, answer: str) -> None:
        if answer == "u":
            self._undo()
        elif self.positions is None:
            await self._typed(answer)
        elif answer == "t":
            await self._at_transmitter(self.positions)
        elif answer:
            self.say(f"'{answer}' is no answer; {QUESTION_TRACKED}")
        else:
            await self._tracked(self.positions)

    def _undo(self) -> None:
        if not self.places:
            self.say("there is nothing to undo")
            return
        self.say(f"removed {self.places.pop().summary()}")
        if self.collect_log is not None:
            self.collect_log.removed()

    async def _typed(self, answer: str) -> None:
        where = parse_answer(answer)
        if where is None:
            self.say(f"'{answer}' is not a distance above zero; {QUESTION}")
            return
        distance, heading = where
        if self.headings_deg:
            name = self._next_name()
            for turned in self.headings_deg:
                if await self._asked(TURN.format(turned)) != "s":
                    self._add(await self._listened(), distance, turned, name)
            return
        if self.places and (heading is None) != (self.places[0].heading_deg is None):
            self.say(
                "give the heading at every place or at none"
                if heading is None
                else "no heading: none was given before"
            )
            return
        self._add(await self._listened(), distance, heading, self._next_name())

    async def _tracked(self, positions: PositionFeed) -> None:
        """One place where telemetry or a camera says the robot stands."""
        if positions.transmitter_m is None:
            self.say(str(positions.spot([])))
            return
        before = len(positions.poses)
        start_ns, heard = await self._listened()
        poses = positions.poses[before:]
        spot = positions.spot(poses)
        if not isinstance(spot, Spot):
            self.say(f"not kept: {spot}")
            return
        if off := positions.clock_off_s(self.clock.now_ns()):
            self.say(
                f"  mind: positions are stamped {off:+.1f} s from this computer's clock; set both by one"
            )
        if self.collect_log is not None:
            for pose in poses:
                self.collect_log.event(self.clock.now_ns(), pose)
        self._add((start_ns, heard), spot.distance_m, spot.heading_deg, self._next_name())

    async def _at_transmitter(self, positions: PositionFeed) -> None:
        before = len(positions.poses)
        await self.clock.sleep(STAND_S)
        stood = positions.stood(positions.poses[before:])
        if isinstance(stood, str):
            self.say(stood)
        else:
            positions.transmitter_m = stood
            self.say(f"the transmitter is at {stood[0]:.2f} m east, {stood[1]:.2f} m north")

    async def _listened(self) -> tuple[int, list[RssReading]]:
        """When listening began, and what the transmitter was heard with."""
        self.inbox.clear()
        start_ns = self.clock.now_ns()
        left_s = self.beacon.period_s * self.beacon.packets
        while left_s > 1e-9:
            step_s = min(left_s, max(SHOW_S, self.beacon.period_s))
            await self.clock.sleep(step_s)
            left_s -= step_s
            self.show(self._so_far(start_ns, left_s))
        if any(isinstance(event, ReceiverState) and not event.up for event in self.inbox):
            raise DeviceError(
                f"the receiver of {self.receiver.robot} was lost; plug it in and start again: nothing is lost"
            )
        return start_ns, self._heard(start_ns)

    def _heard(self, start_ns: int) -> list[RssReading]:
        return [
            event
            for event in self.inbox
            if isinstance(event, RssReading)
            and event.t_ns >= start_ns
            and (event.frame_id or "").startswith(self.beacon.source)
        ]

    def _so_far(self, start_ns: int, left_s: float) -> str:
        level = [reading.rss_dbm for reading in self._heard(start_ns)]
        said = f"{len(level)} heard"
        if level:
            said += f", mean {np.mean(level):.1f} dBm, spread {np.std(level):.1f} dB"
        return f"listening, {left_s:.0f} s left: {said}"

    def _add(
        self, listened: tuple[int, list[RssReading]], distance_m: float, heading_deg: float | None, name: str
    ) -> None:
        start_ns, heard = listened
        packets = packets_from(heard, start_ns, self.beacon.period_s, self.beacon.packets)
        place = Place(name, distance_m, heading_deg, self.receiver.robot, packets)
        self.places.append(place)
        self._note(place)
        self.say(place.summary())
        for wish in still_missing(self.places):
            self.say(f"  still wanted: {wish}")

    def _note(self, place: Place) -> None:
        if self.collect_log is not None:
            self.collect_log.place(place)

    def _next_name(self) -> str:
        return f"p{_count(self.places) + 1:02d}"

    async def _listen(self) -> None:
        async for event in self.receiver.readings():
            self.inbox.append(event)
            if self.collect_log is not None:
                self.collect_log.event(self.clock.now_ns(), event)


def _plural(places: Sequence[Place]) -> str:
    count = _count(places)
    return f"{count} place{'s' * (count != 1)}"


def _count(places: Sequence[Place]) -> int:
    return len({place.name for place in places})


def _already(out: Path) -> list[Place]:
    if not out.exists():
        return []
    if not out.is_file():
        raise DataError(f"{out}: is no file that could be gone on with; name a CSV")
    return from_csv(out)


def parse_answer(answer: str) -> tuple[float, float | None] | None:
    """Distance and heading out of '2.5' or '2.5 90'; None where it is neither."""
    try:
        values = [float(text) for text in answer.split()]
    except ValueError:
        return None
    if len(values) not in (1, 2) or not 0.0 < values[0] < 1e5 or not np.all(np.isfinite(values)):
        return None
    return values[0], values[1] if len(values) == 2 else None
