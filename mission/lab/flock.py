"""A team of agents in virtual time over a simulated network: the agents' own code in a plain loop, no sockets.

Each robot has its agent, its safety and its clock; the world and its chance are those of `mission.lab.simulate`, so
that a flock and a single computer meet the same transmissions.
"""

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from fieldkit import settings as given
from fieldkit.engine.decentralised.logs import Logs, Part
from fieldkit.engine.decentralised.sealing import STAMP_EPOCH_NS, Seal, session_key
from fieldkit.engine.decentralised.talk import Talk
from fieldkit.messages import Command, EndMission, Event, GoTo, Hold, Operator, Tick, VehicleState
from fieldkit.world.network import Air, Network
from mission.core.agent import Agent
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.core.timeline import Timeline
from mission.lab.simulate import SimulatedWorld, Truth, count_false, note_covered
from mission.lab.too_near import TooNear
from mission.safety.apart import SafetyApart
from mission.safety.limits import SafetySettings

START_NS = STAMP_EPOCH_NS + 10**18
"""When simulated time begins: clocks of before 2015 seal nothing."""
KEY = bytes(range(32))
LISTENS_S = 3.0
"""An agent that was started again listens for so long before anything of its own is logged."""
LOOK_S = 10.0
"""Time between looks at all agents' beliefs."""


@dataclass
class Flown:
    """How it went."""

    elapsed_s: float
    time_to_all_s: float | None
    """When the first agent that acts on it had found all sources, for good."""
    false_finds: int
    """Of the agent with the most."""
    same: bool
    """Whether all agents had the belief of a single computer at every look, by its digest."""
    compared: int
    """Looks at an agent's common line that were compared."""
    bytes_s: dict[str, float]
    """What each agent sent a second."""
    oldest_s: float
    """The most that anybody's common line lay back."""
    merged_s: float | None
    """How long after the cut had ended everybody had everything up to then; None where that did not come, or no cut."""
    nearest_m: float
    """The least distance between two robots."""
    ordered_too_near: int
    """Orders that, had all gone on as ordered, led nearer than half the separation past another: `lab.too_near`."""
    could_be_known: int
    """Those of them of which the agent could have known, by what the other robot had said."""
    dropped: dict[str, int] = field(default_factory=dict)


