"""An agent that is ended and started again while others go on takes up its log. A new mission begins a new one."""

import asyncio
import os
from collections.abc import Callable
from pathlib import Path

import pytest
from test_agent_runner import KEY, Act, Robot, both, card, notes, two

from fieldkit.engine.decentralised.logs import Logs, Stream
from fieldkit.errors import RecordingError
from fieldkit.messages import Operator
from fieldkit.world.network import Air
from mission.lab.synthetic import small_mission
from mission.replay.collect import collect
from mission.shell import journal as journals
from mission.shell.agent_flight import head_of, interrupted, left
from mission.shell.look_round import OWN_LOG_S

NAMES = ("r1", "r2")
FAR = Air(range_m=100.0)


def end(robot: Robot) -> None:
    assert robot.runner is not None
    robot.runner.put(Operator(robot.clock.now_ns(), "end", None, "stopped by Ctrl-C"))


def give(robot: Robot, action: str) -> None:
    assert robot.runner is not None
    robot.runner.put(Operator(robot.clock.now_ns(), action, None, "operator"))  # type: ignore[arg-type]


def drives(robot: Robot) -> bool:
    return robot.fleet.rovers[robot.name].target_m is not None


async def until(robot: Robot, true: Callable[[], bool], most_s: float = 60.0) -> None:
    began_s = robot.clock.elapsed_s()
    while not true():
        assert robot.clock.elapsed_s() - began_s < most_s
        await robot.clock.sleep(0.1)


def known(journal: Path, robot: str) -> list[object]:
    logs = Logs(robot, NAMES)
    journals.load(journal, logs)
    return [entry for stream in Stream for entry in logs.entries[robot, stream]]


def put_far(team: dict[str, Robot], name: str) -> Callable[[], None]:
    """Out of everybody's reach; what brings it back."""
    ether = team["r1"].network._ether
    places = ether._places_m
    ether._places_m = lambda: {**places(), name: (1000.0, 0.0)}

    def back() -> None:
        ether._places_m = places

    return back


def one_log(folder: Path, team: dict[str, Robot]) -> None:
    """All that was written fits together, and both agree in the end."""
    first, second = (robot.runner.result() for robot in team.values() if robot.runner)
    assert first["common_hash"] == second["common_hash"]
    paths = [folder / f"{name}-{n + 1}" for name in NAMES for n in range(team[name].flights)]
    done = collect(folder / "collected.mcap", paths)
    assert not [note for note in done.notes if "is another one" in note], done.notes
    assert done.refused == [] and done.compared == done.agreeing


def came_back(act_between: Act, has_journal: bool) -> Act:
    """r2's agent is ended and started again; r1's goes on."""

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await until(r1, lambda: drives(r1) and drives(r2))
        await r1.clock.sleep(5.0)
        end(r2)
        await flights[1]
        await r1.clock.sleep(15.0)
        journal = r2.log / journals.NAME
        flights[1] = asyncio.create_task(r2.fly(left=journal if has_journal else None))
        await act_between(team)
        await asyncio.gather(*flights)

    return act


@pytest.mark.parametrize("has_journal", [True, False], ids=["with its journal", "without"])
def test_an_agent_that_was_ended_takes_up_its_log_and_its_robot_is_a_member_again(
    tmp_path: Path, has_journal: bool
) -> None:
    async def drives_again(team: dict[str, Robot]) -> None:
        await until(team["r1"], lambda: drives(team["r2"]))
        assert not team["r1"].runner.crew.agent.line.kernel.robots["r2"].held  # type: ignore[union-attr]

    team = two(tmp_path, came_back(drives_again, has_journal), duration_s=70.0)
    before, after = (known(tmp_path / f"r2-{n}" / journals.NAME, "r2") for n in (1, 2))
    assert all(entry in after for entry in before) and len(after) > len(before) + 10
    said = notes(team["r2"].log / "mission.mcap")
    assert said.count("goes on with r2's log, where it stood") == said.count("goes on with") == 1
    assert "resume r2: its agent was started again" in notes(team["r2"].log / "common.mcap")
    one_log(tmp_path, team)


