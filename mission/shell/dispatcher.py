"""The dispatcher: the only way to a vehicle.

Each robot has one current order. A newer order replaces an older one, also one that is still being confirmed. A stop
(`Hold`) outranks everything: it waits for nothing, it is repeated until the vehicle itself shows it, and it ends
confirmed, replaced by an order that came after it, or named as not confirmed. There is no second way to stop.

The dispatcher decides nothing else. What may be ordered is for safety to say.
"""

import asyncio
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from typing import Literal

from fieldkit.clock import Clock
from fieldkit.errors import DeviceError, VehicleRefused
from fieldkit.messages import CallOperator, Command, EndMission, GoTo, Hold, Land, Return
from fieldkit.ports import VehicleLink

logger = logging.getLogger(__name__)

Note = Callable[[str, str], None]
"""Writes a line down: level and text."""
BEAT_S = 0.5
"""Twice as often as MAVLink asks for: on a link that loses a third, one a second is lost six times in a row, and a
vehicle's failsafe has it, about every half hour; two a second, in years."""
AGAIN_S = 0.2
"""A stop that the driver has given up on is ordered again after so long."""
STOP_PATIENCE_S = 20.0
"""How long the end of a mission waits for vehicles to show that they hold, before they are named and it ends."""
ACQUIRE: Literal["acquire control"] = "acquire control"
RELEASE: Literal["release control"] = "release control"

Order = Command | Literal["acquire control", "release control"]


@dataclass
class _Current:
    """A robot's current order, and the task that carries it out."""

    order: Order
    since_s: float
    task: "asyncio.Task[DeviceError | None]"


