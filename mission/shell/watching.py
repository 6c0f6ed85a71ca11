"""The shell round a watcher: the network, the page, the journal and the terminal of a computer without a robot.

It steers nothing, so nothing here is in a hurry but orders: they leave when they are given, also while the kernel is
being stepped through hours of the past in its thread. Messages are taken in meanwhile, as at an agent.
"""

import asyncio
import contextlib
import logging
import secrets
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from fieldkit.clock import Clock
from fieldkit.console import NEWS
from fieldkit.engine.decentralised.card import MARK, Card, clock_refusal, is_second, refusal
from fieldkit.engine.decentralised.talk import WATCHERS
from fieldkit.messages import Event, Operator, Tick
from fieldkit.ports import Network
from fieldkit.recording.writer import RecordingWriter
from fieldkit.settings import TICK_S
from mission.core.kernel import Kernel, Outcome
from mission.core.mission_file import Mission
from mission.core.watcher import Watcher
from mission.safety.rules import Safety
from mission.shell.alarms import late_stops, unrecorded
from mission.shell.chronicle import Chronicle
from mission.shell.intake import end_tasks
from mission.shell.journal import RESUME_WITHIN_S, Journal
from mission.shell.member import CARD_EVERY_S, Member
from mission.shell.others import ORDERED, ordered_words
from mission.shell.progress import Progress
from mission.shell.recorder import Look, MissionRecorder
from mission.shell.setups import Setup
from mission.shell.signals import WHY, StopSignals

if TYPE_CHECKING:
    from mission.page.serve import LivePage

logger = logging.getLogger(__name__)


def watcher_name(number: int) -> str:
    """What a watcher is called where somebody speaks of it."""
    return f"laptop {number}"


def draw_number() -> int:
    """A watcher's number. Two that have drawn the same notice, and the later one draws anew."""
    return secrets.choice(WATCHERS)


@dataclass
class Shown:
    """What came of orders, robot by robot, for the page."""

    watcher: Watcher

    @property
    def answers(self) -> Mapping[str, tuple[str, str]]:
        """Robot to its last order, and "done" or that it has not been shown."""
        standing = self.watcher.orders.standing()
        return {
            robot: (order.action, "done" if shown else "has not shown yet that it obeys")
            for robot, (order, shown) in standing.items()
            if order.action != "withdraw"
        }


