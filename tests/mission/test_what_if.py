"""Replays with something changed, at a pace, of many recordings, and of merged ones."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.errors import ConfigError, DataError
from fieldkit.messages import Plan, RssReading, Tick, Waypoint
from fieldkit.recording import RecordingWriter, open_recording
from fieldkit.recording.merge import merge
from fieldkit.recording.redact import redact
from mission.lab.synthetic import record_simulated
from mission.replay.command import Changes, compare_plans, replay_one
from mission.replay.pace import Pace, line
from mission.replay.replay import changed, recorded_mission, replay, what_if


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_simulated(tmp_path_factory.mktemp("log"), seed=2, duration_s=60.0)


def test_setting_a_key_changes_what_the_engine_believes(log: Path) -> None:
    same = replay_one(log, Changes(what_if=True))
    other = replay_one(log, Changes(keys=("sources.rate_hz=0.5",)))
    assert other["identical"] is None and other["belief_hash"] != same["belief_hash"]
    assert same["belief_hash"] == replay_one(log, Changes())["belief_hash"]


def test_the_same_planner_makes_the_same_plans_and_another_does_not(log: Path) -> None:
    same = replay_one(log, Changes(what_if=True))["planner"]
    assert same["plans"] == same["plans_flown"] > 0
    assert same["same_first_waypoints"] == same["compared_first_waypoints"] > 0
    other = replay_one(log, Changes(planner="patrol"))["planner"]
    assert other["median_apart_m"] > 0.01


def test_plans_are_compared_with_the_missions_last_before_them(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    plan = Plan(10, {"r1": (Waypoint(1.0, 1.0, 0.1),)})
    with RecordingWriter(path) as writer:
        writer.event(1, 10, Tick(10))
        writer.plan(1, 10, plan)
    said = compare_plans(open_recording(path), [Plan(20, {"r1": (Waypoint(4.0, 5.0, 0.1),)})], None)
    assert said["median_apart_m"] == 5.0 and said["compared_first_waypoints"] == 1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("engine.min_receptions", "expected TABLE.KEY=VALUE"),
        ("min_receptions=3", "expected TABLE.KEY=VALUE"),
        ("engine.min_receptoins=3", "no such key"),
        ("engine.min_receptions=few", "min_receptions"),
        ("engine.belief=none", "expected one of"),
        ("field.size_east_m=3", "can be changed after the fact"),
        ("engine.belief.x=3", "is not a table"),
    ],
)
def test_a_key_that_cannot_be_set_is_refused_by_name(log: Path, change: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        what_if(recorded_mission(open_recording(log)), changes=[change])


def test_bare_words_and_toml_values_are_both_understood() -> None:
    text = changed(
        "[engine]\nbelief = 'x'\n",
        ["engine.belief=spog", "engine.min_receptions=3", "end.max_duration_s=9.5"],
    )
    assert '"spog"' in text and "min_receptions = 3" in text and "max_duration_s = 9.5" in text


def test_a_pace_holds_back_and_shows_moments(log: Path) -> None:
    now_s, shown = [0.0], []

    def sleep(duration_s: float) -> None:
        now_s[0] += duration_s

    pace = Pace(10.0, shown.append, every_s=1.0, sleep=sleep, now_s=lambda: now_s[0])
    done = replay(log, on_step=pace)
    assert now_s[0] == pytest.approx(done.duration_s / 10.0)
    plain = [moment.t_s for moment in shown if not moment.notes]
    assert all(after - before >= 9.9 for before, after in pairwise(plain))
    assert "heard" in line(shown[-1]) and [m.t_s for m in shown] == sorted(m.t_s for m in shown)


def test_a_time_outside_the_log_is_refused(log: Path) -> None:
    for until_s in (-1.0, 1e6):
        with pytest.raises(DataError, match="outside the log"):
            replay_one(log, Changes(), until_s=until_s)


def test_many_recordings_at_once_and_the_one_that_differs(log: Path, tmp_path: Path) -> None:
    runner, bad = CliRunner(), tmp_path / "bad.mcap"
    bad.write_text("no")
    done = runner.invoke(build(), ["replay", str(log), str(log), "--json"])
    assert [row["identical"] for row in json.loads(done.stdout)] == [True, True] and done.exit_code == 0
    done = runner.invoke(build(), ["replay", str(log), str(bad), "--json"])
    rows = json.loads(done.stdout)
    assert done.exit_code == 2 and rows[0]["identical"] and "not an MCAP" in rows[1]["error"]


def test_a_redacted_recording_replays_to_the_same(log: Path, tmp_path: Path) -> None:
    redact(log, tmp_path / "out.mcap")
    assert replay_one(tmp_path / "out.mcap", Changes())["identical"]


def test_recordings_apart_merge_into_one_that_hears_the_same(log: Path, tmp_path: Path) -> None:
    """Split by robot, one clock set off: merged again, the engine hears what it heard."""
    whole = open_recording(log)
    shift_ns = 3_210_000_000
    for name, robots, off_ns in (("a", ("r1", "r2"), 0), ("b", ("r3", "r4"), shift_ns)):
        with RecordingWriter(
            tmp_path / f"{name}.mcap", mission_toml=whole.mission_toml, antenna_toml=whole.antenna_toml
        ) as writer:
            for number, log_ns, event in whole.events():
                if getattr(event, "robot", None) in robots:
                    writer.event(number, log_ns + off_ns, replace(event, t_ns=event.t_ns + off_ns))
    out = tmp_path / "all.mcap"
    merge([tmp_path / "a.mcap", tmp_path / "b.mcap"], out, given_s={"b": -shift_ns * 1e-9})
    heard = [e for _, _, e in open_recording(out).events() if isinstance(e, RssReading)]
    first = [e for _, _, e in whole.events() if isinstance(e, RssReading)]
    assert sorted(map(repr, heard)) == sorted(map(repr, first))
    said = replay_one(out, Changes())
    assert said["identical"] is None and "merged" in said["verdict"]
    assert said["events"] > len(heard)


def test_followers_are_told_what_the_mission_told_its_recording(log: Path, tmp_path: Path) -> None:
    """Replayed into another recording: the same messages on every topic of ours, in the same order."""
    again = tmp_path / "again.mcap"
    with RecordingWriter(again) as writer:
        replay(log, followers=[writer])
    kinds = ("event", "command", "detection", "plan", "sources")
    first, second = (list(open_recording(path).items(*kinds)) for path in (log, again))
    assert len(second) >= len(first) - 1  # the mission's last look at its sources came after its last event
    for mine, its in zip(first, second, strict=False):
        assert (mine.kind, mine.inbox_number, mine.origin) == (its.kind, its.inbox_number, its.origin)
        assert repr(mine.value) == repr(its.value)


def test_the_page_wants_a_speed_and_one_recording(log: Path) -> None:
    done = CliRunner().invoke(build(), ["replay", str(log), "--page"])
    assert isinstance(done.exception, ConfigError)
