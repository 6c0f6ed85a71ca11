"""Robots without a common computer, in virtual time: what they agree on is what one computer would have had."""

import math
from dataclasses import replace

import pytest

from fieldkit.channel.model import Antenna
from fieldkit.engine.decentralised.logs import TICK_NS, Logs
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import Talk
from fieldkit.engine.decentralised.ways import Way
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Event, GoTo, Hold, Operator, Pose, RssReading, Tick, VehicleState, Waypoint
from fieldkit.settings import AGENT_ABSENT_S
from fieldkit.world.network import Air
from fieldkit.world.sources import TransientSource
from mission.core.agent import Agent
from mission.core.kernel_settings import KernelSettings
from mission.lab.flock import KEY, Flock
from mission.lab.simulate import Truth
from mission.safety.apart import SafetyApart, least_contact_m
from mission.safety.limits import SafetySettings

ROBOTS = ("r1", "r2", "r3", "r4")
S = 1_000_000_000
START_NS = 1_800_000_000 * S
ANTENNA = Antenna(2.53, -62.0, 3.3, -70.0)
SAFETY = SafetySettings(ROBOTS, 10.0, 10.0, min_separation_m=0.5)


def settings(**more: object) -> KernelSettings:
    engine = EngineSettings(
        Grid(10.0, 10.0, 0.5),
        ANTENNA,
        (ROBOTS[:2], ROBOTS[2:]),
        reference_rate_hz=0.2,
        min_separation_m=0.5,
        seed=1,
        keep_teams=True,
    )
    return KernelSettings(engine, **{"max_duration_s": 1e6, **more})  # type: ignore[arg-type]


def flock(air: Air = Air(), seed: int = 1, contact_m: float | None = None, **more: object) -> Flock:
    sources = (TransientSource(3.0, 6.0, 0.0, 0.2), TransientSource(8.0, 4.0, 0.0, 0.2))
    truth = Truth(ANTENNA, sources, ((2.0, 1.0), (3.0, 1.0), (7.0, 1.0), (8.0, 1.0)))
    return Flock(settings(**more), SAFETY, truth, air, seed, contact_m=contact_m)


def go_on(team: Flock, seconds: float) -> Flock:
    until_s = team.world.t_s + seconds
    while team.world.t_s < until_s:
        team.step()
    return team


@pytest.mark.parametrize(
    "air",
    [
        Air(),
        Air(loss=0.3, delay_s=1.0, jitter_s=2.0, repeated=0.2),
        Air(cut_s=(10.0, 30.0), apart=frozenset(ROBOTS[:2])),
    ],
    ids=["full contact", "lossy", "cut"],
)
def test_what_is_common_is_what_one_computer_would_have_had_bit_for_bit(air: Air) -> None:
    flown = flock(air, contact_m=5.0).fly(50.0)
    assert flown.same and flown.compared >= 15
    assert flown.ordered_too_near == 0 and flown.nearest_m > SAFETY.near_m


def test_robots_in_contact_plan_alike_without_talking_about_it() -> None:
    team = go_on(flock(), 40.0)
    lines = [agent.line for agent in team.agents.values()]
    assert all(agent.line is agent.common for agent in team.agents.values())
    horizon = min(line.horizon for line in lines)
    assert max(line.horizon for line in lines) - horizon <= 1
    level = [line.kernel.commands_digest() for line in lines if line.horizon == horizon]
    assert len(set(level)) == 1 and any(agent.target is not None for agent in team.agents.values())


def test_a_network_in_two_goes_on_as_two_and_becomes_one_again() -> None:
    team = go_on(flock(Air(cut_s=(10.0, 60.0), apart=frozenset(ROBOTS[:2])), contact_m=5.0), 55.0)
    r1, r2, r3 = (team.agents[name] for name in ROBOTS[:3])
    assert r1.line.members == ("r1", "r2") and r3.line.members == ("r3", "r4")
    assert r1.line.kernel.digest() == r2.line.kernel.digest(), "those in contact agree"
    assert r1.line.horizon > r1.common.horizon + 60
    age = r1.lines.ages_s(team.now_ns("r1"))
    assert age["r2"] < 2.0 and 40.0 < age["r3"] < 60.0
    go_on(team, 25.0)
    assert all(agent.line is agent.common for agent in team.agents.values())
    assert len({agent.common.kernel.digest() for agent in team.agents.values()}) == 1


