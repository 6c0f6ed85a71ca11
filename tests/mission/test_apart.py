"""Robots that hear each other late: none comes near another, whatever the network does, and none stands for good."""

import heapq
import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest
from sizes import size

from fieldkit.engine.decentralised.logs import TICK_NS
from fieldkit.engine.decentralised.ways import NO_WAY, Way
from fieldkit.messages import Command, GoTo, Hold, Pose, Tick, VehicleState, Waypoint
from fieldkit.settings import TICK_S
from fieldkit.world.bodies import Rover
from fieldkit.world.network import Air
from mission.safety.apart import SafetyApart
from mission.safety.limits import SafetySettings

ROBOTS = ("r1", "r2", "r3")
SIDE_M = 5.0
SETTINGS = SafetySettings(ROBOTS, SIDE_M, SIDE_M, min_separation_m=0.6)
STARTS_M = ((1.0, 1.0), (4.0, 1.0), (2.5, 4.0))
START_NS = 3_600_000_000 * TICK_NS
Message = tuple[str, Pose, Way | None, dict[str, int]]


@dataclass
class Ground:
    """Robots that are sent to random places all the time, each by its own safety, over a bad network."""

    air: Air
    seed: int
    slow: frozenset[tuple[str, str]] = frozenset()
    """Who hears whom late; none: all hear all as the network says."""
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.rovers = {name: Rover(*place) for name, place in zip(ROBOTS, STARTS_M, strict=True)}
        self.safety = {name: SafetyApart(SETTINGS, me=name) for name in ROBOTS}
        self.wanted = dict.fromkeys(ROBOTS, Waypoint(0.0, 0.0, 0.0))
        self.under_way: list[tuple[float, int, str, Message]] = []
        self.said_ns: dict[tuple[str, str], int] = {}
        self.t_s, self.driven_m, self.nearest_m, self.number = 0.0, 0.0, math.inf, 0
        for name, safety in self.safety.items():
            for other, place in zip(ROBOTS, STARTS_M, strict=True):
                safety.observe(VehicleState(START_NS, other, "guided", True))
                safety.observe(Pose(START_NS, other, *place))
            self._choose(name)

    def _choose(self, name: str) -> None:
        self.wanted[name] = Waypoint(*self.rng.uniform(0.5, SIDE_M - 0.5, 2).tolist(), 0.4)

    def drive(self, seconds: float) -> "Ground":
        until_s = self.t_s + seconds
        while self.t_s < until_s:
            self.t_s += TICK_S
            self._step(START_NS + round(self.t_s * 1e9))
        return self

    def _step(self, now_ns: int) -> None:
        while self.under_way and self.under_way[0][0] <= self.t_s:
            _, _, name, message = heapq.heappop(self.under_way)
            self._hear(name, message)
        for name, rover in self.rovers.items():
            safety = self.safety[name]
            pose = Pose(now_ns, name, rover.east_m, rover.north_m, 0.0, rover.heading_deg)
            safety.observe(pose)
            for command in safety.observe(Tick(now_ns)):
                self._obey(name, command)
            target = self.wanted[name]
            is_there = math.dist((pose.east_m, pose.north_m), (target.east_m, target.north_m)) < 0.1
            if is_there or self.rng.random() < 0.01:  # or a plan changes on the way
                self._choose(name)
            if rover.target_m is None and self.rng.random() < 0.5:
                self._obey(name, safety.allow(GoTo(now_ns, name, self.wanted[name])))
            self._say(name, pose)
        before = {name: (rover.east_m, rover.north_m) for name, rover in self.rovers.items()}
        for _ in range(5):
            for rover in self.rovers.values():
                rover.step(TICK_S / 5)
            places = [(rover.east_m, rover.north_m) for rover in self.rovers.values()]
            self.nearest_m = min(self.nearest_m, *(math.dist(a, b) for a, b in combinations(places, 2)))
        self.driven_m += sum(math.dist(before[n], (r.east_m, r.north_m)) for n, r in self.rovers.items())

    def _obey(self, name: str, command: Command) -> None:
        if isinstance(command, GoTo) and command.robot == name:
            to = command.waypoint
            self.rovers[name].go_to(to.east_m, to.north_m, to.speed_m_s)
        elif isinstance(command, Hold) and command.robot == name:
            self.rovers[name].stop()

    def _say(self, name: str, pose: Pose) -> None:
        safety, air = self.safety[name], self.air
        numbers = {other: way.number for other, way in safety.ways.items()}
        for other in ROBOTS:
            if other == name or self.rng.random() < air.loss:
                continue
            late = not self.slow or (other, name) in self.slow
            at_s = self.t_s + (air.delay_s + air.jitter_s * self.rng.random() if late else 0.05)
            self.number += 1
            heapq.heappush(
                self.under_way, (at_s, self.number, other, (name, pose, safety.announced, numbers))
            )

    def _hear(self, name: str, message: Message) -> None:
        other, pose, way, numbers = message
        if pose.t_ns <= self.said_ns.get((name, other), 0):
            return
        self.said_ns[name, other] = pose.t_ns
        self.safety[name].observe(pose)
        self.safety[name].expect(other, way, numbers.get(name, NO_WAY))


