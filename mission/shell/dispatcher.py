"""The hands on the vehicles: carries out the newest order for each robot, and holds all of them at once.

Thin: decides nothing but that a newer order replaces an older one. A hold for everybody goes out at once, and no
way-point passes until the event that asked for it has gone through kernel and safety.
"""

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

from fieldkit.clock import Clock
from fieldkit.errors import DeviceError
from fieldkit.messages import CallOperator, Command, EndMission, GoTo, Hold, Return
from fieldkit.ports import VehicleLink

logger = logging.getLogger(__name__)

Note = Callable[[str, str], None]
"""Writes a line down: level and text."""
BEAT_S = 0.5
"""Twice as often as MAVLink asks for: on a link that loses a third, one a second is lost six times in a row, and a
vehicle's failsafe has it, about every half hour; two a second, in years."""
TAKE_OVER = "take over"
RELEASE = "release"


class Helm:
    """The vehicles of one mission. `tasks` must run for anything to be carried out."""

    def __init__(self, links: Iterable[VehicleLink], clock: Clock, note: Note) -> None:
        self._links = tuple(links)
        self.link_of = {robot: link for link in self._links for robot in link.robots}
        self._clock = clock
        self._note = note
        self._orders: dict[str, Command | str] = {}
        self._ready = {robot: asyncio.Event() for robot in self.link_of}
        self._frozen: Counter[str] = Counter()
        self._last_beat_s = -BEAT_S
        self._told: dict[str, str] = {}
        """Robot to why its last order failed: said once, not as often as it is repeated."""
        self.answers: dict[str, tuple[str, str]] = {}
        """Robot to its last order and how that went: "..." under way, "done", or why not."""

    def tasks(self) -> list[asyncio.Task[Any]]:
        """One for each robot; they end only by being cancelled."""
        return [asyncio.create_task(self._obey(robot), name=f"orders {robot}") for robot in self.link_of]

    def order(self, robot: str, order: Command | str) -> None:
        """Have it carried out; what was ordered before is forgotten."""
        if robot not in self._ready or isinstance(order, CallOperator | EndMission):
            return
        if isinstance(order, GoTo | Return) and self._frozen[robot]:
            return
        self._orders[robot] = order
        self._ready[robot].set()

    def freeze(self, robots: Iterable[str], t_ns: int, reason: str) -> None:
        """Hold these now; only holds pass until `thaw`."""
        for robot in robots:
            self._frozen[robot] += 1
            self.order(robot, Hold(t_ns, robot, reason))

    def thaw(self, robots: Iterable[str]) -> None:
        """The freeze of these has been taken note of."""
        for robot in robots:
            self._frozen[robot] = max(0, self._frozen[robot] - 1)

    @contextmanager
    def frozen(self, t_ns: int, reason: str) -> Iterator[None]:
        """Everybody holds while in here."""
        robots = list(self.link_of)
        self.freeze(robots, t_ns, reason)
        try:
            yield
        finally:
            self.thaw(robots)

    def beat(self) -> None:
        """Our heartbeat, where it is due. Called from the steering loop alone, so that it stops with it."""
        now_s = self._clock.elapsed_s()
        if now_s - self._last_beat_s >= 0.9 * BEAT_S:  # ticks do not come to the microsecond
            self._last_beat_s = now_s
            for link in self._links:
                link.beat()

    async def take_over(self, robots: Iterable[str] | None = None) -> None:
        """Make vehicles ours and have them armed; None: all of them. Raises what one that refuses raises."""
        names = list(self.link_of if robots is None else robots)
        await asyncio.gather(*(self.link_of[name].take_over(name) for name in names))

    async def hold_all(self, reason: str) -> None:
        """Tell every vehicle to hold, all at once; those that do not answer are named."""

        async def hold(robot: str, link: VehicleLink) -> None:
            try:
                await link.hold(robot)
            except DeviceError as error:
                logger.error("%s did not confirm that it holds: %s", robot, error)
                self._note("error", f"{robot} did not confirm that it holds: {error}")

        async with self.beating():
            await asyncio.gather(*(hold(robot, link) for robot, link in self.link_of.items()))
        self._note("info", f"all vehicles were told to hold: {reason}")

    @asynccontextmanager
    async def beating(self) -> AsyncIterator[None]:
        """Heartbeats while the steering loop does not run yet, or any more, and somebody waits for vehicles."""
        task = asyncio.create_task(self._keep_beating())
        try:
            yield
        finally:
            task.cancel()
            await asyncio.wait({task})

    async def _keep_beating(self) -> None:
        while True:
            self.beat()
            await self._clock.sleep(BEAT_S)

    async def _obey(self, robot: str) -> None:
        link, ready = self.link_of[robot], self._ready[robot]
        while True:
            await ready.wait()
            ready.clear()
            order = self._orders[robot]
            name = order if isinstance(order, str) else type(order).__name__
            self.answers[robot] = (name, "...")
            try:
                await _carry_out(link, robot, order)
                self.answers[robot] = (name, "done")
                self._told.pop(robot, None)
            except DeviceError as error:
                self.answers[robot] = (name, str(error))
                if self._told.get(robot) != str(error):
                    self._told[robot] = str(error)
                    logger.warning("%s: %s", robot, error)
                    self._note("warning", f"{robot}: {name}: {error}")


async def _carry_out(link: VehicleLink, robot: str, order: Command | str) -> None:
    match order:
        case GoTo(_, _, waypoint):
            await link.goto(robot, waypoint)
        case Hold():
            await link.hold(robot)
        case Return():
            await link.return_home(robot)
        case "take over":
            await link.take_over(robot)
        case "release":
            link.release(robot)
        case _:
            pass
