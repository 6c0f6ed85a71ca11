"""`fieldkit log`."""

import json

import pytest
from typer.testing import CliRunner

from fieldkit.errors import RecordingError
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
