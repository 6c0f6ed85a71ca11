"""Agents' journals laid together: what one computer would have recorded, whatever is missing or does not belong."""

import asyncio
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from test_agent_runner import Robot, both, two
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.engine.decentralised.logs import NEVER, STEP_NS, Logs, Stream
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.errors import DataError, RecordingError
from fieldkit.messages import Operator, RssReading
from fieldkit.recording.reader import open_recording
from mission.analysis import refit as campaign
from mission.replay.collect import collect, lay_together, operators_orders
from mission.replay.command import Changes
from mission.replay.replay import replay
from mission.shell import journal as journals

ROBOTS = ("r1", "r2")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folders of two agents; r1's operator holds all and lets all go on."""

    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        r1 = team["r1"]
        for second in range(15):
            await r1.clock.sleep(1.0)
            for robot in team.values():
                robot.radio.hear(-60.0)
            if second in (6, 8) and r1.runner is not None:
                r1.runner.put(Operator(r1.clock.now_ns(), "hold" if second == 6 else "resume", None, "look"))
        await flights

    folder = tmp_path_factory.mktemp("flown")
    two(folder, act, duration_s=12.0)
    return folder


@pytest.fixture
def runs(flown: Path, tmp_path: Path) -> Path:
    """A copy to spoil."""
    for name in ROBOTS:
        shutil.copytree(flown / f"{name}-1", tmp_path / f"{name}-1")
    return tmp_path


def journal(runs: Path, name: str) -> Path:
    return runs / f"{name}-1" / journals.NAME


def test_two_journals_make_the_recording_that_one_computer_would_have_made(runs: Path) -> None:
    out = runs / "collected.mcap"
    done = collect(out, [runs])
    assert done.notes == [] and done.refused == [] and done.compared == done.agreeing == 2
    assert done.given > 1.9 * done.observations > 50 and done.orders == 2
    common = open_recording(runs / "r1-1" / "common.mcap")
    again = replay(out)
    assert again.complete and again.compared > 50
    theirs, ours = list(common.events()), list(open_recording(out).events())
    assert [event for _, _, event in theirs] == [event for _, _, event in ours][: len(theirs)]
    assert campaign.refit([out], Changes(what_if=True)).detections >= again.kernel.detections > 5


def test_what_a_lost_robot_observed_is_taken_from_the_others(runs: Path) -> None:
    both_known = collect(runs / "all.mcap", [runs])
    shutil.rmtree(runs / "r2-1")
    done = collect(runs / "collected.mcap", [runs])
    lost = both_known.observations - done.observations
    assert 0 <= lost <= 5 and not done.robots["r2"]["own_journal"], "what r2 said in its last second"
    assert any(note.startswith("r2: its own journal is not here; others knew") for note in done.notes)
    assert done.belief_hash == both_known.belief_hash
    said = [note.text for _, note in open_recording(runs / "collected.mcap").notes()]
    assert done.notes[0] in said


def cut(runs: Path) -> None:
    path = journal(runs, "r2")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def lost(runs: Path) -> None:
    path = journal(runs, "r2")
    path.unlink()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (cut, "r2: its agent did not come to its end, still runs, or its journal is cut"),
        (lost, "r2: its own journal is not here"),
    ],
)
def test_what_is_missing_is_said(runs: Path, spoil: Callable[[Path], None], words: str) -> None:
    spoil(runs)
    done = collect(runs / "collected.mcap", [runs])
    assert any(words in note for note in done.notes) and replay(runs / "collected.mcap").complete


def rewritten(runs: Path, name: str, **changed: str) -> None:
    """A journal with another head."""
    path = journal(runs, name)
    head = journals.head_of(path)
    values = {"robot": head.robot, "mission_hash": head.mission_hash, "made": head.made, "team": head.team}
    old, new = (json.dumps(list(each.values())).encode() for each in (values, values | changed))
    other = journals.Journal(path.with_name("other"))
    other.begin(journals.Head(**(values | changed)))
    other.close()
    first = len(path.with_name("other").read_bytes()) - len(new) + len(old)
    rest = path.read_bytes()[first:]
    path.write_bytes(path.with_name("other").read_bytes() + rest)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"mission_hash": "0" * 12}, "another mission or antenna file (000000000000; the first with"),
        ({"team": "ff" * 6}, "another mission key"),
        ({"made": "9.9.9 abc"}, "another fieldkit (9.9.9 abc; the first with"),
        ({"robot": "r9"}, "it is of 'r9', which is not in the mission (r1, r2)"),
    ],
)
def test_what_does_not_belong_is_named_and_left_out(runs: Path, changed: dict[str, str], words: str) -> None:
    rewritten(runs, "r2", **changed)
    done = collect(runs / "collected.mcap", [runs])
    (refused,) = done.refused
    assert words in refused and len(done.journals) == 1 and done.observations > 20


@pytest.mark.parametrize("name", ROBOTS)
def test_a_journal_alone_is_taken_in_beside_one_that_has_its_mission(runs: Path, name: str) -> None:
    """Whichever comes first."""
    for recording in ("mission.mcap", "common.mcap"):
        (runs / f"{name}-1" / recording).unlink()
    done = collect(runs / "collected.mcap", [runs])
    assert done.refused == [] and len(done.journals) == 2 and done.compared == 1


