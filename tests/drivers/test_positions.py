"""Position logs, logs of readings, and a survey from both."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
import typer
from benches import FRAME
from typer.testing import CliRunner

from drivers.positions import cli
from drivers.positions.readings import read_readings
from drivers.positions.source import open_file
from drivers.positions.survey import Settings, evaluate
from drivers.positions.table import instant_ns
from drivers.positions.tracks import read_track
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.clock import ScaledClock
from fieldkit.errors import ConfigError, DataError
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext
from fieldkit.testing import nothing_left
from fieldkit.world.channel import sample_rss_dbm

LOGS = Path(__file__).parents[3] / "shared" / "datasets" / "mavlink_logs"
logs = pytest.mark.skipif(not LOGS.is_dir(), reason="the recorded MAVLink logs are not here")

GPX = """<?xml version="1.0"?>
<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>
<trkpt lat="47.3977" lon="8.5456"><ele>400</ele><time>2026-01-02T03:04:05Z</time></trkpt>
<trkpt lat="47.3978" lon="8.5456"><time>2026-01-02T03:04:06.500Z</time></trkpt>
<trkpt lat="47.3979" lon="8.5456"></trkpt>
<trkpt lat="97.0" lon="8.5456"><time>2026-01-02T03:04:07Z</time></trkpt>
</trkseg></trk></gpx>"""


def written(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    return path


# Position logs


def test_gpx_points_have_place_and_time(tmp_path):
    track = read_track(written(tmp_path, "walk.gpx", GPX), "ada")
    assert [(spot.first, spot.robot) for spot in track.spots] == [(47.3977, "ada"), (47.3978, "ada")]
    assert track.spots[1].t_ns - track.spots[0].t_ns == 1_500_000_000
    assert track.spots[0].t_ns == 1_767_323_045_000_000_000
    assert track.skipped == 2  # no time; no such latitude


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<gpx><trk>", "not valid GPX"),
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><gpx/>", "document type"),
        ("<gpx/>", "no position"),
    ],
)
def test_gpx_that_cannot_be_read_is_named(tmp_path, text, words):
    with pytest.raises(DataError, match=words):
        read_track(written(tmp_path, "walk.gpx", text))


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("t_ns,lat_deg,lon_deg", "5000000000,47.3977,8.5456"),
        ("time_s,lat,lon", "5.0,47.3977,8.5456"),
        ("time,latitude,longitude", "1970-01-01T00:00:05,47.3977,8.5456"),
        ("TIME,Lat,Lng", "00:00:05,47.3977,8.5456"),
    ],
)
def test_csv_columns_are_found_by_their_names(tmp_path, head, row):
    (spot,) = read_track(written(tmp_path, "walk.csv", f"{head}\n{row}\n")).spots
    assert (spot.t_ns, spot.first, spot.second) == (5_000_000_000, 47.3977, 8.5456)


def test_times_without_a_date_go_on_after_midnight(tmp_path):
    rows = "23:59:59,1,1\n00:00:01,2,1\n"
    track = read_track(written(tmp_path, "walk.csv", "time,east_m,north_m\n" + rows))
    assert [spot.first for spot in track.spots] == [1.0, 2.0]
    assert track.spots[1].t_ns - track.spots[0].t_ns == 2_000_000_000


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.csv", "time_s,x\n1,2\n", "where"),
        ("a.csv", "lat,lon\n1,2\n", "when"),
        ("a.csv", "time_s,lat,lon\n", "expected a line"),
        ("a.csv", "time_s,lat,lon\n1,0,0\n2,north,3\n", "no position"),
        ("a.kml", "x", "expected one of"),
    ],
)
def test_a_position_log_that_cannot_be_used_is_named(tmp_path, name, text, words):
    with pytest.raises(DataError, match=words) as caught:
        read_track(written(tmp_path, name, text))
    assert name in str(caught.value)


def test_a_missing_log_is_named(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_track(tmp_path / "gone.csv")
    with pytest.raises(ConfigError, match="no such file"):
        open_file({"path": str(tmp_path / "gone.csv")}, DriverContext(ScaledClock(1.0), FRAME))


def test_an_instant_without_a_zone_is_utc():
    assert instant_ns("2026-01-02T03:04:05") == instant_ns("2026-01-02T04:04:05+01:00")
    assert instant_ns("soon") is None


@logs
def test_a_tlog_gives_the_vehicles_positions():
    """807 GLOBAL_POSITION_INT near -35.363, 149.165, per the log's description."""
    track = read_track(LOGS / "vtol.tlog")
    assert len(track.spots) + track.skipped == 807 and len(track.spots) > 780
    assert all(abs(spot.first + 35.363) < 0.1 and abs(spot.second - 149.165) < 0.1 for spot in track.spots)
    assert 200.0 < (track.spots[-1].t_ns - track.spots[0].t_ns) * 1e-9 < 216.0
    assert len({round(spot.heading_deg) for spot in track.spots}) > 10