@dataclass
class Watching:
    """One watcher at work. `run` once. Takes orders as a runner does."""

    mission: Mission
    clock: Clock
    network: Network
    key: bytes
    card: Card
    watcher: Watcher
    journal: Journal
    common: Chronicle
    recorder: RecordingWriter
    """What all agree on, as `common` writes it."""
    on_progress: Callable[[Progress], None] = lambda _: None
    page: "LivePage | None" = None
    end_reason: str = ""
    begun: bool = False
    """Whether anything was heard, or ordered."""
    safety: Safety = field(init=False)
    """Judges nothing: it knows which areas are closed."""

    def __post_init__(self) -> None:
        self.setup = Setup(self.clock, (), ())
        self.safety = Safety(self.mission.safety)
        self.dispatcher = Shown(self.watcher)
        self._followers = () if self.page is None else (self.page.follower,)
        cell_m = self.mission.kernel.engine.grid.cell_m
        self.records = MissionRecorder(self.watcher.kernel, cell_m, *self._followers)
        self.signals = StopSignals(self._signalled, lambda: None, lambda: None, self._suspended)
        self._ended = asyncio.Event()
        watcher = self.watcher
        self._member = Member(
            self.clock,
            self.network,
            self.key,
            self.card,
            watcher.talk,
            self.journal,
            watcher.lines,
            self._say,
            self._tell,
        )
        self._doing: dict[str, str] = {}
        self._has_begun = False
        self._line = self.watcher.lines.line

    @property
    def kernel(self) -> Kernel:
        return self.watcher.kernel

    async def run(self) -> str:
        """Until the operator ends it; why it ended. Raises `DeviceError` where the network cannot be opened."""
        pool = ThreadPoolExecutor(1, thread_name_prefix="kernel")
        with self.signals.caught():
            async with contextlib.AsyncExitStack() as stack:
                stack.callback(pool.shutdown)
                await stack.enter_async_context(self.network)
                doing = (self._listen(), self._speak(), self._think(pool), self._ended.wait())
                tasks = [asyncio.create_task(each) for each in doing]
                stack.push_async_callback(end_tasks, tasks)
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
        self.journal.write(self.watcher.logs)
        self.journal.end()
        if self.common.steps:
            self.common.end(self.clock.now_ns(), self.end_reason, self._agreed())
        return self.end_reason

    # -- what comes in -------------------------------------------------------------------------------------

    def put(self, event: Event) -> None:
        """An order of this computer's operator: it goes out at once."""
        self.begun = True
        if not isinstance(event, Operator):
            return
        if event.action == "end":
            self._end(event.reason or "the operator ended it")
            return
        if event.action in ("mark", "bearing"):
            self._say(
                f"{event.action}: {event.robot} says so on the page of its own computer: nothing was done"
            )
            return
        now_ns = self.clock.now_ns()
        order, message = self.watcher.give(event, now_ns)
        self.network.publish(message, urgent=True)
        self._ordered(order, now_ns)
        if not self.watcher.talk.in_range(now_ns):
            self._say(f"nobody is in reach: {_words(order)} is handed on to the first who is met")

    def _ordered(self, order: Operator, now_ns: int) -> None:
        if order.action == "exclude":
            self.safety.observe(order)
        for follower in self._followers:
            follower.event(0, now_ns, order)

    async def _listen(self) -> None:
        watcher = self.watcher
        async for data in self.network.messages():
            self.begun, now_ns = True, self.clock.now_ns()
            if data.startswith(MARK):
                self._meet(data, now_ns)
                continue
            for order in watcher.take(data, now_ns):
                self._ordered(order, now_ns)
            for event in watcher.fresh:
                for follower in self._followers:
                    follower.event(0, event.t_ns, event)
            watcher.fresh.clear()

    def _meet(self, data: bytes, now_ns: int) -> None:
        """Another member says who it is."""
        mine, card = self._member.card, self._member.met(data)
        if card is None:
            return
        if not clock_refusal(card, now_ns) and is_second(mine, card):
            number = draw_number()
            self._member.card = self.card = replace(mine, robot=watcher_name(number))
            self.watcher.talk.seal.me = number
            return
        self._member.refuse(card, now_ns)
        belongs = not clock_refusal(card, now_ns) and not refusal(mine, card)
        if belongs and self.watcher.is_of_another(card.robot, card.started_ns, RESUME_WITHIN_S):
            self._end(
                f"{card.robot}'s agent was started after the mission that is known here was over: start this anew"
            )

    def _signalled(self, name: str) -> None:
        self._end(WHY[name])

    def _suspended(self) -> None:
        self.put(Operator(self.clock.now_ns(), "hold", None, "Ctrl-Z"))
        self._say("Ctrl-Z does not suspend this: HOLD ALL is said; r: resume   Ctrl-C: end this page alone")

    def _end(self, reason: str) -> None:
        self.end_reason = self.end_reason or reason
        self._ended.set()

    # -- what goes out -------------------------------------------------------------------------------------

    async def _speak(self) -> None:
        """At every tick: what is new goes to the journal, and then to the others."""
        began_s, has_looked = self.clock.elapsed_s(), False
        while True:
            self._member.speak(self.watcher.messages)
            self._member.mind_contact()
            self._pass(self.clock.now_ns())
            # Whoever is in reach has said by then who it is.
            if not has_looked and self.clock.elapsed_s() - began_s > CARD_EVERY_S:
                has_looked = True
                if not self.watcher.talk.peers:
                    self._say(
                        f"no robot's agent is heard yet (looked {self.network.where}): it goes on looking"
                    )
            await self.clock.sleep(TICK_S)

    def _pass(self, now_ns: int) -> None:
        """Time passes on the page."""
        if self._has_begun:
            self.records.event(0, now_ns, Tick(now_ns))
        elif self.page is not None:
            self.page.follower.waits(now_ns)

    def _say(self, text: str) -> None:
        logger.warning(text)
        self.records.note("warning", text, self.clock.now_ns())

    def _tell(self, text: str) -> None:
        logger.log(NEWS, text)
        self.records.note("info", text, self.clock.now_ns())

    # -- what is thought and shown -------------------------------------------------------------------------

    async def _think(self, pool: ThreadPoolExecutor) -> None:
        """Step the kernel through what is known, off the loop, and show what came of it."""
        loop, lines = asyncio.get_running_loop(), self.watcher.lines
        while True:
            before, now_ns = lines.line.horizon, self.clock.now_ns()
            outcome, look = await loop.run_in_executor(pool, self._thought, now_ns)
            self._show(now_ns, outcome, look)
            is_behind = lines.line.horizon < lines.logs.checkpoint(lines.line.members)
            await self.clock.sleep(0.0 if is_behind and lines.line.horizon > before else TICK_S)

    def _thought(self, now_ns: int) -> tuple[Outcome, Look | None]:
        outcome = self.watcher.step(now_ns)
        self.records.kernel = self.kernel
        begun = self.kernel.started_ns is not None
        return outcome, self.records.look_if_due(now_ns) if begun else None

    def _show(self, now_ns: int, outcome: Outcome, look: Look | None) -> None:
        if not self._has_begun and self.kernel.started_ns is not None:
            self._has_begun = True
            if self.page is not None:
                self.page.follower.begin(self.kernel.started_ns)
        self.records.outcome(0, now_ns, outcome)
        if look is not None:
            self.records.belief(0, now_ns, look)
        if self.watcher.lines.line is not self._line:
            self._line = self.watcher.lines.line
            for follower in self._followers:
                follower.sources(0, now_ns, self.kernel.sources())
        if outcome.plan is not None:
            self._doing.update(outcome.plan.purpose)
        for end in outcome.commands:
            self._say(
                f"the mission is over ({getattr(end, 'reason', '')}); this page stays until it is ended"
            )
        progress = Progress(
            self.kernel.elapsed_s(now_ns),
            self.kernel.detections,
            self.kernel,
            self.doing(),
            outcome.notes,
            self.records.left,
            tuple(self.alarms()),
        )
        try:
            self.on_progress(progress)
        except Exception:  # a terminal that has gone
            self.on_progress = lambda _: None
            logger.exception("progress is no longer shown; the page goes on")

    def doing(self) -> dict[str, str]:
        """What robots do: as planned, unless they have an order, or nobody knows."""
        ordered = {
            name: ordered_words(order.action, order.reason) if shown else f"{order.action}: not shown yet"
            for name, (order, shown) in self.watcher.orders.standing().items()
            if order.action in ORDERED
        }
        return self._doing | ordered | self._member.contacts.absent()

    def alarms(self) -> Sequence[str]:
        """Who is to hold and has not shown it, orders that nobody has yet, a recording that has stopped."""
        now_ns, orders = self.clock.now_ns(), self.watcher.orders
        late = late_stops({name: (now_ns - each.t_ns) * 1e-9 for name, each in orders.unheld().items()})
        failures = unrecorded((self.recorder.failure, self.journal.failure))
        alone = bool(orders.waiting) and not self.watcher.talk.in_range(now_ns)
        waiting = [f"nobody has got it yet: {_words(order)}" for order in orders.waiting] if alone else []
        return [*late, *waiting, *failures]

    # -- the end -------------------------------------------------------------------------------------------

    def _agreed(self) -> dict[str, Any]:
        common = self.watcher.lines.common
        return {"common_hash": common.kernel.digest(), "common_tick": common.horizon}

    def result(self) -> dict[str, Any]:
        """How it ended, and what was said and heard."""
        orders = self.watcher.orders
        told = {
            "end_reason": self.end_reason,
            "detections": self.kernel.detections,
            "not_shown_to_hold": sorted(orders.unheld()),
            "not_handed_on": [_words(order) for order in orders.waiting],
        }
        return self._agreed() | told | self._member.result()


def _words(order: Operator) -> str:
    return f"{order.action} {order.robot or 'all'}"