def test_a_journal_with_a_cut_end_gets_the_rest_from_the_others(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await until(r1, lambda: drives(r1) and drives(r2))
        await r1.clock.sleep(10.0)
        end(r2)
        await flights[1]
        data, journal = (r2.log / journals.NAME).read_bytes(), tmp_path / "cut.log"
        journal.write_bytes(data[: len(data) // 2])
        assert 0 < len(known(journal, "r2")) < len(known(r2.log / journals.NAME, "r2")) - 3
        flights[1] = asyncio.create_task(r2.fly(left=journal))
        await until(r1, lambda: drives(r2))
        await asyncio.gather(*flights)

    team = two(tmp_path, act, duration_s=70.0)
    assert all(
        entry in known(team["r2"].log / journals.NAME, "r2")
        for entry in known(tmp_path / "r2-1" / journals.NAME, "r2")
    )
    one_log(tmp_path, team)


def test_a_hold_that_was_given_meanwhile_stands_also_where_it_is_heard_of_late(tmp_path: Path) -> None:
    """r2 goes on alone after its patience; of the hold at r1 it learns when they meet."""

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await until(r1, lambda: drives(r1) and drives(r2))
        end(r2)
        await flights[1]
        back = put_far(team, "r2")
        give(r1, "hold")
        await r1.clock.sleep(15.0)
        flights[1] = asyncio.create_task(r2.fly(left=r2.log / journals.NAME))
        await r1.clock.sleep(50.0)
        assert r2.runner is not None and not r2.runner.crew.agent.logs.has_begun, "it still listens"
        await until(r1, lambda: drives(r2), 120.0)
        back()
        await until(r1, lambda: not drives(r2), 10.0)
        await r1.clock.sleep(5.0)
        assert not drives(r1) and not drives(r2)
        for robot in team.values():
            assert all(each.held for each in robot.runner.crew.agent.line.kernel.robots.values())  # type: ignore[union-attr]
        give(r1, "resume")
        await until(r1, lambda: drives(r1) and drives(r2), 20.0)
        await asyncio.gather(*flights)

    team = two(tmp_path, act, duration_s=250.0, air=FAR)
    assert "not all of them are heard: it listens for 60 s" in notes(team["r2"].log / "mission.mcap")
    one_log(tmp_path, team)


def test_a_hold_from_before_stands(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await until(r1, lambda: drives(r1) and drives(r2))
        give(r1, "hold")
        await r1.clock.sleep(3.0)
        end(r2)
        await flights[1]
        flights[1] = asyncio.create_task(r2.fly(left=r2.log / journals.NAME))
        for _ in range(100):
            await r1.clock.sleep(0.1)
            assert not drives(r2)
        give(r2, "resume")
        await until(r1, lambda: drives(r2), 20.0)
        await asyncio.gather(*flights)

    team = two(tmp_path, act, duration_s=60.0)
    one_log(tmp_path, team)


def test_a_mission_that_all_were_ended_in_is_over_and_a_new_one_begins_anew(tmp_path: Path) -> None:
    """r1's was ended first, and does not know that r2's was too."""

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await until(r1, lambda: drives(r1) and drives(r2))
        end(r1)
        await flights[0]
        await r1.clock.sleep(15.0)
        end(r2)
        await flights[1]
        flights = [asyncio.create_task(r1.fly(left=r1.log / journals.NAME))]
        await r1.clock.sleep(20.0)
        flights.append(asyncio.create_task(r2.fly(left=r2.log / journals.NAME)))
        await asyncio.gather(*flights)

    team = two(tmp_path, act, duration_s=30.0)
    for name, robot in team.items():
        said = notes(robot.log / "mission.mcap")
        assert "begins a new mission" in said and f"goes on with {name}" not in said
        old, new = (known(tmp_path / f"{name}-{n}" / journals.NAME, name) for n in (1, 2))
        assert old and new and not [entry for entry in old if entry in new]
    first, second = (robot.runner.result() for robot in team.values() if robot.runner)
    assert first["common_hash"] == second["common_hash"] and "time is up" in first["end_reason"]


def test_nothing_is_added_to_a_log_of_which_others_have_more_than_they_bring(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await until(r1, lambda: drives(r1) and drives(r2))
        end(r2)
        await flights[1]
        assert r1.runner is not None
        r1.runner.crew.agent.talk.bytes_s = 0.0  # tables alone
        flights[1] = asyncio.create_task(r2.fly())
        await r1.clock.sleep(OWN_LOG_S - 10.0)
        assert r2.runner is not None and not r2.runner.crew.agent.logs.has_begun
        with pytest.raises(
            RecordingError, match=r"others have more of r2's log .* start its agent again where it"
        ):
            await flights[1]
        assert not any(r2.runner.crew.agent.logs.counts()[key] for key in r2.runner.crew.agent.logs.own)
        end(r1)
        await flights[0]

    two(tmp_path, act, duration_s=1000.0)


def test_the_latest_journal_counts_and_one_without_observations_does_not(tmp_path: Path) -> None:
    """Of one that was killed, gone on with and then ended, the first part is not taken up again."""
    mission = small_mission(tmp_path, robots=2)
    mine, out = card(mission), tmp_path / "runs"
    logs = Logs("r1", NAMES)
    logs.append(Operator(mine.started_ns, "hold"), mine.started_ns)
    now_s = mine.started_ns * 1e-9

    def write(name: str, age_s: float, knows: Logs, left_early: bool | None, key: bytes = KEY) -> Path:
        (out / name).mkdir(parents=True)
        journal = journals.Journal(out / name / journals.NAME)
        journal.begin(head_of(mine, key))
        journal.write(knows)
        if left_early is not None:
            journal.end(left=left_early)
        journal.close()
        os.utime(journal.path, (now_s - age_s, now_s - age_s))
        return journal.path

    killed = write("killed", 400.0, logs, None)
    assert (interrupted(out, mine, KEY), left(out, mine, KEY)) == (killed, None)
    ended = write("ended", 300.0, logs, True)
    assert (interrupted(out, mine, KEY), left(out, mine, KEY)) == (None, ended)
    write("not begun", 200.0, Logs("r1", NAMES), None)
    write("of another key", 150.0, logs, None, bytes(32))
    assert (interrupted(out, mine, KEY), left(out, mine, KEY)) == (None, ended)
    write("over", 100.0, logs, False)
    assert (interrupted(out, mine, KEY), left(out, mine, KEY)) == (None, None)


def test_a_mission_that_ends_by_itself_is_not_gone_on_with(tmp_path: Path) -> None:
    team = two(tmp_path, both, duration_s=15.0)
    for name, robot in team.items():
        path, now_s = robot.log / journals.NAME, robot.log.stat().st_mtime
        head = head_of(card(robot.mission, name), KEY)
        assert journals.latest(tmp_path, head, now_s) == (path, journals.Ending.OVER)