@logs
@pytest.mark.parametrize(
    ("name", "lat_deg", "lon_deg"),
    [("pymavlink_test.BIN", -35.3626, 149.1653), ("methodic_backend_log_80k.bin", 52.4556, 10.5586)],
)
def test_a_cut_dataflash_log_gives_what_came_before(name, lat_deg, lon_deg):
    track = read_track(LOGS / name)
    assert track.spots
    assert all(abs(spot.first - lat_deg) < 1e-3 and abs(spot.second - lon_deg) < 1e-3 for spot in track.spots)


@logs
def test_reading_a_log_leaves_the_process_alone():
    before = dict(os.environ)
    read_track(LOGS / "vtol.tlog")
    read_track(LOGS / "pymavlink_test.BIN")
    assert dict(os.environ) == before


@logs
def test_a_log_without_positions_says_so():
    with pytest.raises(DataError, match="no position"):
        read_track(LOGS / "battery_status.tlog")


@pytest.mark.parametrize("ending", [".tlog", ".bin"])
def test_a_log_of_noise_says_so(tmp_path, ending):
    path = tmp_path / f"noise{ending}"
    path.write_bytes(np.random.default_rng(1).bytes(4000))
    with pytest.raises(DataError):
        read_track(path)


async def test_a_log_is_played_at_its_own_pace_with_its_own_times(tmp_path):
    path = written(tmp_path, "walk.gpx", GPX)
    clock = ScaledClock(10.0)
    frame = FieldFrame(47.3977, 8.5456)
    async with (
        nothing_left(),
        open_file({"path": str(path), "robot": "ada"}, DriverContext(clock, frame)) as source,
    ):
        began = clock.elapsed_s()
        poses = [pose async for pose in source.poses()]
        assert clock.elapsed_s() - began >= 1.4
    assert source.robots == ("ada",)
    assert [round(pose.north_m, 1) for pose in poses] == [0.0, 11.1]
    assert poses[0].t_ns == 1_767_323_045_000_000_000 and poses[0].origin == "file"


# Logs of readings


def test_readings_are_read_and_silence_is_left_out(tmp_path):
    rows = "1,-70,A/1\n2,,A/2\n3,-71.5,A/3\n4,20,A/4\n"
    heard = read_readings(written(tmp_path, "r.csv", "time_s,rss_dbm,frame_id\n" + rows), "ada")
    assert [(item.rss_dbm, item.frame_id, item.robot) for item in heard] == [
        (-70.0, "A/1", "ada"),
        (-71.5, "A/3", "ada"),
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,loudness\n1,-70\n", "rss_dbm"),
        ("time_s,rss_dbm\n1,\n", "no reading"),
        ("time_s,rss_dbm\n1,70\n2,71\n", "no received power"),
    ],
)
def test_readings_that_cannot_be_used_are_named(tmp_path, text, words):
    with pytest.raises(DataError, match=words):
        read_readings(written(tmp_path, "r.csv", text))


def test_a_capture_is_a_log_of_readings(tmp_path):
    from drivers.emulators.capture import classic_head, classic_record, tap_packet

    path = tmp_path / "c.pcap"
    path.write_bytes(classic_head() + classic_record(5_000_000_000, tap_packet(-66.0, b"\x41\x88\x01")))
    (reading,) = read_readings(path)
    assert (reading.rss_dbm, reading.t_ns) == (-66.0, 5_000_000_000)


