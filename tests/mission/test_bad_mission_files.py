"""What a mission file must not say: refused by `check` with file, key, what was expected and what was there."""

import itertools
import os
from pathlib import Path

import pytest

from fieldkit.channel.antenna_file import read_antenna
from fieldkit.errors import ConfigError
from mission.core.mission_file import parse_mission, read_mission
from mission.core.template import TemplateRobot, mission_text

TEXT = mission_text(size_m=25.0)


def parsed(*changes: tuple[str, str]) -> None:
    text = TEXT
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    parse_mission(text, "m.toml")


FIELD = "size_north_m = 25.0"
SAFETY = "max_speed_m_s = 0.4"


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (FIELD, f"{FIELD}\nkeep_out = [[[1.0, 1.0], [nan, 2.0], [2.0, 2.0]]]", "field.keep_out"),
        (
            FIELD,
            f"{FIELD}\nkeep_out = [[[47.3977, 8.5456], [47.3978, 8.5456], [47.3978, 8.5458]]]",
            "expected metres .* got degrees",
        ),
        (
            FIELD,
            f"{FIELD}\nkeep_out = [[[200.0, 1.0], [201.0, 1.0], [201.0, 2.0]]]",
            "wholly outside the field",
        ),
        (
            FIELD,
            f"{FIELD}\nfence = [[1.0, 1.0], [20.0, 20.0], [20.0, 1.0], [1.0, 20.0]]",
            "fence: its sides cross",
        ),
        (FIELD, f"{FIELD}\nfence = [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]]", "fence: "),
        (
            FIELD,
            f"{FIELD}\nkeep_out = [[[-1.0, -1.0], [26.0, -1.0], [26.0, 26.0], [-1.0, 26.0]]]",
            "whole field",
        ),
        ("fence_margin_m = 0.5", "fence_margin_m = 500.0", "leaves no ground"),
        (SAFETY, "max_speed_m_s = inf", "safety.max_speed_m_s"),
        (SAFETY, "max_speed_m_s = 4000.0", "safety.max_speed_m_s: .* 50"),
        ("pose_timeout_s = 2.0", "pose_timeout_s = inf", "safety.pose_timeout_s"),
        ("overrun_s = 3.0", "overrun_s = 1e9", "safety.overrun_s"),
        ("min_separation_m = 1.0", "min_separation_m = 0.0", "safety.min_separation_m"),
        ("min_separation_m = 1.0", "min_separation_m = 1e6", "safety.min_separation_m"),
        ("min_separation_m = 1.0", "min_separation_m = 100.0", "less than the field's 25 m"),
        (SAFETY, "max_speed_m_s = 1e-9", "safety.max_speed_m_s: .* 0.01"),
        (SAFETY, f"{SAFETY}\nturn_radius_m = nan", "safety.turn_radius_m"),
        (SAFETY, f"{SAFETY}\nturn_radius_m = 26.0", "safety.turn_radius_m: .* less than the field's 25 m"),
        (SAFETY, f"{SAFETY}\nbraking_m = 500.0", "safety.braking_m: .* less than the field's 25 m, got 500"),
        ("[engine]", "[engine]\narrive_m = 1000.0", "engine.arrive_m: .* less than the field's 25 m"),
        ("power_levels_db = [-8.0", "power_levels_db = [nan", "sources.power_levels_db"),
        ("power_levels_db = [-8.0", "power_levels_db = [-600.0", "sources.power_levels_db"),
        ("seed = 0", "seed = -1", "seed"),
        ("cell_m = 0.5", 'cell_m = "0.5"', "field.cell_m: .* got '0.5'"),
        ("schema = 1", "schema = true", "schema"),
        ("found_probability = 0.9", "found_probability = true", "engine.found_probability"),
        ('name = "r1"', 'name = "all"', "robot.0: name"),
        ('name = "r1"', 'name = "r/1"', "robot.0: name"),
        ('name = "r1"', f'name = "{"x" * 200}"', "robot.0.name"),
    ],
)
def test_it_is_refused_with_file_key_and_reason(old: str, new: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as refusal:
        parsed((old, new))
    assert str(refusal.value).startswith("m.toml: ")
    assert "{" not in str(refusal.value), "no table is poured out in an error"


@pytest.mark.parametrize("value", ["[" * 5_000 + "]" * 5_000, "9" * 5_000, "9" * 400])
def test_what_no_parser_takes_is_refused_in_few_words(value: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        parse_mission(f"schema = {value}", "m.toml")
    assert str(refusal.value).startswith("m.toml: ") and len(str(refusal.value)) < 200


@pytest.mark.parametrize("value", ["[" * 5_000 + "]" * 5_000, "9" * 5_000, "9" * 400, "true"])
def test_an_antenna_file_is_refused_in_few_words_too(value: str, tmp_path: Path) -> None:
    (tmp_path / "antenna.toml").write_text(f"schema = {value}")
    with pytest.raises(ConfigError, match=r"antenna\.toml: ") as refusal:
        read_antenna(tmp_path / "antenna.toml")
    assert len(str(refusal.value)) < 200 + len(str(tmp_path))


def test_the_template_itself_is_good() -> None:
    parsed()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_an_antenna_file_that_is_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "antenna.toml")
    (tmp_path / "mission.toml").write_text(TEXT)
    with pytest.raises(ConfigError, match="expected an antenna file, got a pipe"):
        read_mission(tmp_path / "mission.toml")


def test_an_antenna_file_that_is_a_folder_is_said(tmp_path: Path) -> None:
    (tmp_path / "antenna.toml").mkdir()
    (tmp_path / "mission.toml").write_text(TEXT)
    with pytest.raises(ConfigError, match=r"antenna\.toml"):
        read_mission(tmp_path / "mission.toml")


def test_a_byte_order_mark_is_no_fault(tmp_path: Path) -> None:
    (tmp_path / "mission.toml").write_text("\ufeff" + TEXT, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"antenna\.toml: no such antenna file"):
        read_mission(tmp_path / "mission.toml")


def test_robots_that_fly_get_heights_of_their_own() -> None:
    text = TEXT
    for number in (1, 2, 3):
        text = text.replace(f'name = "r{number}"', f'name = "r{number}"\nflies = true', 1)
    text = text.replace('name = "r2"\nflies = true', 'name = "r2"\naltitude_m = 11.0', 1)
    heights = parse_mission(text, "m.toml").altitudes_m()
    assert heights.keys() == {"r1", "r2", "r3"} and heights["r2"] == 11.0
    ordered = sorted(heights.values())
    assert min(b - a for a, b in itertools.pairwise(ordered)) >= 3.0


def test_of_a_robot_that_is_refused_nothing_more_is_said_than_why() -> None:
    text = mission_text(robots=[TemplateRobot("", "/dev/ttyUSB0", "udpin:0.0.0.0:14550", 1)])
    with pytest.raises(ConfigError) as refused:
        parse_mission(text, "m.toml")
    (line,) = str(refused.value).splitlines()
    assert line.startswith("m.toml: robot.0.name: "), line