def test_the_others_go_on_when_an_agent_dies() -> None:
    team = go_on(flock(contact_m=5.0), 20.0)
    team.kill("r4")
    go_on(team, AGENT_ABSENT_S + 8.0)
    r1 = team.agents["r1"]
    assert r1.line.members == ("r1", "r2", "r3") and r1.lines.ages_s(team.now_ns("r1"))["r4"] > AGENT_ABSENT_S
    before = {name: (rover.east_m, rover.north_m) for name, rover in team.world.rovers.items()}
    go_on(team, 15.0)
    moved = {n: math.dist(before[n], (r.east_m, r.north_m)) for n, r in team.world.rovers.items()}
    assert moved["r4"] < 0.1 and max(moved.values()) > 1.0


def test_a_hold_for_all_reaches_those_in_reach_at_once_and_the_others_when_they_meet() -> None:
    team = go_on(flock(Air(cut_s=(10.0, 40.0), apart=frozenset(ROBOTS[:2])), contact_m=5.0), 30.0)
    team.order("r1", "hold")
    go_on(team, 1.0)  # a message takes 50 ms: it is there at the next step
    held = {name for name, safety in team.safety.items() if safety.robots[name].ordered == "hold"}
    assert held == {"r1", "r2"}
    go_on(team, 15.0)
    held = {name for name, safety in team.safety.items() if safety.robots[name].ordered == "hold"}
    assert held == set(ROBOTS) and all(agent.target is None for agent in team.agents.values())
    team.order("r3", "resume")
    go_on(team, 10.0)
    assert all(safety.robots[name].ordered == "" for name, safety in team.safety.items())
    assert any(agent.target is not None for agent in team.agents.values())


def test_clocks_that_are_apart_are_measured_and_taken_off() -> None:
    team = Flock(
        settings(), SAFETY, flock().truth, Air(loss=0.1), 1, contact_m=5.0, clock_s=(0.0, 2.0, -3.0, 20.0)
    )
    go_on(team, 60.0)
    assert all(abs(ahead_s) <= 0.1 for ahead_s in team.clock_s.values()), team.clock_s
    assert all(agent.line is agent.common for agent in team.agents.values()) and team.agrees()


def test_a_clock_is_left_as_it_is_where_the_delay_may_be_all_of_it() -> None:
    team = go_on(flock(Air(delay_s=4.0), contact_m=5.0), 1.0)
    team.clock_s["r3"] = 1.5
    go_on(team, 30.0)
    assert team.clock_s["r3"] == 1.5


def test_the_mission_is_over_for_all_at_once() -> None:
    flown = flock(max_duration_s=20.0).fly(60.0)
    assert 20.0 <= flown.elapsed_s < 25.0


# -- one agent -------------------------------------------------------------------------------------------------


def agent(name: str = "r1", **more: float) -> Agent:
    key = session_key(KEY, "flock")
    return Agent(settings(), Talk(Logs(name, ROBOTS), Seal(key, ROBOTS.index(name))), **more)


def run_alone(one: Agent, seconds: int, at_m: tuple[float, float] = (2.0, 2.0)) -> list[GoTo]:
    sent = []
    for tick in range(2 * seconds):
        now_ns = START_NS + tick * TICK_NS
        one.step(Pose(now_ns, one.me, *at_m))
        if tick % 2 == 0:
            one.step(VehicleState(now_ns, one.me, "guided", True))
        sent += [c for c in one.step(Tick(now_ns)).commands if isinstance(c, GoTo)]
    return sent


def test_an_agent_that_hears_nobody_waits_and_then_goes_on_alone() -> None:
    one = agent(patience_s=5.0)
    assert run_alone(one, 4) == []
    assert {command.robot for command in run_alone(agent(patience_s=0.0), 4)} == {"r1"}
    assert one.lines.ages_s(START_NS)["r2"] == math.inf and one.common.horizon < 0


