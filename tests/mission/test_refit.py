"""Many missions as one: the same as a replay where there is one, more than each where there are several."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldkit
from fieldkit.cli import build
from fieldkit.errors import DataError
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.sources import TransientSource
from mission.analysis.refit import Refitted, refit
from mission.analysis.refit_ground import common_ground
from mission.core.mission_file import Mission, read_mission
from mission.lab.synthetic import small_mission
from mission.replay.command import Changes
from mission.replay.replay import replay

HIDDEN = (TransientSource(3.0, 7.5, 0.0, 0.1), TransientSource(8.0, 2.5, 0.0, 0.1))
DAY_NS = 24 * 3600 * 10**9


def later(log: Path, out: Path, by_ns: int) -> Path:
    """The same mission on another day."""
    recording = open_recording(log)
    with RecordingWriter(
        out, mission_toml=recording.mission_toml, antenna_toml=recording.antenna_toml, start_ns=by_ns
    ) as writer:
        for number, _, event in recording.events():
            writer.event(number, event.t_ns + by_ns, replace(event, t_ns=event.t_ns + by_ns))
    return out


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two short missions in one field, a day apart."""
    folder = tmp_path_factory.mktemp("campaign")
    mission = small_mission(folder, duration_s=240.0)
    for seed in (1, 2):
        fieldkit.simulate(mission, HIDDEN, seed=seed, recording=folder / f"{seed}.mcap")
    return [folder / "1.mcap", later(folder / "2.mcap", folder / "later.mcap", DAY_NS)]


@pytest.fixture(scope="module")
def both(logs: list[Path]) -> Refitted:
    return refit(logs, Changes())


def test_of_one_recording_it_is_the_belief_of_its_replay(logs: list[Path]) -> None:
    done = refit(logs[:1], Changes())
    flown = replay(logs[0]).kernel
    mine, theirs = (
        sorted((s.east_m, s.north_m) for s in its.sources() if s.state == "found") for its in (done, flown)
    )
    # What is heard in a mission's last moment stands in its recording, and nobody thinks about it any more.
    assert 0 <= done.detections - flown.detections <= 1
    assert np.array(mine) == pytest.approx(np.array(theirs), abs=0.1)


def test_together_they_know_where_the_sources_are(both: Refitted) -> None:
    assert both.sessions == 2 and both.detections > 40, "one source sends 24 times in either"
    places = np.array([(s.east_m, s.north_m) for s in both.sources() if s.state == "found"])
    for source in HIDDEN:
        assert np.hypot(*(places - (source.east_m, source.north_m)).T).min() < 1.0
    assert len(places) == len(HIDDEN)


def test_simulated_missions_are_not_heard_at_the_same_time(logs: list[Path], both: Refitted) -> None:
    """All begin at nought: as one session, robots of either would have heard nothing of what the other's heard."""
    undated = refit([logs[0], logs[1].parent / "2.mcap"], Changes())
    assert undated.sessions == 2 and undated.detections == both.detections
    mine, dated = (
        sorted((s.east_m, s.north_m) for s in its.sources() if s.state == "found") for its in (undated, both)
    )
    assert np.array(mine) == pytest.approx(np.array(dated), abs=0.05)


def test_the_order_in_which_they_are_named_changes_nothing(logs: list[Path], both: Refitted) -> None:
    assert refit(logs[::-1], Changes()).belief_hash == both.belief_hash


def moved(folder: Path, north_m: float) -> Mission:
    mission = small_mission(folder)
    lat_deg, lon_deg, _ = mission.frame.to_geodetic(0.0, north_m)
    text = mission.text.replace(
        f"origin_lat_deg = {mission.frame.origin_lat_deg}", f"origin_lat_deg = {lat_deg:.9f}"
    ).replace(f"origin_lon_deg = {mission.frame.origin_lon_deg}", f"origin_lon_deg = {lon_deg:.9f}")
    (folder / "mission.toml").write_text(text)
    return read_mission(folder / "mission.toml")


def test_fields_side_by_side_make_one_ground(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first, second = small_mission(tmp_path / "a"), moved(tmp_path / "b", -7.0)
    frame, grid = common_ground([first, second])
    size = first.file.field.size_north_m
    assert grid.size_north_m == pytest.approx(size + 7.0, abs=0.02)
    assert grid.size_east_m == pytest.approx(first.file.field.size_east_m, abs=0.02)
    assert frame.to_local(*first.frame.to_geodetic(0.0, 0.0))[1] == pytest.approx(7.0, abs=0.02)


def test_places_far_apart_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with pytest.raises(DataError, match="nothing in common"):
        common_ground([small_mission(tmp_path / "a"), moved(tmp_path / "b", 50_000.0)])


def test_the_command_names_what_it_cannot_read_and_goes_on(logs: list[Path], tmp_path: Path) -> None:
    (tmp_path / "no.mcap").write_text("nothing")
    out = tmp_path / "all.geojson"
    result = CliRunner().invoke(build(), ["refit", str(logs[0]), str(tmp_path / "no.mcap"), "-o", str(out)])
    assert result.exit_code == 2 and "no.mcap" in result.output
    assert "1 recording in 1 session," in result.output
    assert '"Polygon"' in out.read_text()
    result = CliRunner().invoke(build(), ["refit", str(tmp_path / "no.mcap")])
    assert isinstance(result.exception, DataError)
