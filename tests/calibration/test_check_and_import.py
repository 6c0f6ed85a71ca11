"""Checking a calibration on new readings; readings out of other logs."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration import study
from calibration.check import check
from calibration.cli import app
from calibration.dataset import read_readings
from fieldkit.antenna.file import AntennaFile
from fieldkit.antenna.model import Antenna
from fieldkit.errors import ConfigError
from fieldkit.messages import Detection
from fieldkit.recording import RecordingWriter

EXAMPLE = Path(__file__).parents[2] / "examples" / "readings.csv"
ANTENNA = Antenna(2.5, -55.0, 3.0, -75.0)
runner = CliRunner()


def readings(truth, seed=0, **more):
    return study.simulate(truth, np.geomspace(0.4, 5.0, 25), 20, np.random.default_rng(seed), **more)


def test_the_same_radio_still_holds():
    said = check(AntennaFile(ANTENNA), readings(ANTENNA))
    assert said.state == "holds" and abs(said.offset_db) < 0.5


def test_a_weak_battery_is_drift():
    said = check(AntennaFile(ANTENNA), readings(replace(ANTENNA, power_at_1m_dbm=-60.0)))
    assert said.state == "drifted" and said.offset_db == pytest.approx(-5.0, abs=0.6)
    assert "weaker" in said.reasons[0]


def test_a_place_full_of_reflections_spreads_more():
    said = check(AntennaFile(ANTENNA), readings(ANTENNA, shadowing_db=6.0))
    assert any("spread" in reason for reason in said.reasons)


def test_two_places_are_too_few_to_tell():
    data = readings(ANTENNA)
    assert check(AntennaFile(ANTENNA), data.keep(data.place < 2)).state == "too few readings"


def test_the_command_checks_what_fit_wrote(tmp_path):
    out = tmp_path / "antenna.toml"
    assert runner.invoke(app, ["fit", str(EXAMPLE), "-o", str(out)]).exit_code == 0
    result = runner.invoke(app, ["check", str(out), str(EXAMPLE), "--json"])
    assert result.exit_code == 0 and json.loads(result.stdout)["state"] == "holds"


def test_a_table_under_other_names_is_imported(tmp_path):
    (tmp_path / "in.csv").write_text("dist;level;junk\n1;-50;x\n2;;y\n")
    out = tmp_path / "out.csv"
    arguments = ["import", str(tmp_path / "in.csv"), "-o", str(out)]
    result = runner.invoke(app, [*arguments, "--column", "distance_m=dist", "--column", "rss_dbm=level"])
    assert result.exit_code == 0, result.output
    assert out.read_text() == "rss_dbm,distance_m\n-50,1\n,2\n"


def test_a_mission_with_a_known_transmitter_is_imported(tmp_path):
    log, out = tmp_path / "m.mcap", tmp_path / "out.csv"
    with RecordingWriter(log) as writer:
        for number in range(3):
            places = np.array([[0.0, 0.0], [3.0, 4.0]])
            heard = np.array([-50.0, np.nan])
            detection = Detection(number, ("r1", "r2"), places, np.zeros(2), heard, np.zeros(2, bool))
            writer.detection(number, number, detection)
    assert runner.invoke(app, ["import", str(log), "-o", str(out), "--source", "0", "1"]).exit_code == 0
    data = read_readings(out)
    np.testing.assert_allclose(data.distance_m, [1.0, np.hypot(3, 3)] * 3, atol=1e-4)
    assert data.missed.tolist() == [False, True] * 3
    assert data.heading_deg[0] == 0.0 and data.heading_deg[1] == pytest.approx(225.0)


def test_an_import_that_cannot_be_read_back_leaves_no_file(tmp_path):
    (tmp_path / "in.csv").write_text("distance_m,rss_dbm\n1,loud\n")
    out = tmp_path / "out.csv"
    assert runner.invoke(app, ["import", str(tmp_path / "in.csv"), "-o", str(out)]).exit_code != 0
    assert not out.exists()


def test_a_recording_needs_the_transmitters_position(tmp_path):
    result = runner.invoke(app, ["import", str(tmp_path / "m.mcap"), "-o", str(tmp_path / "o.csv")])
    assert isinstance(result.exception, ConfigError)
