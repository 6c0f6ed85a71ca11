"""The end of a mission with robots in the air: they go home and land first. Nothing may hang in the air after us."""

from collections.abc import Callable, Container
from dataclasses import dataclass, field

from fieldkit.messages import Event, Operator
from mission.safety.rules import Safety
from mission.shell.dispatcher import Note

LANDING_S = 900.0
"""How long robots that fly may take to go home and land when the mission is over."""
DISARM_S = 15.0
"""How long one that stands on the ground may take to stop its motors: ArduCopter takes 2 to 10 s."""


@dataclass
class Landing:
    """What is still up, and until when is waited for it."""

    safety: Safety
    put: Callable[[Event], None]
    note: Note
    steered: Container[str]
    """Robots that this mission has a link to."""
    _by_ns: int = 0
    _ended_ns: int = 0
    """When the mission was first seen to be over."""
    _down_ns: dict[str, int] = field(default_factory=dict)
    """When robots were first seen to stand on the ground with their motors on."""

    def aloft(self) -> list[str]:
        """Robots that fly, are ours, and are not known to stand on the ground."""
        return [name for name in self._in_the_air() if not self.safety.robots[name].somebody_elses]

    def not_ours(self) -> list[str]:
        """Robots that fly and were not released, and that somebody else, or their own failsafe, has now."""
        return [name for name in self._in_the_air() if self.safety.robots[name].somebody_elses]

    def _in_the_air(self) -> list[str]:
        return [
            name
            for name in self._flying()
            if (robot := self.safety.robots[name]).vehicle is not None
            and robot.ordered != "release"
            and robot.vehicle.armed
            and robot.vehicle.on_ground is not True
        ]

    def _flying(self) -> list[str]:
        return [name for name in self.safety.settings.altitude_m if name in self.steered]

    def _stopping_motors(self, now_ns: int) -> list[str]:
        """Robots that fly and are down, with motors that will stop by themselves: a hold would keep them on."""
        for name in self._flying():
            vehicle = self.safety.robots[name].vehicle
            if vehicle is not None and vehicle.armed and vehicle.on_ground is True:
                self._down_ns.setdefault(name, now_ns)
            else:
                self._down_ns.pop(name, None)
        return [name for name, since in self._down_ns.items() if now_ns - since < DISARM_S * 1e9]

    def begin(self, over_ns: int, now_ns: int, reason: str) -> None:
        """What flies goes home, in sequence, and lands. The mission is over since `over_ns`."""
        self._by_ns = over_ns + round(LANDING_S * 1e9)
        for name in self.aloft():
            self.note("info", f"{name} goes home and lands: {reason}")
            self.put(Operator(now_ns, "return", name, "the mission is over"))

    def is_over(self, now_ns: int, event: Event) -> tuple[bool, list[str]]:
        """Whether nothing of ours is waited for any more, and who is left in the air.

        That is once nothing flies and motors have stopped, when it takes too long, or when the operator says so once
        more.
        """
        again = isinstance(event, Operator) and event.action == "end" and event.t_ns > self._ended_ns
        self._ended_ns = self._ended_ns or now_ns
        aloft = self.aloft()
        return not (aloft or self._stopping_motors(now_ns)) or again or now_ns >= self._by_ns, aloft