def test_a_recording_of_another_mission_beside_a_journal_is_not_taken_for_its_own(runs: Path) -> None:
    for name in ROBOTS:
        rewritten(runs, name, mission_hash="0" * 12)
    with pytest.raises(DataError, match=r"mission\.mcap beside it is of another mission or antenna file"):
        collect(runs / "collected.mcap", [runs])


def test_a_laptops_journal_that_is_cut_is_named(runs: Path) -> None:
    rewritten(runs, "r2", robot="")
    assert not any("did not come to its end" in each for each in collect(runs / "whole.mcap", [runs]).notes)
    cut(runs)
    notes = collect(runs / "collected.mcap", [runs]).notes
    assert any(
        f"{journal(runs, 'r2')}: a computer that watched did not come to its end" in each for each in notes
    )


def test_the_same_journal_given_twice_is_one(runs: Path) -> None:
    done = collect(
        runs / "c.mcap", [runs / "r1-1", runs / "r1-1" / "mission.mcap", journal(runs, "r1"), runs]
    )
    assert len(done.journals) == 2


def test_a_place_without_a_journal_is_named(runs: Path) -> None:
    (runs / "empty").mkdir()
    with pytest.raises(DataError, match="there is no such file or folder"):
        collect(runs / "c.mcap", [runs / "nowhere"])
    with pytest.raises(DataError, match=r"no agent's observations\.log is there"):
        collect(runs / "c.mcap", [runs / "empty"])
    noise = runs / "noise.log"
    noise.write_bytes(bytes(500))
    done = collect(runs / "c.mcap", [noise, runs])
    assert "expected an agent's observations.log" in done.refused[0] and len(done.journals) == 2
    with pytest.raises(RecordingError, match="never overwritten"):
        collect(runs / "c.mcap", [runs])


def test_the_command_says_what_it_did_and_reports_what_it_left_out(runs: Path) -> None:
    runner, out = CliRunner(), runs / "collected.mcap"
    done = runner.invoke(build(), ["collect", str(out), str(runs)])
    assert done.exit_code == 0 and "2 operator's orders" in done.output and out.is_file()
    assert "2 of 2 ended with the belief that these observations give" in done.output
    assert all(len(line) <= 80 for line in done.output.splitlines() if not line.startswith("written"))
    other = runner.invoke(build(), ["collect", str(runs / "d"), str(runs), str(runs / "nowhere"), "--json"])
    assert other.exit_code == 2 and (runs / "d" / "mission.mcap").is_file()
    assert runner.invoke(build(), ["report", str(out), "-o", str(runs / "report.html")]).exit_code == 0
    assert runner.invoke(build(), ["analyze", str(runs / "d")]).exit_code == 0


# -- laying together -------------------------------------------------------------------------------------------


def heard(me: str, *levels_dbm: float) -> Logs:
    """Logs in which r2 has heard these levels, a second apart."""
    logs = Logs("r2", ROBOTS)
    for second, level in enumerate(levels_dbm):
        now_ns = 10**18 + second * 10**9
        logs.append(quantised(RssReading(now_ns // STEP_NS * STEP_NS, "r2", level)), now_ns)
    logs.close(10**18 + len(levels_dbm) * 10**9)
    logs.me = me
    return logs


def test_an_order_in_the_logs_of_two_robots_is_one_order_and_a_withdrawal_is_none() -> None:
    logs, now_ns = Logs("r1", ROBOTS), 10**18
    for robot in ROBOTS:
        logs.me = robot
        logs.append(quantised(Operator(now_ns, "hold", None, "from a laptop")), now_ns + 10**9)
        logs.append(quantised(Operator(now_ns + 10**9, "withdraw", robot, "Ctrl-C")), now_ns + 2 * 10**9)
    orders = operators_orders(logs)
    assert [(order.action, order.reason) for order in orders] == [("hold", "from a laptop")]


def levels(logs: Logs) -> list[float]:
    return [entry.event.rss_dbm for entry in logs.entries["r2", Stream.HEARD]]  # type: ignore[union-attr]


def test_the_longest_of_logs_that_agree_is_taken() -> None:
    whole, words = lay_together([heard("r1", -50), heard("r2", -50, -51, -52), heard("r2", -50, -51)], ROBOTS)
    assert words == [] and levels(whole) == [-50.0, -51.0, -52.0]
    assert whole.closed["r1", Stream.HEARD] == NEVER


def test_of_logs_that_contradict_the_one_is_taken_that_more_have() -> None:
    whole, words = lay_together([heard("r1", -50), heard("r2", -70, -71, -72), heard("r1", -50, -51)], ROBOTS)
    assert levels(whole) == [-50.0, -51.0]
    (said,) = words
    assert (
        "r2's log of heard is another one in the journal of r2: were there two agents for r2, or was it ended"
        in said
    )


def test_whoever_left_before_logs_went_apart_has_no_say_in_which_is_kept() -> None:
    first, again, others = heard("r2", -50, -51), heard("r2", -50, -61, -62), heard("r1", -50, -61)
    for early in (heard("", -50), heard("")):
        whole, words = lay_together([early, first, again, early, others], ROBOTS)
        assert levels(whole) == [-50.0, -61.0, -62.0] and len(words) == 1
    whole, _ = lay_together([heard(""), heard("r2", -50), heard("r2", -70, -71)], ROBOTS)
    assert levels(whole) == [-70.0, -71.0], "of as many the longer one"
