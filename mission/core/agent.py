"""One robot's part in a team without a common computer: what it knows, and what it does on that. Pure.

It keeps two lines of time (`mission.core.lines`). The common one is the same, bit for bit, on every robot. While all
are in contact the robot follows the plans of that one, and so do the others: they agree without talking about it. Where
some are out of contact it follows the one of those that are not.

An agent logs only what its own robot observes, and of every robot's commands it gives on its own robot's alone.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from fieldkit.engine.decentralised.logs import NEVER, TICK_NS, Key, Logs, Observation, Stream
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.decentralised.talk import Talk, code_of
from fieldkit.engine.decentralised.ways import Way
from fieldkit.messages import (
    Command,
    EndMission,
    Event,
    GoTo,
    Operator,
    Pose,
    ReceiverState,
    RssReading,
    Tick,
    VehicleState,
    Waypoint,
)
from fieldkit.settings import AGENT_WAIT_S
from mission.core.holding import rolls
from mission.core.kernel import NOTHING, Outcome
from mission.core.kernel_settings import KernelSettings
from mission.core.lines import Lines, gathered
from mission.core.orders import STEERING
from mission.core.taking_up import ENDED, RESTARTED
from mission.core.timeline import Timeline

POSE_EVERY_S = 0.45
"""Poses nearer together in time than this are not logged: between two a second places are interpolated."""
STATE_EVERY_S = 10.0
"""A vehicle's state that has not changed is logged so often."""
BATTERY_STEP_PCT = 1.0
ASK_AGAIN_S = 1.0
"""What safety has refused is asked for again so often, as long as it is what the plan says: another may have set out.

Each agent's safety knows others by what they say that they do, not by what they are about to do.
"""
LATELY_S = 1.5
"""So long the word of one that the plan has sent may be under way: it is said at every tick, and one may be lost."""
ORDERS_APART_S = 5.0
"""A hold so much older than a resume that came before it is void; by clocks of two robots one cannot say closer."""


