"""The operator's laptop among robots without a common computer: all that they know, and a hand on all. Pure.

A watcher has no robot and no log. It keeps copies of all robots' logs, steps the kernel through them as agents do, and
hands on what it has: what robots know that never meet travels with it too. Nobody waits for it. It may come and go.

An order that is given here enters the log of every agent that hears and obeys it, and from there it travels as all else
does. Until it stands in a log of which there is a copy here it is said at every tick, to whoever is met: a link that is
lost before only makes it later. A log of the watcher's own would not do. Orders are part of what the common belief and
plans come from, so a checkpoint would have to wait for a laptop that somebody carries away; and one for which nobody
waits would bring orders from before a checkpoint to some robots only after it, and the common line would be no common
one. (ZooKeeper's observers are such members: they follow, have no vote, and hand on what is to be written.)
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

from fieldkit.engine.decentralised.logs import TICK_NS, Logs, Stream
from fieldkit.engine.decentralised.talk import Talk
from fieldkit.messages import EndMission, Event, Operator, RssReading, Tick, VehicleState
from mission.core.kernel import Kernel, Outcome
from mission.core.kernel_settings import KernelSettings
from mission.core.lines import Lines, gathered
from mission.core.orders import Orders

MOST_TICKS = 40
"""Ticks of the past that are stepped through at one step: nothing is steered here, and what is looked at may wait."""


@dataclass
class Watcher:
    """See the module. `talk` is its side of the conversation, with the copies of all logs."""

    settings: KernelSettings
    talk: Talk
    lines: Lines = field(init=False)
    orders: Orders = field(init=False)
    fresh: list[Event] = field(default_factory=list)
    """Poses and states that have come to be known since this was last emptied, none older than one before."""
    over_ns: int | None = None
    """When the mission was over, as far as is known here."""
    _seen_ns: dict[tuple[type, str], int] = field(default_factory=dict)
    """When the latest pose and states were, of each robot."""
    _read: dict[str, int] = field(default_factory=dict)
    """Robot to how many entries of its log of orders and states were looked at."""

    def __post_init__(self) -> None:
        self.lines = Lines(self.settings, self.logs, MOST_TICKS)
        self.orders = Orders(self.logs.robots)

    @property
    def logs(self) -> Logs:
        return self.talk.logs

    @property
    def kernel(self) -> Kernel:
        """What is believed and planned: by all, or by those in contact."""
        return self.lines.line.kernel

    def take(self, data: bytes, now_ns: int) -> list[Operator]:
        """Take in a message; orders that were not known here."""
        said = self.talk.take(data, now_ns)
        if said is None:
            return []
        news: list[Operator] = []
        if said.order is not None:
            is_news = self.orders.learn(said.order) if said.robot else self.orders.hand_on(said.order)
            news += [said.order] if is_news else []
        if said.new:
            news += self._read_orders()
        for entry in (*said.new, *said.ahead):
            self._see(entry.event)
        if (peer := self.talk.peers.get(said.robot)) is not None:
            self.orders.obeyed(said.robot, peer.obeyed)
            counts = {robot: peer.counts.get((robot, Stream.ORDERS), 0) for robot in self.logs.robots}
            self.orders.has(said.robot, counts)
        return news

    def _see(self, event: Event) -> None:
        """Where everybody is now is shown at once, though hours of the past are still to come."""
        if isinstance(event, Operator | Tick | RssReading):
            return
        if isinstance(event, VehicleState):
            self.orders.see(event)
        if event.t_ns >= self._seen_ns.get((type(event), event.robot), 0):
            self._seen_ns[type(event), event.robot] = event.t_ns
            self.fresh.append(event)

    def _read_orders(self) -> Iterator[Operator]:
        """Orders that are new in the robots' logs, and were not known here."""
        for robot in self.logs.robots:
            log = self.logs.entries[robot, Stream.ORDERS]
            for number in range(self._read.get(robot, 0), len(log)):
                event = log[number].event
                if isinstance(event, Operator) and self.orders.read(event, robot, number):
                    yield event
            self._read[robot] = len(log)

    def give(self, order: Operator, now_ns: int) -> tuple[Operator, bytes]:
        """An order of this computer's operator: as it stands from now on, and as it leaves at once."""
        given = self.orders.give(order)
        return given, self.talk.order(given, now_ns)

    def step(self, now_ns: int) -> Outcome:
        """Go on with what is known now; what there is to see of it. May run while messages are taken in."""
        self.lines.step(now_ns)
        outcomes = self.lines.shown
        ends = [c for outcome in outcomes for c in outcome.commands if isinstance(c, EndMission)]
        if self.over_ns is None and self.kernel.ended:
            self.over_ns = ends[0].t_ns if ends else self.lines.line.horizon * TICK_NS
        return gathered(ends, outcomes)

    def messages(self, now_ns: int) -> list[bytes]:
        """What it has to say at this tick."""
        for order in self.orders.void:
            self.talk.say_no_more(order)
        self.orders.void.clear()
        for order in self.orders.waiting:
            self.talk.keep_saying(order)
        return self.talk.messages(now_ns)

    def unheld(self) -> dict[str, Operator]:
        """Robots that are to hold and have not shown it, and by which order."""
        return self.orders.unheld()

    def is_of_another(self, robot: str, started_ns: int, within_s: float) -> bool:
        """Whether an agent that began then is of a new mission: what is known here is none of its past.

        It would be given the log of the mission before as its own. That one is over where all say so, where all robots
        were taken out of it, and where nothing was heard for `within_s`.
        """
        heard_ns = max(self.logs.closed.values()) * TICK_NS
        over_ns = self.over_ns or self.orders.withdrawn_ns() or heard_ns + round(within_s * 1e9)
        return robot in self.logs.robots and heard_ns > 0 and started_ns > over_ns
