"""An agent that is started again stands by operators' orders as before: by the last one, whoever brings old ones."""

from pathlib import Path

import pytest
from test_agent_journal import Unplugged
from test_agent_runner import KEY, START_NS, card

from fieldkit.clock import VirtualClock
from fieldkit.engine.decentralised.logs import Entry, Logs, Part, Stream
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.decentralised.sealing import Seal
from fieldkit.engine.decentralised.talk import Talk, code_of
from fieldkit.errors import DeviceError
from fieldkit.messages import Operator, VehicleState
from fieldkit.world.bodies import Rover
from fieldkit.world.fake_network import Ether
from fieldkit.world.network import Air
from mission.lab.synthetic import small_mission
from mission.shell import journal as journals
from mission.shell.agent_flight import Options, fly_agent, head_of
from mission.shell.agent_runner import AgentRunner
from mission.shell.setups import Setup

S = 10**9


def given(action: str, at_s: float, robot: str | None = None) -> Operator:
    order = quantised(Operator(START_NS + round(at_s * S), action, robot))  # type: ignore[arg-type]
    assert isinstance(order, Operator)
    return order


def begun_again(folder: Path, *known: tuple[str, float, Operator]) -> AgentRunner:
    """r1's agent, started again with these orders in its journal: in whose log, since when, and which."""
    mission = small_mission(folder, robots=2)
    logs = Logs("r1", mission.kernel.engine.robots)
    for author, at_s, order in known:
        now_ns = START_NS + round(at_s * S)
        if author == "r1":
            logs.append(order, now_ns)
        else:
            key = (author, Stream.ORDERS)
            logs.take(Part(*key, len(logs.entries[key]), (Entry(now_ns, order),)))
    mine, clock = card(mission), VirtualClock(START_NS)
    journal = journals.Journal(folder / "before.log")
    journal.begin(head_of(mine, KEY))
    journal.write(logs)
    journal.close()
    begun: list[AgentRunner] = []
    options = Options("r1", KEY, None, 1400.0, resumed=journal.path)
    setup = Setup(clock, (), (Unplugged({"r1": Rover(1.0, 1.0)}, clock),))
    network = Ether(Air(), 1, clock, dict).member("r1")
    with pytest.raises(DeviceError):
        fly_agent(mission, setup, network, mine, options, folder, on_start=begun.append)  # type: ignore[arg-type]
    return begun[0]


def test_an_old_resume_that_came_late_lifts_no_hold_by_a_restart(tmp_path: Path) -> None:
    late = ("r2", 30.0, given("resume", 15.0))
    runner = begun_again(tmp_path, ("r1", 20.0, given("hold", 20.0)), late)
    assert runner.safety.robots["r1"].ordered == "hold"


def test_an_old_hold_that_came_late_holds_nobody_by_a_restart(tmp_path: Path) -> None:
    late = ("r2", 30.0, given("hold", 1.0))
    runner = begun_again(tmp_path, ("r1", 20.0, given("resume", 20.0)), late)
    assert runner.safety.robots["r1"].ordered == ""


def test_the_last_order_stands_whoever_gave_it(tmp_path: Path) -> None:
    orders = (("r1", 20.0, given("hold", 20.0)), ("r2", 30.0, given("resume", 30.0)))
    runner = begun_again(tmp_path, *orders, ("r2", 40.0, given("hold", 40.0, "r2")))
    assert {name: robot.ordered for name, robot in runner.safety.robots.items()} == {"r1": "", "r2": "hold"}


def test_an_order_that_was_obeyed_before_a_restart_is_not_obeyed_once_more(tmp_path: Path) -> None:
    hold = given("hold", 1.0)
    runner = begun_again(tmp_path, ("r1", 1.0, hold), ("r2", 20.0, given("resume", 20.0)))
    agent = runner.crew.agent
    number = agent.logs.robots.index("r2")
    r2 = Talk(Logs("r2", agent.logs.robots), Seal(agent.talk.seal.key, number))
    now_ns = START_NS + 40 * S
    assert agent.take(r2.say_order(hold, now_ns), now_ns) == []
    assert agent.take(r2.say_order(given("hold", 39.0), now_ns), now_ns) == [given("hold", 39.0)]
    assert agent.talk.obeyed == code_of(given("hold", 39.0))


def test_after_a_restart_nobody_is_told_that_it_holds_before_its_vehicle_is_heard(tmp_path: Path) -> None:
    runner = begun_again(tmp_path, ("r1", 10.0, given("hold", 10.0)))
    talk = runner.crew.agent.talk
    runner._speak()
    assert talk.is_to_hold and not talk.shows_hold
    for mode in ("guided", "hold"):
        runner.decide(VehicleState(runner.setup.clock.now_ns(), "r1", mode, True))  # type: ignore[arg-type]
        runner._speak()
        assert talk.shows_hold == (mode == "hold")
        if mode == "guided":
            runner._unshown_since_s = runner.setup.clock.elapsed_s() - 2.0
            (said,) = runner.alarms()
            assert said == "r1 has not shown for 2 s that it holds (its vehicle's mode is guided)"
        else:
            assert not runner.alarms()


def test_a_vehicle_that_has_come_to_hold_between_two_ticks_is_no_alarm(tmp_path: Path) -> None:
    runner = begun_again(tmp_path, ("r1", 10.0, given("hold", 10.0)))
    runner._speak()
    runner._unshown_since_s = runner.setup.clock.elapsed_s() - 2.0
    assert len(runner.alarms()) == 1
    runner.decide(VehicleState(runner.setup.clock.now_ns(), "r1", "hold", True))
    assert not runner.alarms()