class Flock:
    """One team. `fly` once."""

    def __init__(
        self,
        kernel: KernelSettings,
        safety: SafetySettings,
        truth: Truth,
        air: Air,
        seed: int,
        *,
        contact_m: float | None = None,
        clock_s: tuple[float, ...] = (),
        bytes_s: float = given.AGENT_BYTES_S.default,
    ) -> None:
        """`clock_s`: how far each robot's clock is ahead at first; none: all are right."""
        robots = kernel.engine.robots
        self.settings, self.limits, self.truth, self.air = kernel, safety, truth, air
        grid = kernel.engine.grid
        self.world = SimulatedWorld(robots, truth, seed, given.TICK_S, kernel.altitude_m, grid.size_east_m)
        self.network = Network(air, np.random.default_rng([seed, 0xA6E]))
        self.clock_s = dict(zip(robots, clock_s or (0.0,) * len(robots), strict=True))
        self.key, self.bytes_s, self.contact_m = session_key(KEY, "flock"), bytes_s, contact_m
        self.agents = {name: self._agent(Logs(name, robots)) for name in robots}
        self.safety = {name: SafetyApart(safety, me=name, contact_m=contact_m) for name in robots}
        self.ended: dict[str, str] = {}
        self.lost: set[str] = set()
        """Robots whose agent has died; they stand."""
        self._listens_until_s: dict[str, float] = {}
        """Agents that were started again listen first."""
        self.seen: list[tuple[int, str, str]] = []
        """Looks at common lines: tick, robot, digest."""
        self.too_near = TooNear(safety.near_m)

    def _agent(self, logs: Logs) -> Agent:
        number = self.settings.engine.robots.index(logs.me)
        return Agent(self.settings, Talk(logs, Seal(self.key, number), self.bytes_s))

    def now_ns(self, name: str) -> int:
        """The time by a robot's clock."""
        return START_NS + round((self.world.t_s + self.clock_s[name]) * 1e9)

    def begin(self) -> None:
        """Every vehicle says that it is there."""
        for name in self.agents:
            self._observe(name, VehicleState(0, name, "guided", True))

    def fly(self, most_s: float) -> Flown:
        """To the end of everybody's mission, or for `most_s`."""
        covered: dict[str, dict[int, float]] = {name: {} for name in self.agents}
        self.begin()
        oldest_s, nearest_m, merged_s = 0.0, math.inf, None
        while len(self.ended.keys() | self.lost) < len(self.agents) and self.world.t_s < most_s:
            self.step()
            living = [agent for name, agent in self.agents.items() if name not in self.lost]
            for agent in living:
                note_covered(agent.line.kernel, self.truth, self.world.t_s, covered[agent.me])
            oldest_s = max(oldest_s, *(self.lag_s(name) for name in self.agents if name not in self.lost))
            nearest_m = min(nearest_m, self.nearest_m())
            if merged_s is None and self.world.t_s >= self.air.cut_s[1]:
                end_tick = (START_NS + round(self.air.cut_s[1] * 1e9)) // round(given.TICK_S * 1e9)
                if all(agent.logs.checkpoint() >= end_tick for agent in living):
                    merged_s = self.world.t_s - self.air.cut_s[1]
        done = [
            max(its.values(), default=0.0) for its in covered.values() if len(its) == len(self.truth.sources)
        ]
        living = [agent for name, agent in self.agents.items() if name not in self.lost]
        self._look()
        return Flown(
            self.world.t_s,
            min(done, default=None),
            max(count_false(agent.line.kernel, self.truth) for agent in living),
            self.agrees(),
            len(self.seen),
            {name: sent / max(self.world.t_s, 1e-9) for name, sent in self.network.carried.items()},
            oldest_s,
            merged_s,
            nearest_m,
            self.too_near.orders,
            self.too_near.could_be_known,
            dict(sum((agent.talk.seal.dropped for agent in living), start=Counter[str]())),
        )

    def step(self) -> None:
        """One tick of everybody."""
        for name, data in self.network.arrived(self.world.t_s):
            if name not in self.lost:
                self.hear(name, data)
        for event in self.world.events():
            if not isinstance(event, Tick | Operator) and event.robot not in self.lost:
                self._observe(event.robot, event)
        places_m = {name: (rover.east_m, rover.north_m) for name, rover in self.world.rovers.items()}
        for name, agent in self.agents.items():
            if name in self.lost:
                continue
            if name not in self.ended and not self._listens(name):
                self._tick(name, agent)
            safety = self.safety[name]
            if (off := agent.talk.clock_off(self.now_ns(name))) is not None:
                self.clock_s[name] -= off[1]
                agent.talk.clock_set_back(self.now_ns(name), off[1])
            for message in agent.messages(self.now_ns(name), safety.announced, safety.ways):
                self.too_near.sent(self.world.t_s, name, self.world.rovers[name], message)
                self.network.send(self.world.t_s, name, message, places_m)
        self.too_near.look(self.world.t_s, self.world.rovers)
        if round(self.world.t_s / given.TICK_S) % round(LOOK_S / given.TICK_S) == 0:
            self._look()
        self.world.drive()

    def kill(self, name: str) -> None:
        """An agent dies; its robot holds by its own failsafe."""
        self.lost.add(name)
        self.world.rovers[name].stop()

    def revive(self, name: str, *, with_journal: bool) -> None:
        """Its agent is started again: with its journal, or without one and so with an empty log."""
        robots, before = self.settings.engine.robots, self.agents[name].logs
        logs = Logs(name, robots)
        if with_journal:
            for key, log in before.entries.items():
                logs.take(Part(*key, 0, tuple(log)))
            logs.closed = dict(before.closed)
        self.agents[name] = self._agent(logs)
        self.safety[name] = safety = SafetyApart(self.limits, me=name, contact_m=self.contact_m)
        orders = [e for log in logs.entries.values() for e in log if isinstance(e.event, Operator)]
        for entry in sorted(orders, key=lambda entry: entry.order_ns):
            safety.observe(entry.event)
        self.lost.discard(name)
        self._listens_until_s[name] = self.world.t_s + LISTENS_S
        self._observe(name, VehicleState(round(self.world.t_s * 1e9), name, "guided", True))

    def _listens(self, name: str) -> bool:
        """Whether an agent that was started again waits for what it has lost."""
        talk = self.agents[name].talk
        lacks = not talk.logs.has_begun and talk.lacks_own(self.now_ns(name))
        return lacks or self.world.t_s < self._listens_until_s.get(name, 0.0)

    def order(self, name: str, action: str, robot: str | None = None) -> None:
        """An operator at one robot's agent."""
        agent, now_ns = self.agents[name], self.now_ns(name)
        order = Operator(now_ns, action, robot, "operator")  # type: ignore[arg-type]  # a test's own words
        agent.step(order)
        for command in self.safety[name].observe(order):
            self._obey(name, command)
        places_m = {each: (rover.east_m, rover.north_m) for each, rover in self.world.rovers.items()}
        self.network.send(self.world.t_s, name, agent.talk.order(order, now_ns), places_m)

    def hear(self, name: str, data: bytes) -> None:
        """A message has come to a robot's agent."""
        agent = self.agents[name]
        self.too_near.heard(name, data)
        for order in agent.take(data, self.now_ns(name)):
            for command in self.safety[name].observe(order):
                self._obey(name, command)
        for order in agent.unlogged:
            agent.step(order)
            for command in self.safety[name].observe(order):
                self._obey(name, command)
        agent.unlogged.clear()
        for event in agent.fresh:
            self.safety[name].observe(event)
        agent.fresh.clear()
        for other, peer in agent.talk.peers.items():
            self.safety[name].expect(other, peer.way, peer.knows, peer.heard_ns, peer.said_ns)

    def _observe(self, name: str, event: Event) -> None:
        """What a robot's own devices say, by its own clock."""
        own = replace(event, t_ns=event.t_ns + self.now_ns(name) - round(self.world.t_s * 1e9))
        self.agents[name].step(own)
        self.safety[name].observe(own)

    def _tick(self, name: str, agent: Agent) -> None:
        tick = Tick(self.now_ns(name))
        safety = self.safety[name]
        outcome = agent.step(tick)
        safety.beside = agent.beside
        for command in (*safety.observe(tick), *safety.judge(outcome.commands)):
            self._obey(name, command)

    def _obey(self, name: str, command: Command) -> None:
        if isinstance(command, EndMission):
            self.ended[name] = command.reason
            self.safety[name].judge((Hold(command.t_ns, name, command.reason),))
            self.world.rovers[name].stop()
        elif command.robot == name:
            self.agents[name].ordered(command)
            if isinstance(command, GoTo):
                self.too_near.ordered(command)
            self.world.obey(command)

    def lag_s(self, name: str) -> float:
        """How far a robot's common line lies back; 0 before there is one."""
        agent = self.agents[name]
        if agent.common.horizon < 0:
            return 0.0
        return (self.now_ns(name) // round(given.TICK_S * 1e9) - agent.common.horizon) * given.TICK_S

    def nearest_m(self) -> float:
        """How near the two robots are now that are nearest to each other."""
        places = [(rover.east_m, rover.north_m) for rover in self.world.rovers.values()]
        return min((math.dist(a, b) for a, b in combinations(places, 2)), default=math.inf)

    def _look(self) -> None:
        for name, agent in self.agents.items():
            if name not in self.lost and agent.common.horizon >= 0:
                self.seen.append((agent.common.horizon, name, agent.common.kernel.digest()))

    def agrees(self) -> bool:
        """Whether every belief seen is that of one computer with everybody's own logs."""
        whole = Logs("", ("", *self.agents))
        for name, agent in self.agents.items():
            for key in Logs.keys((name,)):
                whole.entries[key] = agent.logs.entries[key]
        one = Timeline(Kernel(self.settings), self.settings.engine.robots)
        same = True
        for tick, _, digest in sorted(self.seen):
            while one.horizon < tick:
                before = one.horizon
                one.step_to(whole, tick, 1_000)
                if one.horizon == before:
                    return False
            same = same and one.horizon == tick and one.kernel.digest() == digest
        return same
