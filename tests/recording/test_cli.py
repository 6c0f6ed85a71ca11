"""`fieldkit log`."""

import json

import pytest
from typer.testing import CliRunner

from fieldkit.errors import DataError, RecordingError
from fieldkit.recording import reader
from fieldkit.recording.cli import app

runner = CliRunner()


def test_info_counts_topics_and_time(recorded):
    said = json.loads(runner.invoke(app, ["info", str(recorded), "--json"]).stdout)
    assert said["complete"] and said["missing"] == ""
    assert said["counts"]["/in/tick"] == 30
    assert said["duration_s"] == pytest.approx(2.9, abs=0.01)


def test_info_says_what_a_cut_file_lacks(recorded):
    recorded.write_bytes(recorded.read_bytes()[:-200])
    assert "NOT complete" in runner.invoke(app, ["info", str(recorded)]).stdout


def test_the_index_says_the_same_as_a_walk_through_the_file(recorded):
    assert reader._indexed(recorded) == reader._counted(recorded)


def test_recover_writes_a_file_that_info_calls_complete(tmp_path, recorded):
    recorded.write_bytes(recorded.read_bytes()[:-4000])
    out = tmp_path / "out.mcap"
    assert runner.invoke(app, ["recover", str(recorded), "-o", str(out)]).exit_code == 0
    assert json.loads(runner.invoke(app, ["info", str(out), "--json"]).stdout)["complete"]


def test_a_bad_file_is_an_error_of_ours(tmp_path):
    result = runner.invoke(app, ["info", str(tmp_path / "none.mcap")])
    assert isinstance(result.exception, RecordingError)


def test_list_names_recordings_once_and_says_what_is_none(recorded, tmp_path):
    (tmp_path / "deep").mkdir()
    other = tmp_path / "deep" / "other.mcap"
    other.write_bytes(recorded.read_bytes())
    other.with_name("other.2.mcap").write_bytes(b"")
    done = runner.invoke(app, ["list", str(tmp_path), "--json"])
    said = json.loads(done.stdout)
    assert done.exit_code == 0 and [row["recording"] for row in said["recordings"]] == [
        str(other),
        str(recorded),
    ]
    (tmp_path / "bad.mcap").write_text("no")
    done = runner.invoke(app, ["list", str(tmp_path)])
    assert done.exit_code == 2 and "bad.mcap: is not an MCAP" in done.stderr


def test_merge_and_redact_say_what_they_did(recorded, tmp_path):
    done = runner.invoke(app, ["redact", str(recorded), "-o", str(tmp_path / "out.mcap"), "--json"])
    assert done.exit_code == 0 and json.loads(done.stdout)["addresses"] > 0
    done = runner.invoke(app, ["merge", str(recorded), str(recorded), "-o", str(tmp_path / "all.mcap")])
    assert isinstance(done.exception, DataError) and not (tmp_path / "all.mcap").exists()


def test_the_layout_is_written(tmp_path):
    assert runner.invoke(app, ["layout", "-o", str(tmp_path / "l.json")]).exit_code == 0
    assert "configById" in json.loads((tmp_path / "l.json").read_text())
