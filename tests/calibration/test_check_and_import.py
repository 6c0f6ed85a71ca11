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
from calibration.fit import fit
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.channel.pattern import lobe_gain_db
from fieldkit.errors import DataError, FieldkitError
from fieldkit.messages import Detection, Pose
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


def mission_log(path, *, metadata=None, late_s=0.0, seed=0):
    """A rover with a second radio drives lanes past a transmitter at (5, 5); returns the recording's path."""
    rng = np.random.default_rng(seed)
    truth = Antenna(2.5, -55.0, 2.0, -90.0)

    def place(t):
        lane, along = divmod(t, 20.0)
        return np.array([0.5 * along if lane % 2 == 0 else 10.0 - 0.5 * along, 1.0 * lane])

    with RecordingWriter(path, metadata=metadata) as writer:
        for number in range(220):
            t_s = 1000.0 + number
            writer.event(number, round(t_s * 1e9), Pose(round(t_s * 1e9), "r1", *place(float(number))))
        for number in range(200):
            truly = place(float(number) + late_s)
            level = truth.mean_rss_dbm(np.hypot(*(truly - 5.0))) + rng.normal(0, 2.0)
            heard = np.array([np.round(level), -50.0])
            at = np.array([place(float(number)), [5.0, 6.0]])
            t_ns = round((1000.0 + number) * 1e9)
            detection = Detection(t_ns, ("r1", "base"), at, np.zeros(2), heard, np.zeros(2, bool))
            writer.detection(220 + number, t_ns, detection)
    return path


def invoke(*arguments):
    return runner.invoke(app, [str(argument) for argument in arguments])


def test_a_recording_that_knows_its_transmitter_needs_no_option(tmp_path):
    log = mission_log(tmp_path / "m.mcap", metadata={"truth": [{"east_m": 5.0, "north_m": 5.0}]})
    result = invoke("import", log, "-o", tmp_path / "r.csv")
    assert result.exit_code == 0, result.output
    assert "clock looks" not in result.output
    assert read_readings(tmp_path / "r.csv").n_places > 50


@pytest.mark.parametrize(
    ("metadata", "says"),
    [
        (None, "--source EAST NORTH"),
        ({"truth": [{"east_m": 1.0, "north_m": 2.0}] * 2}, "had 2 transmitters"),
        ({"truth": ["somewhere"]}, "--source EAST NORTH"),
    ],
)
def test_a_recording_needs_the_transmitters_position(tmp_path, metadata, says):
    log = mission_log(tmp_path / "m.mcap", metadata=metadata)
    result = invoke("import", log, "-o", tmp_path / "r.csv")
    assert isinstance(result.exception, FieldkitError) and says in str(result.exception)
    assert result.exception.exit_code == 2 and not (tmp_path / "r.csv").exists()


def test_a_receivers_clock_that_is_late_is_found_and_corrected(tmp_path):
    log, out = mission_log(tmp_path / "m.mcap", late_s=4.0), tmp_path / "r.csv"
    found = invoke("import", log, "-o", out, "--source", 5, 5)
    assert "clock looks" in found.output and "behind" in found.output
    offset = float(found.output.split("--clock-offset-s ")[1].split(",")[0])
    assert offset == pytest.approx(4.0, abs=0.5)
    before = read_readings(out)
    again = invoke("import", log, "-o", out, "--source", 5, 5, "--clock-offset-s", offset)
    assert again.exit_code == 0 and "clock looks" not in again.output
    mobile = {"where": {"receiver": "r1"}}
    assert fit(read_readings(out, **mobile)).antenna.sigma_db < 2.6
    assert fit(before.keep(before.receiver == before.receivers.index("r1"))).antenna.sigma_db > 3.0


def test_packets_that_one_robot_alone_heard_are_a_warning(tmp_path):
    log = tmp_path / "m.mcap"
    with RecordingWriter(log) as writer:
        for number in range(20):
            places = np.array([[0.0, 0.1 * number], [3.0, 4.0]])
            detection = Detection(
                number, ("r1", "r2"), places, np.zeros(2), np.array([-50.0, np.nan]), np.zeros(2, bool)
            )
            writer.detection(number, number, detection)
    result = invoke("import", log, "-o", tmp_path / "r.csv", "--source", 0, 9)
    assert "heard by one robot alone" in result.output


def test_a_calibration_is_checked_on_a_recording(tmp_path):
    log, antenna = mission_log(tmp_path / "m.mcap"), tmp_path / "a.toml"
    for power, state, code in ((-55.0, "holds", 0), (-49.0, "drifted", 1)):
        antenna.write_text(dump_antenna(AntennaFile(Antenna(2.5, power, 3.0, -90.0))))
        result = invoke("check", antenna, log, "--source", 5, 5, "--json")
        assert (json.loads(result.stdout)["state"], result.exit_code) == (state, code), result.output


