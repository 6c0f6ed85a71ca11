"""Belief and planner take their numbers from one place; a mission may set them anew, and a recording keeps them."""

from dataclasses import fields, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError, RecordingError
from fieldkit.recording.reader import open_recording
from fieldkit.tuning import InfogainTuning, Tuning
from mission.core.mission_file import parse_mission
from mission.core.template import mission_text
from mission.lab.synthetic import record_simulated
from mission.replay.replay import recorded_mission, replay, what_if

KEYS = [(table.name, each) for table in fields(Tuning) for each in fields(getattr(Tuning(), table.name))]


def test_every_number_has_a_unit_bounds_a_meaning_and_a_source() -> None:
    assert len(KEYS) >= 60
    for _, each in KEYS:
        quantity = each.metadata["quantity"]
        assert quantity.low <= quantity.default <= quantity.high
        assert quantity.meaning
        assert each.metadata["source"]


def test_the_manual_lists_every_number_as_it_is() -> None:
    page = (Path(__file__).parents[1] / "docs" / "tuning.md").read_text(encoding="utf-8")
    for table, each in KEYS:
        default = each.default
        shown = ", ".join(f"{one:g}" for one in default) if isinstance(default, tuple) else f"{default:g}"
        unit, meaning = each.metadata["quantity"].unit, each.metadata["quantity"].meaning
        assert (
            f"| `{table}.{each.name}` | {shown} | {unit} | {meaning} | {each.metadata['source']} |" in page
        ), "python docs/tuning_page.py"


def test_tables_come_back_as_they_were_written() -> None:
    assert Tuning().with_tables(Tuning().tables()) == Tuning()
    changed = Tuning().with_tables({"infogain": {"spacings": [0.5, 1.0], "samples": 8}})
    assert changed.infogain == replace(InfogainTuning(), spacings=(0.5, 1.0), samples=8)
    assert Tuning().with_tables(changed.tables()) == changed


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ({"engine": {}}, "tuning.engine: no such table; expected one of likelihood, intensity"),
        ({"intensity": {"odds": 1.0}}, "tuning.intensity.odds: no such key; expected one of rate_shape"),
        ({"intensity": {"max_open": 7.5}}, "tuning.intensity.max_open: expected a whole number, got 7.5"),
        (
            {"intensity": {"max_open": 3}},
            "tuning.intensity.max_open: expected a number from 20 to 100000, got 3",
        ),
        (
            {"intensity": {"birth_odds": float("nan")}},
            "birth_odds: expected a number from 0.1 to 100, got nan",
        ),
        ({"intensity": {"birth_odds": "many"}}, "birth_odds: expected a number, got 'many'"),
        ({"intensity": {"birth_odds": True}}, "birth_odds: expected a number, got True"),
        ({"infogain": {"spacings": []}}, "spacings: expected numbers, got []"),
        ({"infogain": {"spacings": [0.0]}}, "spacings: expected a number from 0.01 to 10, got 0.0"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_key(tables: dict[str, dict[str, object]], says: str) -> None:
    with pytest.raises(ValueError) as refused:
        Tuning().with_tables(tables)
    assert says in str(refused.value)
    text = mission_text() + "\n" + toml_of(tables)
    with pytest.raises(ConfigError, match=r"m\.toml: tuning: tuning"):
        parse_mission(text, "m.toml")


def toml_of(tables: dict[str, dict[str, object]]) -> str:
    def value(one: object) -> str:
        return str(one).lower() if isinstance(one, bool) else repr(one).replace("'", '"')

    return "\n".join(
        f"[tuning.{table}]\n" + "\n".join(f"{key} = {value(one)}" for key, one in keys.items())
        for table, keys in tables.items()
    )


@given(
    st.dictionaries(
        st.sampled_from([f"{table}.{each.name}" for table, each in KEYS]), st.floats(), max_size=4
    )
)
def test_any_number_is_taken_within_its_bounds_or_refused_by_name(values: dict[str, float]) -> None:
    for name, value in values.items():
        table, key = name.split(".")
        each = next(each for own, each in KEYS if (own, each.name) == (table, key))
        quantity = each.metadata["quantity"]
        whole = not isinstance(each.default, int) or value == value // 1
        try:
            Tuning().with_tables({table: {key: value}})
        except ValueError as error:
            assert f"tuning.{name}: expected" in str(error)
            assert not (quantity.low <= value <= quantity.high and whole)
        else:
            assert quantity.low <= value <= quantity.high


def test_engine_settings_carry_the_tuning_of_their_mission(tmp_path: Path) -> None:
    log = record_simulated(tmp_path, seed=3, duration_s=60.0)
    recording = open_recording(log)
    assert recording.metadata["tuning"] == Tuning().tables()
    mission = what_if(recorded_mission(recording), changes=["tuning.intensity.birth_odds=2.5"])
    assert isinstance(mission.kernel.engine, EngineSettings)
    assert mission.kernel.engine.tuning.intensity.birth_odds == 2.5
    assert replay(log).compared > 0


def test_a_recording_replays_with_its_own_numbers_or_is_refused_by_the_version_that_can(
    tmp_path: Path,
) -> None:
    recording = open_recording(record_simulated(tmp_path, seed=3, duration_s=30.0))
    recording.metadata["tuning"]["infogain"]["horizon_s"] = 33.0
    assert recorded_mission(recording).kernel.engine.tuning.infogain.horizon_s == 33.0
    recording.metadata["tuning"]["infogain"]["foresight_s"] = 33.0
    with pytest.raises(RecordingError, match=r"foresight_s: no such key.*fieldkit .* can replay it"):
        recorded_mission(recording)