def test_an_agent_logs_its_own_robot_alone_and_not_more_than_is_needed() -> None:
    one = agent()
    run_alone(one, 60)
    for hundredths in range(200):
        one.step(Pose(START_NS + 60 * S + hundredths * S // 100, "r1", 2.0, 2.0))
        one.step(Pose(START_NS + 60 * S, "r2", 2.0, 2.0))
    counts = {key: count for key, count in one.logs.counts().items() if count}
    assert {robot for robot, _ in counts} == {"r1"}
    assert list(counts.values()) == [pytest.approx(7, abs=1), pytest.approx(124, abs=2)]


def test_a_late_hold_is_obeyed_unless_it_was_lifted_since() -> None:
    one = agent()
    hold, resume = Operator(START_NS, "hold"), Operator(START_NS + 60 * S, "resume")
    assert [one._is_new(order) for order in (hold, hold, resume)] == [True, False, True]
    assert not one._is_new(Operator(START_NS + 30 * S, "hold", None, "by another, lifted since"))
    assert one._is_new(Operator(START_NS + 58 * S, "hold", None, "clocks are not that good"))
    assert not one._is_new(Operator(START_NS + 50 * S, "resume", None, "older than the hold"))
    assert not one._is_new(Operator(START_NS + 70 * S, "hold", "r2"))


def test_a_copy_of_a_kernel_goes_its_own_way() -> None:
    team = go_on(flock(), 20.0)
    kernel = team.agents["r1"].common.kernel
    twin, state = kernel.copy(), (kernel.digest(), kernel.commands_digest())
    assert (twin.digest(), twin.commands_digest()) == state
    now_ns = team.now_ns("r1")
    steps: list[Event] = []
    for k in range(80):  # so much is heard that the belief has to make room for it
        t_ns = now_ns + k * TICK_NS
        steps += [Pose(t_ns, name, 5.0, 2.0 + n) for n, name in enumerate(ROBOTS)]
        steps += [RssReading(t_ns, "r1", -55.0 - k % 9), RssReading(t_ns, "r2", -60.0), Tick(t_ns)]
    for event in steps:
        twin.step(event)
    assert (kernel.digest(), kernel.commands_digest()) == state != (twin.digest(), twin.commands_digest())
    for event in steps:
        kernel.step(event)
    assert (kernel.digest(), kernel.commands_digest()) == (twin.digest(), twin.commands_digest())


# -- safety ----------------------------------------------------------------------------------------------------


def apart(contact_m: float | None = None) -> SafetyApart:
    safety = SafetyApart(SAFETY, me="r1", contact_m=contact_m)
    for name, place in zip(ROBOTS, ((1.0, 1.0), (3.0, 1.0), (9.0, 9.0), (9.0, 1.0)), strict=True):
        safety.observe(VehicleState(0, name, "guided", True))
        safety.observe(Pose(0, name, *place))
    return safety


def see(safety: SafetyApart, since_s: int, until_s: int, speed_m_s: float = 0.0) -> list[Hold]:
    """A tick a second; r1 drives north, of r3 nothing is heard. The holds of r1."""
    holds = []
    for second in range(since_s + 1, until_s + 1):
        for name, place in (("r1", (1.0, 1.0 + speed_m_s * second)), ("r2", (3.0, 1.0)), ("r4", (9.0, 1.0))):
            safety.observe(Pose(second * S, name, *place))
        holds += [c for c in safety.observe(Tick(second * S)) if isinstance(c, Hold) and c.robot == "r1"]
    return holds


def test_the_ground_that_one_who_is_not_heard_may_have_reached_is_kept_clear() -> None:
    """r3 stood at (9, 9); at 0.4 m/s it may be 4 m from there after 10 s."""
    safety, before = apart(), 0
    for second, allowed in ((5, True), (10, True), (25, False)):
        see(safety, before, second)
        before = second
        command = safety.allow(GoTo(second * S, "r1", Waypoint(1.0, 5.0, 0.4)))
        assert isinstance(command, GoTo) == allowed, second
    assert isinstance(command, Hold) and "r3 was last heard 25 s ago" in command.reason
    promised = apart(contact_m=6.0)
    see(promised, 0, 25)
    assert isinstance(promised.allow(GoTo(25 * S, "r1", Waypoint(1.0, 5.0, 0.4))), GoTo)


def test_a_promise_of_range_does_not_hold_where_several_fall_silent_at_once_nearby() -> None:
    """r3 and r4 are no more heard, and r4 cannot have gone further than 12 m within 2 s: the network was cut."""
    north = Waypoint(1.0, 5.0, 0.4)
    for contact_m, silent, kept in (
        (12.0, ("r3", "r4"), False),
        (12.0, ("r4",), True),
        (6.0, ("r3", "r4"), True),
    ):
        safety = apart(contact_m)
        places = {"r1": (1.0, 1.0), "r2": (3.0, 1.0), "r3": (9.0, 9.0), "r4": (9.0, 1.0)}
        for second in range(1, 31):
            for name in places.keys() - set(silent):
                safety.observe(Pose(second * S, name, *places[name]))
            safety.observe(Tick(second * S))
        assert (safety.unpromised == set()) == kept
        assert isinstance(safety.allow(GoTo(30 * S, "r1", north)), GoTo) == kept, (contact_m, silent)
        for name in silent:
            safety.observe(Pose(31 * S, name, *places[name]))
        safety.observe(Tick(31 * S))
        assert not safety.unpromised


def test_one_under_way_is_held_before_it_comes_to_such_ground() -> None:
    """Its path ends 8.2 m from where r3 was seen: after 20 s r3 may have come that far."""
    safety = apart()
    assert isinstance(safety.allow(GoTo(0, "r1", Waypoint(1.0, 7.0, 0.1))), GoTo)
    assert see(safety, 0, 15, 0.1) == []
    (hold, *_) = see(safety, 15, 22, 0.1)
    assert "r3 was last heard" in hold.reason


def test_others_go_where_they_say_not_where_one_thinks() -> None:
    safety = apart()
    see(safety, 0, 1)
    safety.expect("r2", Way(1, (3.0, 1.0), (3.0, 6.0), 0.4))
    assert isinstance(safety.allow(GoTo(S, "r1", Waypoint(6.0, 4.0, 0.4))), Hold)
    safety.expect("r2", Way(2, (3.0, 1.0), (3.0, 1.0)))
    assert isinstance(safety.allow(GoTo(S, "r1", Waypoint(1.0, 4.0, 0.4))), GoTo)


def test_a_contact_range_must_leave_room_to_stop() -> None:
    assert least_contact_m(SAFETY) == pytest.approx(0.5 + 2 * 0.4 * 2.0)
    assert least_contact_m(replace(SAFETY, braking_m=1.0)) == pytest.approx(4.1)


def test_an_agent_tells_its_safety_where_the_plan_sends_those_before_it() -> None:
    """And, where it comes to another line, where that has sent them: they may come to it at the same tick."""
    team = flock()
    sent: dict[str, tuple[str, ...]] = {}
    while len(sent) < len(ROBOTS):
        team.step()
        for name, each in team.agents.items():
            if each.target is not None:
                sent.setdefault(name, tuple(other.robot for other in team.safety[name].beside))
    assert sent["r1"] == () and sent["r2"] == ("r1",)
    last = team.agents["r4"]
    last.lines.follows = False  # as after a switch
    last.step(Tick(team.now_ns("r4")))
    assert {each.robot for each in last.beside} == {"r1", "r2", "r3"}
    first = team.agents["r1"]
    first.lines.follows = False
    first.step(Tick(team.now_ns("r1") + 2 * S))
    assert first.beside == (), "it goes first, and what the others were sent just before has been said by now"


def test_it_is_told_as_well_where_the_plan_has_just_sent_others() -> None:
    """Their own word of it may have been lost; by need, robots are sent off tick after tick."""
    me = flock().agents["r2"]
    other = GoTo(0, "r1", Waypoint(5.0, 5.0, 0.4))
    assert me._sent_lately([other], 10 * S) == ()
    assert me._sent_lately([], 11 * S) == (other,)
    assert me._sent_lately([Hold(0, "r1", "")], 11 * S + 1) == ()
    assert me._sent_lately([other], 12 * S) == () and me._sent_lately([], 14 * S) == ()


def test_all_is_found_when_the_first_agent_has_found_it_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the others know, in whatever order they are asked."""
    team = flock()
    kernels = {id(agent.line.kernel): name for name, agent in team.agents.items()}

    def note(kernel: object, truth: Truth, t_s: float, covered_at: dict[int, float]) -> None:
        if kernels.get(id(kernel)) == "r2" and t_s >= 5.0:
            covered_at.setdefault(0, t_s)
            covered_at.setdefault(1, t_s)
        else:
            covered_at.clear()

    monkeypatch.setattr("mission.lab.flock.note_covered", note)
    assert team.fly(10.0).time_to_all_s == pytest.approx(5.0, abs=0.5)
