"""The journal of an agent: whose it is, a disk that fails, a start that fails, and what stands in it then."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from test_agent_runner import KEY, START_NS, card

from fieldkit.clock import RealClock
from fieldkit.engine.decentralised.logs import Logs
from fieldkit.errors import DeviceError
from fieldkit.jumploop import LoopClock
from fieldkit.messages import Operator, Tick
from fieldkit.world.bodies import Rover
from fieldkit.world.fake_network import Ether
from fieldkit.world.fakes import FakeFleet
from fieldkit.world.network import Air
from mission.lab.synthetic import small_mission
from mission.shell import journal as journals
from mission.shell.agent_flight import Options, fly_agent, head_of, interrupted, left, make_agent
from mission.shell.setups import Setup


def test_a_journal_is_taken_up_only_by_its_robot_mission_and_in_time(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, robots=2)
    mine = card(mission)
    agent = make_agent(mission, mine, Options("r1", KEY, None, 1400.0))
    folder = tmp_path / "runs" / "one"
    folder.mkdir(parents=True)
    journal = journals.Journal(folder / journals.NAME)
    journal.begin(journals.Head("r1", mine.mission_hash))
    agent.step(Tick(START_NS))
    agent.step(Operator(START_NS, "hold", None, "stop"))
    journal.write(agent.logs)
    out = tmp_path / "runs"
    assert interrupted(out, mine, KEY) == journal.path and left(out, mine, KEY) is None
    assert interrupted(out, replace(mine, robot="r2"), KEY) is None
    assert interrupted(out, replace(mine, mission_hash="other"), KEY) is None
    assert interrupted(out, replace(mine, started_ns=mine.started_ns + 3 * 3600 * 10**9), KEY) is None
    logs = Logs("r1", agent.logs.robots)
    assert journals.load(journal.path, logs) == (1, "") and logs.entries == agent.logs.entries
    journal.end()
    journal.close()
    assert interrupted(out, mine, KEY) is None and left(out, mine, KEY) is None, "that mission is over"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a full disk of Linux")
def test_a_disk_that_fails_is_said_once_and_the_agent_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mission = small_mission(tmp_path, robots=2)
    agent = make_agent(mission, card(mission), Options("r1", KEY, None, 1400.0))
    journal = journals.Journal(tmp_path / journals.NAME)
    journal.begin(journals.Head("r1", "x"))
    journal.close()
    journal._file = os.open("/dev/full", os.O_WRONLY)
    agent.step(Tick(START_NS))
    agent.step(Operator(START_NS, "hold"))
    journal.write(agent.logs)
    journal.write(agent.logs)
    journal.close()
    assert (
        "cannot be written: No space left" in journal.failure and caplog.text.count("cannot be written") == 1
    )


def test_a_disk_that_takes_a_part_of_a_record_gets_the_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = small_mission(tmp_path, robots=2)
    agent = make_agent(mission, card(mission), Options("r1", KEY, None, 1400.0))
    write = os.write
    monkeypatch.setattr("mission.shell.journal.os.write", lambda file, data: write(file, data[:7]))
    journal = journals.Journal(tmp_path / journals.NAME)
    journal.begin(journals.Head("r1", "x"))
    agent.step(Tick(START_NS))
    agent.step(Operator(START_NS, "hold"))
    journal.write(agent.logs)
    journal.end()
    journal.close()
    assert journal.failure == "" and journals.is_ended(journal.path)
    assert journals.load(journal.path, Logs("r1", agent.logs.robots)) == (1, "")


class Unplugged(FakeFleet):
    """A vehicle whose link cannot be opened."""

    async def __aenter__(self) -> "Unplugged":
        raise DeviceError("no such port")


def test_a_start_that_fails_keeps_what_the_journal_before_knew(tmp_path: Path) -> None:
    """The next start goes on with the newest journal: an empty one would give numbers twice."""
    mission = small_mission(tmp_path, robots=2)
    mine, clock = card(mission), RealClock()
    before = tmp_path / "before"
    before.mkdir()
    agent = make_agent(mission, mine, Options("r1", KEY, None, 1400.0))
    journal = journals.Journal(before / journals.NAME)
    journal.begin(head_of(mine, KEY))
    agent.step(Tick(clock.now_ns()))
    agent.step(Operator(clock.now_ns(), "hold"))
    journal.write(agent.logs)
    journal.close()
    setup = Setup(clock, (), (Unplugged({"r1": Rover(1.0, 1.0)}, LoopClock(START_NS)),))
    after = tmp_path / "after"
    after.mkdir()
    network = Ether(Air(), 1, clock, dict).member("r1")
    options = Options("r1", KEY, None, 1400.0, resumed=journal.path)
    with pytest.raises(DeviceError):
        fly_agent(mission, setup, network, mine, options, after)
    logs = Logs("r1", agent.logs.robots)
    assert journals.load(after / journals.NAME, logs) == (1, "") and logs.entries == agent.logs.entries