@dataclass
class Agent:
    """See the module. `talk` is its side of the conversation, with the logs."""

    settings: KernelSettings
    talk: Talk
    lines: Lines = field(init=False)
    unloggable: int = 0
    """Observations of its own that hold no numbers."""
    unlogged: list[Operator] = field(default_factory=list)
    """Orders of a computer that has no log: whoever obeys one logs it, so that all learn of it who meet it."""
    fresh: list[Event] = field(default_factory=list)
    """What has come to be known of others since the last tick, as it came."""
    beside: tuple[GoTo, ...] = ()
    """Where the line that it acts on sends others at this tick: those before its own robot, or all where that is only
    given what it was refused; and where it has sent them just before, since their own word of it may be lost. The later
    one gives way: its safety is told of the others', theirs is not of its."""
    patience_s: float = AGENT_WAIT_S.default
    """So long after its first tick it waits for robots that nobody has heard of."""
    _obeyed: set[Operator] = field(default_factory=set)
    _held_ns: int = 0
    _resumed_ns: int = 0
    _let_go_ns: int = 0
    """When its robot was last told something else than to hold."""
    _lately: dict[str, tuple[int, GoTo]] = field(default_factory=dict)
    """Other robots to when the line that it acts on sent them, and where."""
    _ready: bool = False
    _early: dict[type, Observation] = field(default_factory=dict)
    """Its own last pose and states from before its first tick."""
    _early_orders: list[Operator] = field(default_factory=list)
    """Orders from before its first tick: obeyed at once, logged with it."""
    _pose_ns: int = -(2**62)
    _state: VehicleState | None = None
    _target: Waypoint | None = None
    _asked_ns: int = 0
    """When it last gave its robot a command."""

    def __post_init__(self) -> None:
        self.lines = Lines(self.settings, self.logs, patience_s=self.patience_s)

    @property
    def common(self) -> Timeline:
        """What everybody agrees on."""
        return self.lines.common

    @property
    def line(self) -> Timeline:
        """What it acts on: the common line, or one of those in contact."""
        return self.lines.line

    @property
    def logs(self) -> Logs:
        return self.talk.logs

    @property
    def me(self) -> str:
        return self.logs.me

    @property
    def target(self) -> Waypoint | None:
        """Where its robot was last sent; None: it has been told to hold, or nothing."""
        return self._target

    # -- what happens --------------------------------------------------------------------------------------

    def take(self, data: bytes, now_ns: int) -> list[Operator]:
        """Take in a message of another's; the operator's orders in it that its robot is to obey at once."""
        said = self.talk.take(data, now_ns)
        if said is None:
            return []
        if not said.robot and said.order is not None:
            if self._is_new(said.order):
                self.unlogged.append(said.order)
            elif self._holds_by(said.order):
                self._obeys(said.order)  # another order has come since, and this one is asked for
            return []
        orders = [] if said.order is None else [said.order]
        for entry in said.new:
            if isinstance(entry.event, Operator):
                orders.append(entry.event)
            else:
                self.fresh.append(entry.event)
        return [order for order in orders if self._is_new(order)]

    def _is_new(self, order: Operator) -> bool:
        """Whether an order was not obeyed yet, and no later one has made it void."""
        if order in self._obeyed:
            return False
        self._obeyed.add(order)
        if order.robot not in (None, self.me):
            return order.action in ("exclude", "remove")
        stands = self._stands(order)
        self._obeys(order, stands)
        return stands

    def _obeys(self, order: Operator, stands: bool = True) -> None:
        """Its robot has got an order. Whether it holds is for its vehicle to show, and that is news to all."""
        self.talk.obeyed = code_of(order)
        if stands and order.action in STEERING:
            self.talk.is_to_hold = order.action == "hold"
            self._state = None if self.talk.is_to_hold else self._state

    def _holds_by(self, order: Operator) -> bool:
        """Whether its robot is to hold by an order that was obeyed, and was not let go since."""
        return order.action == "hold" and order.robot in (None, self.me) and order.t_ns > self._let_go_ns

    def _stands(self, order: Operator) -> bool:
        """Whether no later order to its robot has made one void. In doubt a robot holds."""
        if order.action == "resume":
            if order.t_ns < self._held_ns:
                return False
            self._resumed_ns = max(self._resumed_ns, order.t_ns)
        elif order.action == "hold":
            if (self._resumed_ns - order.t_ns) * 1e-9 > ORDERS_APART_S:
                return False
            self._held_ns = max(self._held_ns, order.t_ns)
        if order.action in ("resume", "return", "release"):
            self._let_go_ns = max(self._let_go_ns, order.t_ns)
        return True

    def remembered(self) -> list[Operator]:
        """Orders in the logs that it goes on with after a restart, in their order; what is void is not among them.

        It knows then what it had obeyed before: an old order that another brings lifts no hold, and holds nobody anew.
        """
        return self._in_order([])

    def remember_anew(self) -> list[Operator]:
        """The same, where its log has come after some orders were obeyed: all of them, in their order.

        What has come meanwhile stands in no log yet, and is later than all that its own log has, whatever another's
        clock says: an old resume in there lifts no hold of now.
        """
        came = [*self._obeyed, *self._early_orders]
        self._obeyed.clear()
        return self._in_order(came)

    def _in_order(self, came: Iterable[Operator]) -> list[Operator]:
        """Orders in the logs, and those of `came` that are in none, in their order; without what is void."""
        ordered = [
            (entry.order_ns, key, number, entry.event)
            for key, log in self.logs.entries.items()
            for number, entry in enumerate(log)
            if isinstance(entry.event, Operator)
        ]
        packed = {each for order in came if isinstance(each := quantised(order), Operator)}
        unlogged = packed - {order for *_, order in ordered}
        ended_ns = self.logs.closed_of(self.me) * TICK_NS
        last: Key = ("", Stream.ORDERS)
        ordered += [
            (max(order.t_ns, ended_ns), last, number, order)
            for number, order in enumerate(sorted(unlogged, key=lambda order: order.t_ns))
        ]
        remembered = []
        for _, key, _, order in sorted(ordered, key=lambda each: each[:3]):
            was_known = order in self._obeyed
            stands = self._is_new(order)
            # Its own log has what was obeyed; what is meant for others is theirs to weigh.
            is_obeyed = key[0] == self.me and not was_known
            if key == last and order.action == "hold" and order.robot in (None, self.me):  # in doubt it holds
                stands = True
                self._obeys(order)
            if stands or is_obeyed or order.robot not in (None, self.me):
                remembered.append(order)
        return remembered

    def step(self, event: Event) -> Outcome:
        """Take in what its own robot or its operator says, or let time pass; what follows for its own robot."""
        if isinstance(event, VehicleState) and event.robot == self.me:
            self.talk.reaches_vehicle = event.link_up
        match event:
            case Tick():
                return self._tick(event.t_ns)
            case Operator() if event.action == "end":
                why = event.reason or "the operator ended the mission"
                if self._ready:  # else others may still bring its log back, and nothing is added before
                    self._log(Operator(event.t_ns, "withdraw", self.me, ENDED + why), event.t_ns)
                return Outcome((EndMission(event.t_ns, why),))
            case Operator():
                if event.robot in (None, self.me):  # its own operator's makes older ones void as others' do
                    self._stands(event)
                    self._obeys(event)
                if self._ready:
                    self._log(event, event.t_ns)
                else:  # its log may still come back from others
                    self._early_orders.append(event)
            case _ if event.robot != self.me:
                return NOTHING  # it comes by that robot's own agent
            case Pose() | VehicleState() | ReceiverState() if not self._ready:
                self._early[type(event)] = event
            case Pose():
                if (event.t_ns - self._pose_ns) * 1e-9 >= POSE_EVERY_S:
                    self._pose_ns = event.t_ns
                    self._log(event, event.t_ns)
            case VehicleState():
                if self._says_more(event):
                    self._state = event
                    said = replace(event, text="" if event.link_up else event.text)
                    self._log(said if rolls(event) else replace(said, speed_m_s=None), event.t_ns)
            case RssReading() | ReceiverState():
                if self._ready:
                    self._log(event, event.t_ns)
        return NOTHING

    def _says_more(self, state: VehicleState) -> bool:
        last = self._state
        if last is None or (state.t_ns - last.t_ns) * 1e-9 >= STATE_EVERY_S:
            return True
        fell = abs((state.battery_pct or 0.0) - (last.battery_pct or 0.0)) >= BATTERY_STEP_PCT
        return fell or _essence(state) != _essence(last)

    def _log(self, event: Observation, now_ns: int) -> None:
        try:
            self.logs.append(quantised(event), now_ns)
        except ValueError:
            self.unloggable += 1

    def _begin(self, now_ns: int) -> None:
        """Its log begins, or goes on after a restart, in which its robot heard nothing."""
        self._ready = True
        before = self.logs.closed_of(self.me)
        if before > NEVER:
            self._log(ReceiverState(before * TICK_NS, self.me, False, RESTARTED), now_ns)
        for order in self._early_orders:
            self._log(order, now_ns)
        self._early_orders.clear()
        if before > NEVER:
            self._log(ReceiverState(now_ns, self.me, True, "its agent goes on"), now_ns)
        for event in self._early.values():
            self.step(replace(event, t_ns=now_ns) if isinstance(event, ReceiverState) else event)

    # -- time ----------------------------------------------------------------------------------------------

    def _tick(self, now_ns: int) -> Outcome:
        if not self._ready:
            self._begin(now_ns)
        self.logs.close(now_ns)
        line, followed = self.line, self.lines.follows
        outcomes = self.lines.step(now_ns)
        planned = [command for outcome in outcomes for command in outcome.commands]
        commands = [each for each in planned if isinstance(each, EndMission) or each.robot == self.me]
        self.beside = self._sent_before(planned) + self._sent_lately(planned, now_ns)
        changed = self.line is not line or not followed
        refused = self._target is None and (now_ns - self._asked_ns) * 1e-9 >= ASK_AGAIN_S
        if self.lines.follows and not commands and (changed or refused):
            standing = self._standing(now_ns)
            commands = standing.pop(self.me, [])
            if changed:  # the others may have come to this line at this very tick as well
                before = self.logs.robots[: self.logs.robots.index(self.me)]
                self.beside += tuple(
                    each for name in before for each in standing.get(name, ()) if isinstance(each, GoTo)
                )
        last = {getattr(each, "robot", ""): replace(each, t_ns=now_ns) for each in commands}
        self._asked_ns = now_ns if last else self._asked_ns
        return gathered(last.values(), outcomes)

    def _sent_before(self, planned: list[Command]) -> tuple[GoTo, ...]:
        """See `beside`."""
        last: dict[str, Command] = {}
        for command in planned:
            if not isinstance(command, EndMission):
                last.pop(command.robot, None)
                last[command.robot] = command
        names = list(last)
        before = names[: names.index(self.me)] if self.me in last else names
        return tuple(each for name in before if isinstance(each := last[name], GoTo))

    def _sent_lately(self, planned: list[Command], now_ns: int) -> tuple[GoTo, ...]:
        """Where the line has sent others at the ticks before, and not elsewhere since."""
        self._lately = {
            name: (sent_ns, order)
            for name, (sent_ns, order) in self._lately.items()
            if (now_ns - sent_ns) * 1e-9 <= LATELY_S
        }
        for command in planned:
            if not isinstance(command, EndMission):
                self._lately.pop(command.robot, None)
        lately = tuple(order for _, order in self._lately.values())
        for command in planned:
            if isinstance(command, GoTo) and command.robot != self.me:
                self._lately[command.robot] = now_ns, command
        return lately

    def _standing(self, now_ns: int) -> dict[str, list[Command]]:
        """What a line that it now acts on has robots do."""
        if self.line.kernel.ended:
            return {self.me: [EndMission(now_ns, self.line.end_reason)]}
        standing: dict[str, list[Command]] = {}
        for task in self.line.kernel.tasks.of.values():
            for name, target in task.targets().items() if task.sent else ():
                up_m = self.settings.altitude_m.get(name)
                at = target if up_m is None else replace(target, up_m=up_m)
                standing.setdefault(name, []).append(GoTo(now_ns, name, at))
        return standing

    def ordered(self, command: Command) -> None:
        """What was given to its robot in the end, after safety has judged."""
        if getattr(command, "robot", "") == self.me:
            self._target = command.waypoint if isinstance(command, GoTo) else None

    def messages(
        self, now_ns: int, way: Way | None = None, known: Mapping[str, Way] | None = None
    ) -> list[bytes]:
        """What it has to say to the others at this tick; its robot's way and others' that are known, from safety."""
        return self.talk.messages(now_ns, way, known)


def _essence(state: VehicleState) -> tuple[object, ...]:
    """What of a vehicle's state decides whether it can be steered."""
    return state.mode, state.armed, state.link_up, state.flies, state.on_ground, state.reason, rolls(state)
