"""A recording replays bit for bit, whole or cut; any change is named by the event that shows it first."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from fieldkit.channel.antenna_file import read_antenna
from fieldkit.cli import build
from fieldkit.errors import RecordingError, ReplayMismatch
from fieldkit.recording.reader import open_recording
from fieldkit.recording.rewrite import rewrite
from mission.lab.synthetic import record_simulated
from mission.replay.replay import Replayed, recorded_mission, replay, what_if


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_simulated(tmp_path_factory.mktemp("log"), seed=2, duration_s=120.0)


@pytest.fixture(scope="module")
def whole(log: Path) -> Replayed:
    return replay(log)


def test_a_whole_recording_gives_the_same_belief_and_commands(log: Path, whole: Replayed) -> None:
    done = whole
    result = open_recording(log).result()
    assert result is not None
    assert done.complete
    assert done.kernel.digest() == result["belief_hash"]
    assert done.kernel.commands_digest() == result["commands_hash"]
    assert done.kernel.detections > 0


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8])
def test_a_cut_recording_replays_as_far_as_it_goes(
    log: Path, whole: Replayed, tmp_path: Path, share: float
) -> None:
    cut = tmp_path / "cut.mcap"
    data = log.read_bytes()
    cut.write_bytes(data[: int(share * len(data))])
    done = replay(cut)
    assert not done.complete and done.missing
    assert 0 < done.events < whole.events


@pytest.mark.parametrize("options", [[], ["--speed", "1000", "--page"], ["--what-if"]])
def test_what_a_cut_recording_misses_is_said_once(
    log: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, options: list[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    data = log.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    done = CliRunner().invoke(build(), ["replay", str(cut), "--until", "3", *options])
    said = caplog.text + done.output
    assert done.exit_code == 0, said
    assert said.count("cut, or still being written") == 1, said


def test_another_antenna_is_noticed_and_the_event_named(log: Path, tmp_path: Path) -> None:
    text = (log.parent / "antenna.toml").read_text().replace("sigma_db = 3.3", "sigma_db = 4.3")
    other = tmp_path / "antenna.toml"
    other.write_text(text)
    mission = recorded_mission(open_recording(log), read_antenna(other), text)
    with pytest.raises(ReplayMismatch, match=r"event \d+ \(Tick"):
        replay(log, mission=mission)


def test_another_engine_is_a_what_if(log: Path, whole: Replayed) -> None:
    mission = what_if(recorded_mission(open_recording(log)), belief="spog", planner="prwa")
    done = replay(log, mission=mission, check=False)
    assert done.kernel.detections == whole.kernel.detections


def test_until_stops_early(log: Path) -> None:
    assert replay(log, until_s=50.0).duration_s <= 50.0


def test_what_is_no_recording_says_so(tmp_path: Path) -> None:
    path = tmp_path / "notes.mcap"
    path.write_text("not a recording")
    with pytest.raises(RecordingError, match=r"notes\.mcap"):
        replay(path)


def test_a_difference_says_what_the_recording_was_made_with(log: Path, tmp_path: Path) -> None:
    made = tmp_path / "made.mcap"
    rewrite(
        log, made, edit_header=lambda header: header | {"software": header["software"] | {"numpy": "0.1"}}
    )
    assert replay(made).complete
    mission = what_if(recorded_mission(open_recording(made)), planner="patrol")
    with pytest.raises(ReplayMismatch, match=r"recorded with numpy 0\.1 \(here"):
        replay(made, mission=mission)
