"""A recording of an earlier fieldkit replays bit for bit, or is refused with the version that can."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fieldkit.errors import RecordingError, ReplayMismatch
from fieldkit.recording.reader import open_recording
from fieldkit.recording.rewrite import rewrite
from mission.core.defaults import TABLES, filled_in, left_open
from mission.core.mission_file import parse_mission
from mission.lab.synthetic import record_simulated
from mission.replay.replay import recorded_mission, replay, what_if

Header = dict[str, Any]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mission whose file says that places have no noise of their own: not today's default."""
    folder = tmp_path_factory.mktemp("old")
    return record_simulated(folder, seed=3, duration_s=60.0, engine={"place_noise": False})


def edited(log: Path, to: Path, edit: Callable[[Header], Header]) -> Path:
    rewrite(log, to, edit_header=edit)
    return to


def of_older_defaults(header: Header) -> Header:
    """As a fieldkit would have written it whose default was what this mission says."""
    text = header["mission_toml"].replace("place_noise = false\n", "")
    assert "place_noise" not in text
    defaults = header["metadata"]["defaults"]
    defaults = defaults | {"engine": defaults["engine"] | {"place_noise": False}}
    return header | {"mission_toml": text, "metadata": header["metadata"] | {"defaults": defaults}}


def test_a_recording_keeps_what_its_mission_file_left_open(log: Path) -> None:
    recording = open_recording(log)
    assert recording.metadata["defaults"] == left_open(parse_mission(recording.mission_toml, "x"))
    said = {key for table in recording.metadata["defaults"].values() for key in table}
    assert "max_leg_m" in said and "place_noise" not in said and "planner" not in said


def test_with_other_defaults_it_replays_bit_for_bit(log: Path, tmp_path: Path) -> None:
    old = edited(log, tmp_path / "old.mcap", of_older_defaults)
    done, result = replay(old), open_recording(old).result()
    assert done.complete and done.compared == done.events and result is not None
    assert done.kernel.digest() == result["belief_hash"]


def test_without_its_defaults_it_is_refused_with_what_made_it(log: Path, tmp_path: Path) -> None:
    def without(header: Header) -> Header:
        header = of_older_defaults(header)
        bare = {key: value for key, value in header["metadata"].items() if key != "defaults"}
        return header | {"metadata": bare, "software": header["software"] | {"fieldkit": "0.0.9"}}

    old = edited(log, tmp_path / "older.mcap", without)
    with pytest.raises(
        ReplayMismatch, match=r"event \d+ .*fieldkit 0\.0\.9 .*fieldkit 0\.0\.9 can replay it"
    ):
        replay(old)


def test_a_replay_that_differs_names_the_version_that_can(log: Path, tmp_path: Path) -> None:
    old = edited(log, tmp_path / "x.mcap", lambda h: h | {"software": h["software"] | {"fieldkit": "0.0.9"}})
    assert replay(old).complete, "another version alone is no difference"
    with pytest.raises(ReplayMismatch, match=r"fieldkit 0\.0\.9 can replay it"):
        replay(old, mission=what_if(recorded_mission(open_recording(old)), planner="patrol"))


@pytest.mark.parametrize(("schema", "words"), [(0, "older than this fieldkit reads"), (2, "newer than this")])
def test_another_schema_is_refused_with_the_version_that_wrote_it(
    log: Path, tmp_path: Path, schema: int, words: str
) -> None:
    old = edited(log, tmp_path / "s.mcap", lambda h: h | {"schema": schema, "fieldkit": "0.0.9"})
    with pytest.raises(RecordingError, match=rf"schema {schema} is {words}.*written by fieldkit 0\.0\.9"):
        open_recording(old)


@pytest.mark.parametrize("where", ["defaults", "mission_toml"])
def test_a_key_that_is_gone_is_refused_with_the_version_that_had_it(
    log: Path, tmp_path: Path, where: str
) -> None:
    def edit(header: Header) -> Header:
        if where == "mission_toml":
            text = header["mission_toml"].replace("[engine]", '[engine]\nsixth_sense = "on"', 1)
            return header | {"mission_toml": text, "fieldkit": "0.0.9"}
        defaults = header["metadata"]["defaults"] | {"engine": {"sixth_sense": "on"}}
        return header | {"metadata": header["metadata"] | {"defaults": defaults}, "fieldkit": "0.0.9"}

    old = edited(log, tmp_path / "k.mcap", edit)
    with pytest.raises(
        RecordingError, match=r"(?s)sixth_sense: no such key.*fieldkit 0\.0\.9, which made it"
    ):
        replay(old)


def test_a_file_that_says_everything_leaves_nothing_open(log: Path) -> None:
    text = open_recording(log).mission_toml
    again = filled_in(text, left_open(parse_mission(text, "x")))
    estimated = f"turn_radius_m = {parse_mission(text, 'x').turn_radius_m}\n"
    assert again.replace(estimated, "") == text, (
        "today's defaults change nothing, and what is estimated is said"
    )
    other = {"safety": {"max_leg_m": 7.0}, "end": {"periods_without_find": 9}}
    file = parse_mission(filled_in(text, other), "x")
    assert file.safety.max_leg_m == 7.0 and file.end.periods_without_find == 9
    assert "max_leg_m" not in left_open(file)["safety"]


def test_a_recording_from_before_turns_were_known_has_robots_that_turn_on_the_spot(
    log: Path, tmp_path: Path
) -> None:
    def edit(header: Header) -> Header:
        defaults = header["metadata"]["defaults"]
        safety = {key: value for key, value in defaults["safety"].items() if key != "turn_radius_m"}
        return header | {"metadata": header["metadata"] | {"defaults": defaults | {"safety": safety}}}

    old = edited(log, tmp_path / "before.mcap", edit)
    assert recorded_mission(open_recording(old)).safety.turn_radius_m == 0.0
    assert recorded_mission(open_recording(log)).safety.turn_radius_m > 0.0


def test_what_is_left_open_is_plain(log: Path) -> None:
    opened = recorded_mission(open_recording(log)).recorded_settings["defaults"]
    assert json.loads(json.dumps(opened, allow_nan=False)) == opened and set(opened) == set(TABLES)
