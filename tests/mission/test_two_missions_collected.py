"""Folders that hold the runs of several missions: one recording is of one mission."""

import asyncio
import shutil
from pathlib import Path

import pytest
from test_agent_runner import START_NS, Robot, both, two

from fieldkit.engine.decentralised.logs import STEP_NS, Logs
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.messages import RssReading
from mission.replay.collect import collect
from mission.replay.missions import missions

ROBOTS = ("r1", "r2")
APART_NS = 60 * 10**9


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two agents' runs of two missions, one after the other."""

    async def act(team: dict[str, Robot]) -> None:
        for _ in range(2):
            flights = asyncio.create_task(both(team))
            for _ in range(8):
                await team["r1"].clock.sleep(1.0)
                for robot in team.values():
                    robot.radio.hear(-60.0)
            await flights

    folder = tmp_path_factory.mktemp("flown")
    two(folder, act, duration_s=8.0)
    return folder


def test_the_latest_of_two_missions_is_taken_in_and_the_other_named(flown: Path, tmp_path: Path) -> None:
    alone = collect(tmp_path / "alone.mcap", [flown / f"{name}-2" for name in ROBOTS])
    done = collect(tmp_path / "both.mcap", [flown])
    assert done.belief_hash == alone.belief_hash and done.notes == alone.notes == []
    assert done.observations == alone.observations and done.compared == done.agreeing == 2
    assert [Path(each).parent.name for each in done.journals] == ["r1-2", "r2-2"]
    assert len(done.refused) == 2
    assert all(
        "-1/" in each and "it is of another mission with the same files" in each for each in done.refused
    )
    shutil.copytree(flown, tmp_path / "first", ignore=shutil.ignore_patterns("*-2"))
    first = collect(tmp_path / "first.mcap", [tmp_path / "first"])
    assert first.refused == [] and first.compared == first.agreeing == 2


def knows(**began_s: float) -> Logs:
    """Logs of a computer that knows one reading of each of these robots, so many seconds after the start."""
    logs = Logs("", ROBOTS)
    for robot, second in began_s.items():
        logs.me = robot
        now_ns = START_NS + round(second * 1e9)
        logs.append(quantised(RssReading(now_ns // STEP_NS * STEP_NS, robot, -50.0)), now_ns)
        logs.close(now_ns)
    logs.me = ""
    return logs


def test_journals_that_share_a_beginning_are_of_one_mission() -> None:
    chain = [knows(r1=0), knows(r2=1), knows(r1=0, r2=1)]
    assert missions(chain, APART_NS) == [[0, 1, 2]]
    begun_anew = knows(r2=1, r1=9)
    assert missions([chain[2], begun_anew], APART_NS) == [[0, 1]], (
        "a second agent for r1: that is for its notes"
    )


def test_journals_that_begin_otherwise_are_of_two_the_later_first() -> None:
    assert missions([knows(r1=0), knows(), knows(r1=5, r2=6), knows(r2=6)], APART_NS) == [[1, 2, 3], [0]]


def test_of_robots_that_never_met_the_time_decides() -> None:
    assert missions([knows(r1=0), knows(r2=60)], APART_NS) == [[0, 1]]
    assert missions([knows(r1=0), knows(r2=61)], APART_NS) == [[1], [0]]
    assert missions([knows(r1=0), knows(r2=40, r1=30)], APART_NS) == [[1], [0]], "r1 has begun anew"


def test_without_any_observation_there_is_one_mission() -> None:
    assert missions([knows(), knows()], APART_NS) == [[0, 1]]