class Dispatcher:
    """The vehicles of one mission. To be used inside a running event loop; `close` ends what is under way."""

    def __init__(
        self,
        links: Iterable[VehicleLink],
        clock: Clock,
        note: Note,
        altitude_m: Mapping[str, float] | None = None,
    ) -> None:
        """`altitude_m`: robots that fly, and how high they climb once they are ours."""
        self._altitude_m = dict(altitude_m or {})
        self._links = tuple(links)
        self.link_of = {robot: link for link in self._links for robot in link.robots}
        self._clock = clock
        self._note = note
        self._current: dict[str, _Current] = {}
        self._frozen: Counter[str] = Counter()
        self._last_beat_s = -BEAT_S
        self._failures: dict[str, str] = {}
        """Robot to why its last order failed: said once, not as often as it is repeated."""
        self._no_patience = asyncio.Event()
        self._is_closed = False
        self.answers: dict[str, tuple[str, str]] = {}
        """Robot to its last order and how that went: "..." under way, "done", or why not."""

    def order(self, robot: str, order: Order) -> None:
        """Have it carried out at once; what was ordered before is given up.

        A stop that repeats one still under way changes nothing. While a robot is frozen only stops pass.
        """
        if robot not in self.link_of or isinstance(order, CallOperator | EndMission):
            return
        current = self._current.get(robot)
        under_way = current is not None and not current.task.done()
        if isinstance(order, Hold):
            if current is not None and under_way and isinstance(current.order, Hold):
                return
            self._stop_at_once(robot)
        elif self._frozen[robot] and order != RELEASE:
            return
        if self._is_closed:  # nobody is left who would carry it out: of a stop one frame has left
            self.answers[robot] = (type(order).__name__, "the mission is over")
            return
        if current is not None and under_way:
            current.task.cancel()
        if order == RELEASE:  # at once: a newer order must not swallow it
            self.link_of[robot].release(robot)
            self._current.pop(robot, None)
            self.answers[robot] = (RELEASE, "done")
            return
        task = asyncio.create_task(self._carry_out(robot, order), name=f"order {robot}")
        self._current[robot] = _Current(order, self._clock.elapsed_s(), task)

    def _stop_at_once(self, robot: str) -> None:
        """The first frame has left before anything else is done. A driver's mistake does not keep others from it."""
        try:
            self.link_of[robot].stop(robot)
        except Exception:
            logger.exception("%s: the first frame of a stop could not be sent; it is repeated", robot)

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
    def frozen(self, robots: Sequence[str], t_ns: int, reason: str) -> Iterator[None]:
        """These hold while in here."""
        self.freeze(robots, t_ns, reason)
        try:
            yield
        finally:
            self.thaw(robots)

    def unconfirmed(self) -> dict[str, float]:
        """Robots that were ordered to stop and have not shown it, and for how many seconds."""
        now_s = self._clock.elapsed_s()
        return {
            robot: now_s - current.since_s
            for robot, current in self._current.items()
            if isinstance(current.order, Hold) and not current.task.done()
        }

    def beat(self) -> None:
        """Our heartbeat, where it is due. Called from the steering loop alone, so that it stops with it."""
        now_s = self._clock.elapsed_s()
        if now_s - self._last_beat_s >= 0.9 * BEAT_S:  # ticks do not come to the microsecond
            self._last_beat_s = now_s
            for link in self._links:
                link.beat()

    async def acquire(self, robots: Iterable[str] | None = None) -> None:
        """Make vehicles ours and have them armed; None: all of them. Raises what one that refuses raises.

        One that is ordered to stop meanwhile is not acquired, which is no error: the stop came later.
        """
        names = list(self.link_of if robots is None else robots)
        for name in names:
            self.order(name, ACQUIRE)
        tasks = [self._current[name].task for name in names if name in self._current]
        if tasks:
            await asyncio.wait(tasks)
        for task in tasks:
            if not task.cancelled() and (error := task.result()) is not None:
                raise error

    async def stop(self, robots: Iterable[str], t_ns: int, reason: str) -> list[str]:
        """Tell these to hold, all at once, and wait until they show it; those that do not are named, and returned.

        Waits for `STOP_PATIENCE_S` at the most, or until `lose_patience`.
        """
        names = [robot for robot in robots if robot in self.link_of]
        for name in names:
            self._frozen[name] += 1
            self.order(name, Hold(t_ns, name, reason))
        waiting = {self._current[name].task for name in names}
        given_up = asyncio.create_task(self._no_patience.wait())
        late = asyncio.create_task(self._clock.sleep(STOP_PATIENCE_S))
        async with self.beating():
            while waiting and not (given_up.done() or late.done()):
                await asyncio.wait({*waiting, given_up, late}, return_when=asyncio.FIRST_COMPLETED)
                waiting = {task for task in waiting if not task.done()}
        for task in (given_up, late):
            task.cancel()
        self._note("info", f"ordered to hold: {', '.join(names) or 'nobody'}: {reason}")
        silent = sorted(set(names) & self.unconfirmed().keys())
        if silent:
            text = f"NOT CONFIRMED to hold: {', '.join(silent)}: stop by hand, by remote control or switch"
            logger.error(text)
            self._note("error", text)
        return silent

    def lose_patience(self) -> None:
        """Whoever waits in `stop` waits no longer."""
        self._no_patience.set()

    async def close(self) -> None:
        """Give up what is still under way; of later orders only the first frame of a stop leaves."""
        self._is_closed = True
        tasks = [current.task for current in self._current.values() if not current.task.done()]
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)

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

    async def _carry_out(self, robot: str, order: Order) -> DeviceError | None:
        """One order to its end; why it failed. A stop does not fail: it is ordered until the vehicle shows it."""
        name = order if isinstance(order, str) else type(order).__name__
        self.answers[robot] = (name, "...")
        while True:
            try:
                await self._ask(robot, order)
            except Exception as caught:
                # A driver's mistake is a failure like others: a stop that ended by it would pass for confirmed.
                error = caught if isinstance(caught, DeviceError) else DeviceError(repr(caught))
                self._failed(robot, name, error)
                if not isinstance(order, Hold):
                    return error
                await self._clock.sleep(AGAIN_S)
            else:
                self.answers[robot] = (name, "done")
                self._failures.pop(robot, None)
                return None

    def _failed(self, robot: str, name: str, error: DeviceError) -> None:
        self.answers[robot] = (name, str(error))
        if self._failures.get(robot) != str(error):
            self._failures[robot] = str(error)
            logger.warning("%s: %s", robot, error)
            self._note("warning", f"{robot}: {name}: {error}")

    async def _ask(self, robot: str, order: Order) -> None:
        link = self.link_of[robot]
        match order:
            case GoTo(_, _, waypoint):
                await link.goto(robot, waypoint)
            case Hold():
                await link.hold(robot)
            case Return():
                await link.return_home(robot)
            case Land():
                await link.land(robot)
            case "acquire control":
                await link.acquire_control(robot)
                if (up_m := self._altitude_m.get(robot)) is not None:
                    await link.take_off(robot, up_m)
            case _:
                raise VehicleRefused(f"{robot}: {order} is no order for a vehicle")
