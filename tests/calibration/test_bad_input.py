"""Every malformed file is refused with file, line and remedy, exit code 2, and nothing is written."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration import study
from calibration.cli import app
from calibration.dataset import read_readings
from calibration.embedded import readings_csv
from calibration.fit import fit
from calibration.verdict import judge
from fieldkit.channel.model import Antenna
from fieldkit.errors import FieldkitError

HEADER = "place,distance_m,sample,rss_dbm\n"
ONE_VALUE = "all 90 readings are -50 dBm: the receiver repeats one value"
GEODETIC = "tx_lat_deg,tx_lon_deg,rx_lat_deg,rx_lon_deg,rss_dbm\n"


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def said(result) -> str:
    """What the command line prints for it; and that its exit code is 2."""
    if isinstance(result.exception, FieldkitError):
        assert result.exception.exit_code == 2
        return str(result.exception)
    assert result.exit_code == 2, result.output
    return result.output


def everything_written(folder: Path, given: str):
    return sorted(path.name for path in folder.iterdir() if path.name != given)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        pytest.param("", "is empty; expected a header line", id="empty"),
        pytest.param("\n\n", "is empty; expected a header line", id="blank"),
        pytest.param(HEADER, "has a header and no rows", id="header-only"),
        pytest.param(HEADER + "a,1,0,50\nb,2,1,61\n", "line 2: rss_dbm is 50: positive", id="sign"),
        pytest.param(
            HEADER + "a,1,0,-50\nb,2,1,61\nb,3,1,-63\n", "line 3: rss_dbm is 61, but neg", id="mixed-sign"
        ),
        pytest.param(HEADER + "a,1,0,-50\n" * 9 + "b,2,1,9999\n", "line 11: rss_dbm is 9999", id="sentinel"),
        pytest.param(HEADER + "a,1,0,-50\n" * 9 + "b,2,1,127\n", "line 11: rss_dbm is 127", id="127"),
        pytest.param(
            HEADER + "a,1,0,-50\nb,2,1,0\n", "line 3: rss_dbm is 0 (1 such rows): zero means", id="zero"
        ),
        pytest.param(HEADER + 'a,"1,5",0,-50\n', "line 2: distance_m is '1,5': a decimal comma", id="comma"),
        pytest.param(
            HEADER + 'a,1.5,0,"-50,5"\n', "line 2: rss_dbm is '-50,5': a decimal comma", id="comma-rss"
        ),
        pytest.param(HEADER + "a,1,5,0,-50\n", "line 2: 5 values under 4 column names", id="comma-split"),
        pytest.param(HEADER + "a,1,0,nan\n", "line 2: rss_dbm is 'nan'", id="nan"),
        pytest.param(HEADER + "a,inf,0,-50\n", "line 2: distance_m is 'inf'", id="inf"),
        pytest.param(HEADER + "a,1,0,-inf\n", "line 2: rss_dbm is '-inf'", id="minus-inf"),
        pytest.param(HEADER + "a,150cm,0,-50\n", "line 2: distance_m is '150cm': a unit", id="unit-in-cell"),
        pytest.param(
            HEADER + "a,1,0,-50 dBm\n", "line 2: rss_dbm is '-50 dBm': a unit", id="unit-in-reading"
        ),
        pytest.param(HEADER + "a,0,0,-50\n", "line 2: the distance is 0 m", id="distance-zero"),
        pytest.param(HEADER + "a,1,0,\n", "no packet was received", id="all-missed"),
        pytest.param(GEODETIC + "120,30,30,120,-50\n", "line 2: tx_lat_deg is 120", id="lat-lon"),
        pytest.param(
            GEODETIC + "48,11,48.001,11,-50\n48,11,0,0,-50\n", "line 3: rx_lat_deg and rx_lon", id="no-fix"
        ),
        pytest.param("distance_m,place\n1,a\n", "no column of readings", id="no-readings"),
        pytest.param("rss_dbm,place\n-50,a\n", "no distances", id="no-distances"),
        pytest.param(
            HEADER + "".join(f"p{i % 9},{1 + i % 9},{i},-50\n" for i in range(90)), ONE_VALUE, id="one"
        ),
    ],
)
@pytest.mark.parametrize("command", ["fit", "import"])
def test_a_malformed_file_is_refused_and_nothing_is_written(tmp_path, command, text, says):
    log = tmp_path / "r.csv"
    log.write_text(text)
    if command == "import" and says == ONE_VALUE:
        command = "fit"  # an import looks at rows, not at what they say together
    outputs = ["-o", tmp_path / "out"]
    outputs += ["--plot", tmp_path / "p.png", "--report", tmp_path / "p.html"] if command == "fit" else []
    message = said(invoke(command, log, *outputs))
    assert "r.csv" in message and says in message
    assert everything_written(tmp_path, "r.csv") == []


def test_a_million_identical_rows_are_refused(tmp_path):
    log = tmp_path / "r.csv"
    log.write_text("distance_m,rss_dbm\n" + "2.5,-60\n" * 1_000_000)
    message = said(invoke("fit", log, "-o", tmp_path / "a.toml"))
    assert "all 1000000 readings are -60 dBm" in message or "1000000 readings at 1 distances" in message
    assert everything_written(tmp_path, "r.csv") == []


def test_an_antenna_file_from_a_newer_schema_is_refused(tmp_path):
    antenna = tmp_path / "a.toml"
    antenna.write_text("schema = 7\n")
    message = said(invoke("check", antenna, tmp_path / "r.csv"))
    assert "a.toml: schema: 7 is newer" in message and "update fieldkit" in message


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("m.mcap", b"", "m.mcap"),
        ("m.mcap", b"not a recording at all", "m.mcap"),
        ("r.html", b"<html></html>", "carries no readings"),
        ("r.html", b'href="data:application/gzip;base64,AAAA"', "damaged"),
        ("r.html", b"\xff\xfe", "not a report of ours"),
    ],
)
def test_a_damaged_recording_or_report_is_refused(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    message = said(invoke("import", tmp_path / name, "-o", tmp_path / "out.csv", "--source", 0, 0))
    assert says in message
    assert everything_written(tmp_path, name) == []


QUIET = Antenna(2.5, -55.0, 3.0, -95.0)


def log_of(tmp_path, distance, keep=lambda readings: slice(None), seed=0, packets=20):
    readings = study.simulate(QUIET, np.asarray(distance, float), packets, np.random.default_rng(seed))
    log = tmp_path / "r.csv"
    log.write_text(readings_csv(readings.keep(np.arange(len(readings.rss_dbm))[keep(readings)])))
    return log


def swapped_log(tmp_path):
    rng = np.random.default_rng(2)
    lines = ["tx_east_m,tx_north_m,rx_east_m,rx_north_m,rss_dbm"]
    for east, north in rng.uniform(0, 20, (40, 2)):
        level = -50.0 - 25.0 * np.log10(np.hypot(east - 18.0, north - 3.0)) + rng.normal(0, 2)
        lines.append(f"18,3,{north:.2f},{east:.2f},{level:.0f}")
    log = tmp_path / "r.csv"
    log.write_text("\n".join(lines))
    return log


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda t: log_of(t, np.linspace(2.0, 3.0, 20)), "distances span a factor of 1.5 only"),
        (lambda t: log_of(t, np.geomspace(0.3, 8, 40), lambda r: r.rss_dbm > -70), "weak ones look cut off"),
        (lambda t: log_of(t, [2.0], packets=400), "cannot carry a fit"),
        (swapped_log, "east and north of the receiver are exchanged"),
    ],
    ids=["within-1.5", "above-70-kept", "one-place", "transposed"],
)
def test_what_cannot_carry_a_calibration_is_refused_and_nothing_is_written(tmp_path, make, says):
    log = make(tmp_path)
    outputs = ["-o", tmp_path / "a.toml", "--plot", tmp_path / "p.png", "--report", tmp_path / "p.html"]
    assert says in said(invoke("fit", log, *outputs))
    assert everything_written(tmp_path, log.name) == []


@pytest.mark.parametrize(
    ("factor", "says"),
    [(100.0, "centimetres"), (1000.0, "millimetres"), (1e-3, "kilometres")],
)
def test_mixed_units_are_named(tmp_path, factor, says):
    readings = study.simulate(QUIET, np.geomspace(0.5, 8.0, 30), 10, np.random.default_rng(1))
    odd = np.random.default_rng(2).random(30) < 0.4
    lines = [HEADER.strip()]
    for number, (place, distance, level) in enumerate(
        zip(readings.place, readings.distance_m, readings.rss_dbm, strict=True)
    ):
        lines.append(f"p{place},{distance * (factor if odd[place] else 1.0):.6f},{number},{level:g}")
    (tmp_path / "r.csv").write_text("\n".join(lines))
    message = said(invoke("fit", tmp_path / "r.csv", "-o", tmp_path / "a.toml"))
    assert f"are in {says}" in message
    assert everything_written(tmp_path, "r.csv") == []


def test_one_unit_is_not_taken_for_two():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        distance = np.concatenate([rng.uniform(0.2, 0.5, 12), rng.uniform(20, 60, 12)])
        for truth in (Antenna(2.5, -40.0, 3.0, -120.0), Antenna(1.8, -40.0, 5.0, -120.0)):
            readings = study.simulate(truth, distance, 10, rng, shadowing_db=4.0)
            assert "looks as if" not in " ".join(judge(fit(readings)).refusals), seed


def test_a_good_file_is_read_in_spite_of_a_byte_order_mark_and_windows_lines(tmp_path):
    log = tmp_path / "r.csv"
    log.write_bytes(("\ufeff" + HEADER + "a,1,0,-50\nb,2,1,-60\n").replace("\n", "\r\n").encode())
    assert read_readings(log).rss_dbm.tolist() == [-50.0, -60.0]
