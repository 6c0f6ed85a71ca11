"""Operators' orders, as far as they are known here: what is to be handed on, and who has shown that it obeys. Pure."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from fieldkit.engine.decentralised.entries import STEP_NS
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.decentralised.talk import code_of
from fieldkit.messages import Operator, VehicleState
from mission.core.holding import holds

STEERING = ("hold", "resume", "return", "release", "withdraw")
"""The last one of these is what a robot is to do."""


@dataclass
class Orders:
    """Orders of all operators. They come in `quantised` form, so that one that comes twice is the same."""

    robots: tuple[str, ...]
    waiting: list[Operator] = field(default_factory=list)
    """Those that stand in no robot's log that is known here, the oldest first: to be said on."""
    void: list[Operator] = field(default_factory=list)
    """Those that waited until a later one took their place: to be said no more. Emptied by whoever reads it."""
    _known: set[Operator] = field(default_factory=set)
    _last: dict[str, Operator] = field(default_factory=dict)
    """Robot to the last order of `STEERING` that means it."""
    _shown: set[str] = field(default_factory=set)
    """Robots that have shown that they have got that one."""
    _holding: set[str] = field(default_factory=set)
    """... and whose agents say that their vehicles hold by it."""
    _where: dict[Operator, dict[str, int]] = field(default_factory=dict)
    """Order to the robots in whose logs it stands, and its number there."""
    _vehicles: dict[str, VehicleState] = field(default_factory=dict)
    _stood_ns: dict[str, int] = field(default_factory=dict)
    """When each vehicle last said that it holds."""
    _latest_ns: int = 0

    def give(self, order: Operator) -> Operator:
        """An order of this computer's operator, as it is to be said.

        It is later than all that are known here, whatever this computer's clock says: of hold and resume the later one
        counts.
        """
        given = quantised(replace(order, t_ns=max(order.t_ns, self._latest_ns + STEP_NS)))
        assert isinstance(given, Operator)
        self.hand_on(given)
        return given

    def hand_on(self, order: Operator) -> bool:
        """An order of a computer that has no log; whether it is news. It is said on until it stands in one."""
        if not self.learn(order):
            return False
        self.waiting.append(order)
        self._drop_void()
        return True

    def learn(self, order: Operator) -> bool:
        """An order that a robot's agent has; whether it is news."""
        if order in self._known:
            return False
        self._known.add(order)
        self._latest_ns = max(self._latest_ns, order.t_ns)
        if order.action in STEERING:
            for robot in self._meant(order):
                if robot not in self._last or order.t_ns >= self._last[robot].t_ns:
                    self._last[robot] = order
                    self._shown.discard(robot)
                    self._holding.discard(robot)
            self._drop_void()
        return True

    def _drop_void(self) -> None:
        """What waits and is the last order for nobody: said later, it would hold a robot that has been let go."""
        late = [
            order
            for order in self.waiting
            if order.action in STEERING and all(self._last[robot] != order for robot in self._meant(order))
        ]
        self.waiting = [order for order in self.waiting if order not in late]
        self.void += late

    def read(self, order: Operator, robot: str, number: int) -> bool:
        """An order that is an entry of a robot's log: it has got it, as others will. Whether it is news."""
        news = self.learn(order)
        self._where.setdefault(order, {}).setdefault(robot, number)
        self.waiting = [each for each in self.waiting if each != order]
        if self._last.get(robot) == order:
            self._shown.add(robot)
        return news

    def has(self, robot: str, counts: Mapping[str, int]) -> None:
        """So many entries of each robot's log of orders a robot's agent says that it has: those it has got."""
        if (last := self._last.get(robot)) is not None:
            where = self._where.get(last, {})
            if any(counts.get(author, 0) > number for author, number in where.items()):
                self._shown.add(robot)

    def see(self, state: VehicleState) -> None:
        """A vehicle's state, from its robot's log: of one out of reach there is no other word."""
        if holds(state):
            self._stood_ns[state.robot] = max(state.t_ns, self._stood_ns.get(state.robot, 0))
        before = self._vehicles.get(state.robot)
        if before is None or state.t_ns >= before.t_ns:
            self._vehicles[state.robot] = state

    def obeyed(self, robot: str, code: int) -> None:
        """A robot's agent says which order it has obeyed last (`code_of`): sooner than any log.

        Of a hold it says so as long as its vehicle shows it, and -1 where that does not.
        """
        last = self._last.get(robot)
        if last is not None and code == code_of(last):
            self._shown.add(robot)
            self._holding.add(robot)
        elif code < 0:
            self._holding.discard(robot)

    def withdrawn_ns(self) -> int | None:
        """When the last of all robots was taken out of the mission; None where one is still in it."""
        if any(robot not in self._last or self._last[robot].action != "withdraw" for robot in self.robots):
            return None
        return max(order.t_ns for order in self._last.values())

    def standing(self) -> dict[str, tuple[Operator, bool]]:
        """Robot to the order that stands for it, and whether it has shown that it has got it."""
        return {robot: (order, self._has_shown(robot, order)) for robot, order in self._last.items()}

    def unheld(self) -> dict[str, Operator]:
        """Robots that are to hold and have not shown it, and by which order.

        That an agent has got the order is not enough: its word that the vehicle holds is, or the vehicle's own state
        since the order. The word counts for nothing where it has lost its vehicle, unless that one held since.
        """
        return {
            robot: order
            for robot, (order, shown) in self.standing().items()
            if order.action == "hold" and not shown
        }

    def _has_shown(self, robot: str, order: Operator) -> bool:
        vehicle = self._vehicles.get(robot)
        if order.action != "hold":
            return robot in self._shown
        if vehicle is not None and not vehicle.link_up:
            return robot in self._shown and self._stood_ns.get(robot, 0) > order.t_ns
        if robot in self._holding:
            return True
        return vehicle is not None and holds(vehicle) and vehicle.t_ns > order.t_ns

    def _meant(self, order: Operator) -> Iterator[str]:
        return (robot for robot in self.robots if order.robot in (None, robot))