NETWORKS = {
    "5 s late": Air(delay_s=5.0),
    "a third lost, out of order": Air(loss=0.3, delay_s=3.0, jitter_s=4.0),
    "about as late as positions hold": Air(loss=0.2, delay_s=1.2, jitter_s=1.5),
}


@pytest.mark.parametrize("air", NETWORKS.values(), ids=list(NETWORKS))
@pytest.mark.parametrize("seed", size([1], [1, 2, 3]))
def test_late_messages_cost_waiting_and_nothing_else(air: Air, seed: int) -> None:
    ground = Ground(air, seed).drive(300.0)
    assert ground.nearest_m >= SETTINGS.near_m
    assert ground.driven_m > 20.0, "three robots in five minutes; heard at once they drive 130 m"


@pytest.mark.parametrize("seed", size([1], [1, 2, 3]))
def test_one_who_hears_late_and_is_heard_at_once_meets_nobody(seed: int) -> None:
    ground = Ground(Air(delay_s=5.0), seed, slow=frozenset({("r1", "r2"), ("r3", "r1")})).drive(300.0)
    assert ground.nearest_m >= SETTINGS.near_m
    assert ground.driven_m > 60.0


def late(seconds: float = 6.0) -> SafetyApart:
    """Safety of r1, which heard r2 that long ago: it may have come 2.4 m further since. r3 is heard."""
    safety = SafetyApart(SETTINGS, me="r1")
    for name, place in zip(ROBOTS, STARTS_M, strict=True):
        safety.observe(VehicleState(START_NS, name, "guided", True))
        safety.observe(Pose(START_NS, name, *place))
    tick(safety, seconds)
    return safety


def tick(safety: SafetyApart, seconds: float) -> list[Command]:
    now_ns = START_NS + round(seconds * 1e9)
    for name in ("r1", "r3"):
        pose = safety.robots[name].pose
        assert pose is not None
        safety.observe(Pose(now_ns, name, pose.east_m, pose.north_m))
    return [command for command in safety.observe(Tick(now_ns)) if getattr(command, "robot", "") == "r1"]


def ask(safety: SafetyApart, seconds: float, east_m: float = 2.0) -> Command:
    return safety.allow(GoTo(START_NS + round(seconds * 1e9), "r1", Waypoint(east_m, 1.0, 0.4)))


def test_a_way_is_announced_and_gone_once_it_is_confirmed() -> None:
    safety = late()
    refused = ask(safety, 6.0)
    assert isinstance(refused, Hold) and "r2 was last heard 6 s ago, and has not confirmed" in refused.reason
    way = safety.way
    assert way is not None and way.waits and way.end_m == (2.0, 1.0)
    safety.expect("r2", Way(1, (4.0, 1.0), (4.0, 1.0)), way.number - 1)
    assert isinstance(ask(safety, 7.0), Hold) and safety.way == way, "another of its ways was confirmed"
    safety.expect("r2", Way(1, (4.0, 1.0), (4.0, 1.0)), way.number)
    assert isinstance(ask(safety, 8.0), GoTo)
    assert safety.way is not None and not safety.way.waits and safety.way.number == way.number
    held = [command for second in range(9, 20) for command in tick(safety, float(second))]
    assert held == [], "confirmed ground stays its own, however long nothing is heard"


def test_of_two_that_wait_the_one_goes_that_announced_first() -> None:
    for earlier, goes in ((-1, False), (1, True)):
        safety = late()
        ask(safety, 6.0)
        assert safety.way is not None and safety.way.waits
        number = safety.way.number
        safety.expect("r2", Way(number + earlier, (4.0, 1.0), (1.5, 1.0), 0.4, waits=True), number)
        assert isinstance(ask(safety, 8.0), GoTo) == goes
        tick(safety, 8.5)
        assert (safety.way.end_m == (2.0, 1.0)) == goes, "who goes second gives its way back"


def test_ground_that_is_not_asked_for_any_more_is_given_back() -> None:
    safety = late()
    ask(safety, 6.0)
    tick(safety, 8.0)
    assert safety.way is not None and safety.way.waits
    tick(safety, 20.0)
    assert safety.way.start_m == safety.way.end_m == (1.0, 1.0) and not safety.way.waits


