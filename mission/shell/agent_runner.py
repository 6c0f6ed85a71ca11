"""The shell round an agent: a runner with one robot's devices, the network, and the journal.

What decides is the agent; what steers, stops, starts and ends is the runner's as for any mission. Orders of other
robots' operators come through the inbox like one's own, and stop the robot before anything else is thought about.
Messages are taken in by the event loop, also while the agent thinks in its thread: logs only grow at their ends, and a
step looks only at what was closed before it began.
"""

import logging
import math
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from fieldkit.console import NEWS
from fieldkit.engine.decentralised.card import MARK, Card, clock_refusal, is_second
from fieldkit.engine.decentralised.logs import STEP_NS
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.errors import ConfigError, RecordingError
from fieldkit.messages import (
    Command,
    EndMission,
    Event,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    Tick,
    VehicleState,
)
from fieldkit.ports import Network
from fieldkit.settings import TICK_S
from mission.core.agent import Agent
from mission.core.fleet import Fleet, Robot
from mission.core.holding import holds, rolls
from mission.core.kernel import Kernel, Outcome
from mission.core.taking_up import Left, ended_ns
from mission.safety.apart import SafetyApart
from mission.safety.rules import Safety
from mission.shell.alarms import LATE_STOP_S, late_stops, unrecorded
from mission.shell.chronicle import Chronicle
from mission.shell.journal import Journal
from mission.shell.look_round import LOOK_ROUND_S, LookRound
from mission.shell.member import Member
from mission.shell.others import ordered_words
from mission.shell.runner import Runner

logger = logging.getLogger(__name__)

LINGER_S = 10.0
"""So long after the end others may still fetch what they lack."""


@dataclass
class Crew:
    """What an agent has that a mission on one computer has not."""

    agent: Agent
    network: Network
    key: bytes
    card: Card
    journal: Journal
    contact_m: float | None = None
    """Within which distance the robots hear each other, where the operator says so."""
    common: Chronicle | None = None
    """Writes down what all agree on."""
    left: Left | None = None
    """What an agent before it knew that was ended before the mission was over ..."""
    left_in: Path | None = None
    """... and the journal that has it."""