# The survey

ANTENNA = Antenna(2.0, -45.0, 3.0, -92.0)
SOURCE = (31.0, 22.0)


def walk(tmp_path, seed=3, geodetic=True):
    """A walk in lanes over 60 x 40 m, and what a radio heard of a transmitter that sends every 2 s."""
    rng = np.random.default_rng(seed)
    frame = FieldFrame(47.3977, 8.5456)
    places, readings, t_s = ["time_s,lat_deg,lon_deg" if geodetic else "time_s,east_m,north_m"], [], 0.0
    readings.append("time_s,rss_dbm")
    for lane, north in enumerate(range(0, 41, 8)):
        for step in range(61):
            east = step if lane % 2 == 0 else 60 - step
            lat, lon, _ = frame.to_geodetic(east, north)
            places.append(f"{t_s},{lat:.8f},{lon:.8f}" if geodetic else f"{t_s},{east},{north}")
            if round(t_s) % 2 == 0:
                away = np.array([math.hypot(east - SOURCE[0], north - SOURCE[1])])
                rss_dbm = float(sample_rss_dbm(ANTENNA, away, 0.0, rng)[0])
                if math.isfinite(rss_dbm):
                    readings.append(f"{t_s + 0.2},{rss_dbm:.0f}")
            t_s += 1.0
    antenna = tmp_path / "antenna.toml"
    antenna.write_text(dump_antenna(AntennaFile(ANTENNA)))
    return (
        written(tmp_path, "readings.csv", "\n".join(readings)),
        written(tmp_path, "walk.csv", "\n".join(places)),
        antenna,
    )


def test_a_walk_with_a_radio_finds_the_transmitter(tmp_path):
    readings, positions, antenna = walk(tmp_path)
    app = typer.Typer()
    app.command()(cli.survey)
    arguments = [str(readings), str(positions), "--antenna", str(antenna), "--rate-hz", "0.5"]
    arguments += ["--cell-m", "2", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--geojson", str(tmp_path / "found.geojson")])
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    best = max(told["candidates"], key=lambda each: each["receptions"])
    assert math.hypot(best["east_m"] - SOURCE[0], best["north_m"] - SOURCE[1]) < 2.0
    assert told["readings_without_place"] == 0 and best["state"] == "found"
    features = json.loads((tmp_path / "found.geojson").read_text())["features"]
    kinds = [feature["geometry"]["type"] for feature in features]
    assert kinds.count("Point") == len(told["candidates"]) and "LineString" in kinds
    lon, lat = features[0]["geometry"]["coordinates"]
    assert abs(lat - 47.3979) < 1e-3 and abs(lon - 8.546) < 1e-3


def test_metres_do_as_well_as_degrees(tmp_path):
    readings, positions, _ = walk(tmp_path, geodetic=False)
    result = evaluate(
        read_readings(readings), read_track(positions), Settings(ANTENNA, rate_hz=0.5, cell_m=2.0)
    )
    best = max(result.sources, key=lambda each: each.receptions)
    assert math.hypot(best.east_m - SOURCE[0], best.north_m - SOURCE[1]) < 2.0 and result.frame is None


def test_clocks_that_disagree_are_told_and_can_be_shifted(tmp_path):
    readings, positions, _ = walk(tmp_path)
    late = [line.split(",") for line in readings.read_text().splitlines()[1:]]
    text = "time_s,rss_dbm\n" + "\n".join(f"{float(t_s) + 7200},{rss}" for t_s, rss in late)
    heard, track = read_readings(written(tmp_path, "late.csv", text)), read_track(positions)
    with pytest.raises(DataError, match="--shift-s"):
        evaluate(heard, track, Settings(ANTENNA))
    assert evaluate(heard, track, Settings(ANTENNA, shift_s=-7200.0, cell_m=4.0)).detections > 20


def test_readings_of_another_robot_are_told(tmp_path):
    _, positions, _ = walk(tmp_path)
    heard = read_readings(written(tmp_path, "r.csv", "time_s,rss_dbm,robot\n5,-70,bob\n"))
    with pytest.raises(DataError, match="bob"):
        evaluate(heard, read_track(positions), Settings(ANTENNA))