def test_a_report_carries_its_readings(tmp_path):
    page, out = tmp_path / "report.html", tmp_path / "r.csv"
    assert invoke("fit", EXAMPLE, "--report", page).exit_code == 0
    assert invoke("import", page, "-o", out).exit_code == 0
    ours, theirs = fit(read_readings(EXAMPLE)).antenna, fit(read_readings(out)).antenna
    assert theirs.path_loss_exponent == pytest.approx(ours.path_loss_exponent, abs=1e-4)
    assert theirs.power_at_1m_dbm == pytest.approx(ours.power_at_1m_dbm, abs=1e-3)
    assert theirs.threshold_dbm == ours.threshold_dbm


def test_a_missions_report_is_imported_by_the_recording_beside_it(tmp_path):
    mission_log(tmp_path / "mission.mcap", metadata={"truth": [{"east_m": 5.0, "north_m": 5.0}]})
    (tmp_path / "report.html").write_text("<html>a mission</html>")
    result = invoke("import", tmp_path / "report.html", "-o", tmp_path / "r.csv")
    assert result.exit_code == 0 and "400 readings" in result.output


def test_a_directional_antenna_is_checked_by_its_pattern(tmp_path):
    heading = np.tile(np.arange(0.0, 360.0, 30.0), 5)[readings(ANTENNA).place % 60]
    lobe = {"front_deg": 0.0, "narrowness": 1.0, "floor_db": 10.0, "offset_db": 0.0}
    turned = replace(readings(ANTENNA), heading_deg=heading)
    turned = replace(turned, rss_dbm=np.round(turned.rss_dbm + lobe_gain_db(heading, **lobe)))
    table = {"heading_deg": [0.0, 1.0, 2.0, 3.0], "gain_db": [0.0] * 4, "parameters": lobe}
    file = AntennaFile(ANTENNA, model="lobe", pattern=table)
    assert abs(check(file, turned).offset_db) < 1.0
    assert check(AntennaFile(ANTENNA), turned).state == "drifted"
    with pytest.raises(DataError, match="heading_deg"):
        check(file, readings(ANTENNA))


def position_logs(tmp_path, shift_s=0.0, zone_s=0.0):
    """Readings without positions, and a position log of the same walk past a transmitter at (5, 5)."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 300.0, 1.0)
    walk = np.column_stack([5.0 + 6.0 * np.sin(t / 17.0), 5.0 + 4.0 * np.sin(t / 23.0 + 1.0)])
    levels = np.round(-55.0 - 25.0 * np.log10(np.hypot(*(walk - 5.0).T)) + rng.normal(0, 2, len(t)))
    log, track = tmp_path / "log.csv", tmp_path / "track.csv"
    stamps = t - shift_s - zone_s + 50_000.0
    log.write_text("time,rssi\n" + "".join(f"{a:.1f},{z:g}\n" for a, z in zip(stamps, levels, strict=True)))
    rows = zip(t + 50_000.0, *walk.T, strict=True)
    track.write_text("time,east_m,north_m\n" + "".join(f"{a:.1f},{e:.3f},{n:.3f}\n" for a, e, n in rows))
    return "import", log, "--positions", track, "-o", tmp_path / "r.csv", "--source", 5, 5


def test_positions_are_looked_up_in_another_log(tmp_path):
    result = invoke(*position_logs(tmp_path))
    assert result.exit_code == 0 and "clock looks" not in result.output, result.output
    assert fit(read_readings(tmp_path / "r.csv")).antenna.path_loss_exponent == pytest.approx(2.5, abs=0.3)


def test_a_clock_offset_between_two_logs_is_estimated(tmp_path):
    result = invoke(*position_logs(tmp_path, shift_s=6.0))
    assert float(result.output.split("--clock-offset-s ")[1].split(",")[0]) == pytest.approx(6.0, abs=0.5)
    # The positions that were looked up wrongly are noticed in the file they went into, too.
    assert any("clock looks" in text for text in read_readings(tmp_path / "r.csv").warnings)


def test_a_time_zone_between_two_logs_is_named(tmp_path):
    arguments = position_logs(tmp_path, zone_s=7200.0)
    result = invoke(*arguments)
    assert isinstance(result.exception, DataError) and "--clock-offset-s 7200" in str(result.exception)
    assert not (tmp_path / "r.csv").exists()
    assert invoke(*arguments, "--clock-offset-s", 7200).exit_code == 0


def test_a_position_log_whose_clock_was_set_is_refused_with_the_line(tmp_path):
    arguments = position_logs(tmp_path)
    track = tmp_path / "track.csv"
    track.write_text(track.read_text() + "50001,0,0\n")
    result = invoke(*arguments)
    assert "track.csv, line 302: time runs backwards" in str(result.exception)