@dataclass
class AgentRunner(Runner):
    """One robot's part of a mission. `run` once."""

    crew: Crew = field(kw_only=True)

    def __post_init__(self) -> None:
        self._own = Fleet(self.mission.kernel)
        self._rolls_since_s = math.inf
        """Since when its vehicle moves though it says that it holds."""
        self._unshown_since_s = math.inf
        """Since when it is to hold and its vehicle shows something else, though it has confirmed the order."""
        self._held_by: dict[str, str] = {}
        """Robot to who held it last."""
        self._foreign: list[Operator] = []
        """Orders of others that are in the inbox."""
        crew, agent = self.crew, self.crew.agent
        self._member = Member(
            self.setup.clock,
            crew.network,
            crew.key,
            crew.card,
            agent.talk,
            crew.journal,
            agent.lines,
            self._say,
            self._tell,
        )
        self._member.keeps_journal = any(agent.logs.counts().values())
        super().__post_init__()

    @property
    def me(self) -> str:
        return self.crew.agent.me

    @property
    def robots(self) -> Mapping[str, Robot]:
        """Its own robot alone must be there before the start."""
        return {self.me: self._own.robots[self.me]}

    def minds(self) -> tuple[Kernel, Safety]:
        """The agent's line, and a safety that knows others by hearsay."""
        safety = SafetyApart(self.mission.safety, me=self.me, contact_m=self.crew.contact_m)
        return self.crew.agent.line.kernel, safety

    # -- what comes in -------------------------------------------------------------------------------------

    def decide(self, event: Event) -> Outcome:
        """The agent's word. Others' orders it has from their logs."""
        if isinstance(event, Pose | ReceiverState | VehicleState):
            self._own.take_in(event)
        if isinstance(event, Operator):
            self._note_who(event)
        if isinstance(event, Operator) and event in self._foreign:
            self._foreign.remove(event)
            why = f": {event.reason}" if event.reason else ""
            return Outcome(notes=(f"from others: {event.action} {event.robot or 'all'}{why}",))
        outcome = self.crew.agent.step(event)
        self._apart.beside = self.crew.agent.beside
        self.kernel = self.records.kernel = self.crew.agent.line.kernel
        return outcome

    def remember(self, order: Operator) -> None:
        """An order from before a restart stands: safety is told again."""
        self._note_who(order)
        self.safety.observe(order)

    def _note_who(self, order: Operator) -> None:
        """Who has held whom, as far as the order says it."""
        if order.action in ("hold", "end") and order.reason:
            self._held_by |= dict.fromkeys(
                self.safety.robots if order.robot is None else (order.robot,), order.reason
            )

    def put(self, event: Event) -> None:
        """Into the inbox; an operator's order goes out to the others as well, at once."""
        super().put(event)
        if (
            isinstance(event, Operator)
            and event not in self._foreign
            and event.action not in ("end", "withdraw")
        ):
            order = quantised(event)
            assert isinstance(order, Operator)
            self.crew.network.publish(
                self.crew.agent.talk.order(order, self.setup.clock.now_ns()), urgent=True
            )

    def _streams(self) -> list[tuple[str, AsyncIterator[Event]]]:
        return [*super()._streams(), ("network", self._listen())]

    async def _listen(self) -> AsyncIterator[Event]:
        crew, agent = self.crew, self.crew.agent
        async for data in crew.network.messages():
            now_ns = self.setup.clock.now_ns()
            if data.startswith(MARK):
                self._meet(data, now_ns)
                continue
            for order in agent.take(data, now_ns):
                self._foreign.append(order)
                yield order
            for order in agent.unlogged:
                yield order
            agent.unlogged.clear()
            for event in agent.fresh:
                self.safety.observe(event)
                for follower in self.followers:  # the recording has its own robot's; `common.mcap` has all
                    follower.event(0, event.t_ns, event)
            agent.fresh.clear()
            self._expect()

    def _expect(self) -> None:
        for name, peer in self.crew.agent.talk.peers.items():
            self._apart.expect(name, peer.way, peer.knows, peer.heard_ns, peer.said_ns)

    @property
    def _apart(self) -> SafetyApart:
        assert isinstance(self.safety, SafetyApart)
        return self.safety

    def _meet(self, data: bytes, now_ns: int) -> None:
        """Another agent says who it is. Raises `ConfigError` where it has our robot already."""
        mine, card = self.crew.card, self._member.met(data)
        if card is None:
            return
        if not clock_refusal(card, now_ns) and is_second(mine, card):
            raise ConfigError(
                f"{mine.robot} has an agent already, on {card.host}: end that one first; nothing was moved by this one"
            )
        is_twin = card.robot == mine.robot and card.instance != mine.instance
        twin = f"a second agent for {mine.robot}, on {card.host}, has to end" if is_twin else ""
        self._member.refuse(card, now_ns, twin)

    def _tell(self, text: str) -> None:
        """Words that are no trouble."""
        logger.log(NEWS, text)
        self._note("info", text)

    def alarms(self) -> list[str]:
        """Those of any mission, its vehicle that does not hold as it says or was told, and files that have failed.

        The others have what it observes.
        """
        vehicle, rolling = self._own.robots[self.me].vehicle, []
        if vehicle is not None and self.setup.clock.elapsed_s() - self._rolls_since_s >= LATE_STOP_S:
            rolling = [
                f"{self.me} says that it holds, and moves at {vehicle.speed_m_s:.1f} m/s: stop it by hand"
            ]
        late_s = self.setup.clock.elapsed_s() - self._unshown_since_s
        shows = vehicle is not None and holds(vehicle)  # by now: between two ticks it may have come to it
        late = [] if shows else late_stops({self.me: late_s})
        unshown = [f"{each} ({_mode_words(vehicle)})" for each in late]
        common = "" if self.crew.common is None else self.crew.common.failure
        return [*super().alarms(), *rolling, *unshown, *unrecorded((common, self.crew.journal.failure))]

    def doing(self) -> dict[str, str]:
        """Its own robot's, and of the others what is planned, unless they have an order, or nobody knows."""
        ordered = {
            name: ordered_words(robot.ordered, self._held_by.get(name, ""))
            for name, robot in self.safety.robots.items()
            if robot.ordered and (name != self.me or (robot.ordered == "hold" and name in self._held_by))
        }
        return self._doing | ordered | self._member.contacts.absent()

    # -- what goes out -------------------------------------------------------------------------------------

    async def _start(self) -> None:
        """Look round first: nothing of the robot's is touched where another agent has it."""
        crew, clock, remember = self.crew, self.setup.clock, self.remember
        self._tell(
            f"listens for {LOOK_ROUND_S:g} s who else is there, before anything of {self.me}'s is touched"
        )
        says = (self._say, self._tell, self._speak)
        await LookRound(crew.agent, clock, remember, *says, crew.left, crew.left_in).run()
        while not self._inbox.empty():  # orders in what has come back are obeyed first
            await clock.sleep(TICK_S)
        self._member.keeps_journal = True
        if not self.crew.agent.talk.in_range(clock.now_ns()):
            where, wait_s = self.crew.network.where, self.crew.agent.patience_s
            self._say(
                f"no other agent is heard yet (looked {where}): it goes on looking, and after {wait_s:g} s alone"
            )
        self._tell(f"waits for {self.me}'s position and vehicle, checks it, and acquires control of it")
        await super()._start()

    def _is_ready(self) -> None:
        """A robot whose operator had ended its agent is in the mission again; a hold from before stands.

        The order is of the time of that end: what was ordered since, and has not come here yet, is later.
        """
        at_ns, ordered = ended_ns(self.crew.agent.logs, self.me), self.safety.robots[self.me].ordered
        if at_ns is not None and ordered in ("withdraw", "hold"):
            action: Literal["resume", "hold"] = "resume" if ordered == "withdraw" else "hold"
            self.put(Operator(at_ns + STEP_NS, action, self.me, "its agent was started again"))
        elif ordered == "hold":  # its control has just been acquired
            self._carry_out(Hold(self.setup.clock.now_ns(), self.me, "ordered before the start"))

    async def _step(self, number: int, t_ns: int, event: Event, pool: ThreadPoolExecutor) -> None:
        await super()._step(number, t_ns, event, pool)
        if isinstance(event, Tick):
            self._speak()
            self._member.mind_contact()

    def _speak(self) -> None:
        """What is new goes to the journal, and then to the others."""
        agent = self.crew.agent
        self._mind_hold()
        self._member.speak(
            lambda now_ns: agent.messages(now_ns, self._apart.announced, dict(self._apart.ways))
        )
        if agent.talk.lost:
            raise RecordingError(
                f"the others know more of {self.me} than its own journal, so its log cannot be gone on with: start its "
                "agent anew while others are in reach, and it gets its log back from them"
            )

    def _mind_hold(self) -> None:
        """Its word that it holds rests on what its vehicle shows: the order's own confirmation, its mode, its speed."""
        vehicle, now_s = self._own.robots[self.me].vehicle, self.setup.clock.elapsed_s()
        confirmed, talk = self.me not in self.dispatcher.unconfirmed(), self.crew.agent.talk
        talk.shows_hold = confirmed and vehicle is not None and holds(vehicle)
        if vehicle is None or not rolls(vehicle):
            self._rolls_since_s = math.inf
        elif math.isinf(self._rolls_since_s):
            self._rolls_since_s = now_s
        if (
            not talk.is_to_hold
            or talk.shows_hold
            or not confirmed
            or (vehicle is not None and rolls(vehicle))
        ):
            self._unshown_since_s = math.inf
        elif math.isinf(self._unshown_since_s):
            self._unshown_since_s = now_s

    def _carry_out(self, command: Command) -> None:
        """Its own robot's commands alone are its own to give."""
        if not isinstance(command, EndMission):
            if command.robot != self.me:
                return
            self.crew.agent.ordered(command)
        super()._carry_out(command)

    async def _leave(self) -> None:
        """The robot holds first; then the others fetch what they lack."""
        await super()._leave()
        self._log_late_orders()
        clock, agent = self.setup.clock, self.crew.agent
        until_s = clock.elapsed_s() + LINGER_S
        while clock.elapsed_s() < until_s and self._somebody_lacks():
            for message in agent.messages(clock.now_ns(), self._apart.announced, self._apart.ways):
                self.crew.network.publish(message)
            await clock.sleep(TICK_S)
            self._log_late_orders()

    def _log_late_orders(self) -> None:
        """Operators' orders that came when nothing was stepped any more: they were said at once, and go on by the log.

        Then the journal ends, once more where something was added.
        """
        crew = self.crew
        while not self._inbox.empty():
            came = self._inbox.get_nowait()
            event = None if isinstance(came, BaseException) else came[2]
            if (
                isinstance(event, Operator)
                and event.action not in ("end", "withdraw")
                and not crew.agent.talk.lost
            ):
                self.decide(event)
        if self._member.keeps_journal:
            crew.journal.write(crew.agent.logs)
        crew.journal.end(left=not (crew.agent.talk.lost or crew.agent.line.kernel.ended))

    def _somebody_lacks(self) -> bool:
        talk = self.crew.agent.talk
        counts = talk.logs.counts()
        now_ns = self.setup.clock.now_ns()
        peers = [talk.peers[name] for name in talk.in_range(now_ns)]
        peers += [talk.watchers[number] for number in talk.watchers_in_range(now_ns)]
        return any(peer.counts.get(key, 0) < count for peer in peers for key, count in counts.items())

    async def _finish(self, t_ns: int) -> None:
        if self.crew.common is not None and self.crew.common.steps:
            self.crew.common.end(t_ns, self.end_reason)
        await super()._finish(t_ns)

    def result(self) -> dict[str, Any]:
        """How it ended, and what was said and heard."""
        common = self.crew.agent.common
        told = {"robot": self.me, "common_hash": common.kernel.digest(), "common_tick": common.horizon}
        return super().result() | told | self._member.result()


def _mode_words(vehicle: VehicleState | None) -> str:
    """What a vehicle says of what it does, and why."""
    if vehicle is None:
        return "nothing was heard of its vehicle yet"
    return f"its vehicle's mode is {vehicle.mode}{f': {vehicle.reason}' if vehicle.reason else ''}"