def test_one_that_was_seen_before_it_announced_its_way_may_be_all_along_it() -> None:
    """r2 was seen at (4, 1); since then it has come to (2, 3), and from there it goes to (2, 0.8)."""
    safety = late()
    ask(safety, 6.0)
    assert safety.way is not None
    late_way = Way(START_NS // TICK_NS + 8, (2.0, 3.0), (2.0, 0.8), 0.4)
    safety.expect("r2", late_way, safety.way.number)
    refused = ask(safety, 8.0)
    assert isinstance(refused, Hold) and "may be" in refused.reason


# -- orders that nobody has heard of yet -----------------------------------------------------------------------


def prompt(sigma_m: float = 0.0) -> SafetyApart:
    """Safety of r1, which hears the others at once, their positions good to `sigma_m`."""
    safety = SafetyApart(SETTINGS, me="r1")
    for name, place in zip(ROBOTS, STARTS_M, strict=True):
        safety.observe(VehicleState(START_NS, name, "guided", True))
        safety.observe(Pose(START_NS, name, *place, sigma_m=sigma_m))
    safety.observe(Tick(START_NS))
    return safety


def order(name: str, east_m: float, north_m: float) -> GoTo:
    return GoTo(START_NS, name, Waypoint(east_m, north_m, 0.4))


def test_that_a_robot_was_told_to_stop_is_said_before_it_stands_and_known_to_all() -> None:
    stops, hears = SafetyApart(SETTINGS, me="r2"), prompt()
    stops.observe(VehicleState(START_NS, "r2", "guided", True))
    stops.observe(Pose(START_NS, "r2", *STARTS_M[1]))
    stops.observe(Tick(START_NS))
    assert isinstance(stops.allow(order("r2", 4.0, 4.5)), GoTo)
    drives = stops.announced
    assert drives is not None and drives.speed_m_s == 0.4
    hears.expect("r2", drives)
    behind = order("r1", 4.6, 1.0)  # it comes to where r2 is now when r2 is long gone
    assert isinstance(hears.allow(behind), GoTo)
    assert isinstance(stops.allow(order("r2", math.nan, 1.0)), Hold)
    told = stops.announced
    assert told is not None and told.speed_m_s == 0.0 and told.number == drives.number
    hears = prompt()
    for _ in range(3):  # it is said at every tick until it stands
        hears.expect("r2", drives)
        hears.expect("r2", told)
    refused = hears.allow(behind)
    assert isinstance(refused, Hold) and "of r2" in refused.reason
    assert not hears.robots["r2"].moving and hears.robots["r2"].segments()[0].end_m == drives.end_m
    assert isinstance(stops.allow(order("r2", 4.0, 4.5)), GoTo) and stops.announced == drives


def test_of_two_that_the_plan_sends_across_each_other_the_later_one_waits() -> None:
    crossing = order("r3", 2.5, 0.4)
    assert isinstance(prompt().allow(order("r1", 3.0, 1.0)), GoTo)
    safety = prompt()
    safety.beside = (crossing,)
    refused = safety.allow(order("r1", 3.0, 1.0))
    assert isinstance(refused, Hold) and "of r3" in refused.reason
    assert not safety.robots["r3"].moving, "whether it goes its own agent decides"


@pytest.mark.parametrize(
    ("sigma_m", "clear_m"),
    [(0.0, 0.36), (0.014, 0.36), (0.03, 0.3 + 3.0 * math.hypot(0.03, 0.03)), (1.0, 0.45)],
)
def test_a_new_path_keeps_off_by_what_positions_may_be_off(sigma_m: float, clear_m: float) -> None:
    """Past r2, which stands at (4, 1)."""
    for more_m, kind in ((-0.01, Hold), (0.01, GoTo)):
        safety = prompt(sigma_m)
        safety.observe(Pose(START_NS + 1, "r1", 1.0, 1.0 + clear_m + more_m, sigma_m=sigma_m))
        assert isinstance(safety.allow(order("r1", 4.6, 1.0 + clear_m + more_m)), kind)


def test_one_that_is_not_heard_goes_on_to_the_end_of_its_way() -> None:
    """Its own agent steers it: nothing stops it after 15 s, as a robot whose only computer is silent."""
    safety = SafetyApart(SETTINGS, me="r1", contact_m=6.0)
    for name, place in zip(ROBOTS, STARTS_M, strict=True):
        safety.observe(VehicleState(START_NS, name, "guided", True))
        safety.observe(Pose(START_NS, name, *place))
    safety.expect("r2", Way(1, (4.0, 1.0), (4.0, 4.5), 0.1))
    tick(safety, 21.0)
    refused = safety.allow(GoTo(START_NS + 21 * 10**9, "r1", Waypoint(4.5, 4.5, 0.4)))
    assert isinstance(refused, Hold) and "where r2 may be" in refused.reason
