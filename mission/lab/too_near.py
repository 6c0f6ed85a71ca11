"""Orders that lead a robot too near another one, by what is true; and which of them could have been known to.

What is promised is half the separation. An order **breaks** that where everybody goes on as ordered from the moment at
which it is given, at the true places, and the two then come nearer than that, and nearer than they are already: one
that stands stands, one that drives drives to its end and stays there. Nothing is allowed for: not what positions may be
off, not how long a message takes, not how far away the other is.

Such an order **could have been known** to where it breaks the promise as well with the other taken as it truly was when
its agent sent the last message that had come here: at its true place of then, and gone on since as it was ordered then.
That nobody can know more of another than it has said itself is all that is taken off: that its robot was stopped, or
sent elsewhere, since. What the message had in it does not matter: it could have said so.
"""

import math
from dataclasses import dataclass, field

from fieldkit.geometry.segments import Place, Segment, nearest_m, standing
from fieldkit.messages import GoTo
from fieldkit.world.bodies import Rover

KEPT_S = 60.0
"""Messages are remembered for so long: none is under way for longer."""
NEARER_M = 1e-6
"""More than rounding."""


@dataclass(frozen=True, slots=True)
class Moment:
    """What one robot truly did at a time."""

    t_s: float
    way: Segment

    def since(self, t_s: float) -> Segment:
        """The same at a later time, gone on as ordered."""
        way = self.way
        return Segment(way.at(max(0.0, t_s - self.t_s)), way.end_m, way.speed_m_s) if way.length_m else way


@dataclass(frozen=True, slots=True)
class Breach:
    """An order that leads too near."""

    t_s: float
    robot: str
    other: str
    nearest_m: float
    told_s: float
    """How old the last message of the other was; infinite where none had come."""
    could_be_known: bool


@dataclass
class TooNear:
    """Counts, in a flock, what the module says. `near_m` is what is promised."""

    near_m: float
    breaches: list[Breach] = field(default_factory=list)
    _ordered: dict[str, GoTo] = field(default_factory=dict)
    """At this tick."""
    _sent: dict[bytes, tuple[str, Moment]] = field(default_factory=dict)
    _told: dict[tuple[str, str], Moment] = field(default_factory=dict)
    """To a robot and another, how that was when it sent the last message that has come."""

    @property
    def orders(self) -> int:
        """Orders that lead too near; one counts once, however many it leads to."""
        return len({(each.t_s, each.robot) for each in self.breaches})

    @property
    def could_be_known(self) -> int:
        """Those of them that the agent could have known to."""
        return len({(each.t_s, each.robot) for each in self.breaches if each.could_be_known})

    def ordered(self, order: GoTo) -> None:
        """A robot is sent on its way."""
        self._ordered[order.robot] = order

    def sent(self, t_s: float, name: str, rover: Rover, data: bytes) -> None:
        """A robot's agent says something."""
        if self._sent and t_s - next(iter(self._sent.values()))[1].t_s > 2.0 * KEPT_S:
            self._sent = {key: each for key, each in self._sent.items() if t_s - each[1].t_s <= KEPT_S}
        self._sent[data] = (name, Moment(t_s, way_of(rover)))

    def heard(self, name: str, data: bytes) -> None:
        """A message has come to a robot's agent, perhaps after a later one."""
        other, moment = self._sent.get(data, ("", None))
        if moment is not None and moment.t_s >= self._told_s(name, other):
            self._told[name, other] = moment

    def _told_s(self, name: str, other: str) -> float:
        told = self._told.get((name, other))
        return -math.inf if told is None else told.t_s

    def look(self, t_s: float, rovers: dict[str, Rover]) -> None:
        """Once all orders of a tick have been given."""
        for name in self._ordered:
            path = way_of(rovers[name])
            for other, rover in rovers.items():
                if other == name or not _leads_near(path, way_of(rover), self.near_m):
                    continue
                told = self._told.get((name, other))
                known = told is not None and _leads_near(path, told.since(t_s), self.near_m)
                least_m = nearest_m(path, way_of(rover))
                told_s = t_s - self._told_s(name, other)
                self.breaches.append(Breach(t_s, name, other, least_m, told_s, known))
        self._ordered.clear()


def way_of(rover: Rover) -> Segment:
    """What a robot does, as it was ordered."""
    here: Place = (rover.east_m, rover.north_m)
    if rover.target_m is None:
        return standing(here)
    return Segment(here, rover.target_m, max(rover.target_speed_m_s, 0.01))


def _leads_near(path: Segment, other: Segment, near_m: float) -> bool:
    least_m = nearest_m(path, other)
    return least_m < near_m and least_m < math.dist(path.start_m, other.start_m) - NEARER_M
