"""Tables and exports: the same numbers, read back by other programs; nothing half-written."""

import csv
import json
from pathlib import Path
from xml.etree import ElementTree

import duckdb
import numpy as np
import pytest

import fieldkit
from fieldkit.errors import ConfigError, DataError, RecordingError
from fieldkit.extras import need
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, RssReading
from fieldkit.recording import RecordingWriter, open_recording
from fieldkit.recording.export import export

from .samples import detection, estimate, mission

FIELD = "schema = 1\n[field]\norigin_lat_deg = 48.0\norigin_lon_deg = 11.0\nsize_east_m = 10.0\nsize_north_m = 10.0\n"


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "mission.mcap"
    frame = FieldFrame(48.0, 11.0)
    with RecordingWriter(path, mission_toml=FIELD, frame=frame) as writer:
        for number, event in enumerate(mission(3)):
            writer.event(number, event.t_ns, event)
        writer.detection(number, event.t_ns, detection())
        writer.sources(number, event.t_ns, [estimate()])
        writer.belief(number, event.t_ns, np.arange(12.0).reshape(3, 4) / 66.0, cell_m=0.5)
    return fieldkit.open_log(path)


def recorded(log, kind):
    return [event for _, _, event in open_recording(log.path).events() if isinstance(event, kind)]


def test_tables_hold_what_was_recorded(log):
    poses, readings = recorded(log, Pose), recorded(log, RssReading)
    assert log.poses["east_m"].tolist() == [pose.east_m for pose in poses]
    assert log.poses["robot"].tolist() == [pose.robot for pose in poses]
    assert log.readings["rss_dbm"].tolist() == [reading.rss_dbm for reading in readings]
    assert log.readings["t_ns"].tolist() == [reading.t_ns for reading in readings]
    assert log.readings["channel"].tolist() == [15] * len(readings)


def test_readings_stand_where_their_robot_was(log):
    at = {(pose.robot, pose.t_ns): pose for pose in recorded(log, Pose)}
    for row in log.readings:
        pose = at[row["robot"], row["t_ns"] - 5]
        assert row["east_m"] == pytest.approx(pose.east_m, abs=1e-6)
        assert row["north_m"] == pytest.approx(pose.north_m, abs=1e-6)


def test_the_belief_is_found_by_time_and_by_place(log):
    last_s = log.span_s[1]
    assert log.belief_at(last_s).values[2, 3] == pytest.approx(11 / 66, rel=1e-6)
    with pytest.raises(RecordingError, match="no belief"):
        log.belief_at(-1.0)
    cells = log.table("belief")
    corner = cells[(cells["east_m"] == 1.75) & (cells["north_m"] == 1.25)]
    assert corner["p"] == pytest.approx(11 / 66, rel=1e-6)


def test_csv_reads_back_as_the_same_numbers(log, tmp_path):
    (path,) = export(log, tmp_path / "poses.csv", ("poses",))
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["north_m"]) for row in rows] == log.poses["north_m"].tolist()
    (path,) = export(log, tmp_path / "detections.csv", ("detections",))
    assert [row["rss_dbm"] for row in csv.DictReader(path.open())] == ["-61.0", ""]


def test_parquet_is_read_by_another_program(log, tmp_path):
    (path,) = export(log, tmp_path / "readings.parquet", ("readings",))
    ((mean, count),) = duckdb.sql(f"select avg(rss_dbm), count(*) from '{path}'").fetchall()
    assert (mean, count) == (pytest.approx(log.readings["rss_dbm"].mean()), len(log.readings))


def test_a_folder_gets_every_table_that_has_rows(log, tmp_path):
    names = {path.name for path in export(log, tmp_path / "all", form="csv")}
    assert names == {"readings.csv", "poses.csv", "detections.csv", "sources.csv"}


def test_maps_put_everything_where_it_was(log, tmp_path):
    frame = log.frame
    what = ("poses", "readings", "sources", "belief")
    (path,) = export(log, tmp_path / "m.geojson", what)
    features = json.loads(path.read_text())["features"]
    kinds = {feature["properties"]["kind"] for feature in features}
    assert kinds == {"track", "reading", "source", "source region", "belief"}
    source = next(f for f in features if f["properties"]["kind"] == "source")
    lon, lat = source["geometry"]["coordinates"]
    assert frame.to_local(lat, lon)[:2] == pytest.approx((2.0, 3.0), abs=1e-3)
    track = next(f for f in features if f["properties"]["kind"] == "track")
    assert len(track["geometry"]["coordinates"]) == len(track["properties"]["coordTimes"]) == 30
    (path,) = export(log, tmp_path / "m.kml", what)
    root = ElementTree.fromstring(path.read_text())
    assert len(root.findall(".//{*}Placemark")) == len(features)
    (path,) = export(log, tmp_path / "m.gpx", what)
    root = ElementTree.fromstring(path.read_text())
    points = root.findall(".//{*}trkpt")
    assert len(points) == len(log.poses)
    first = frame.to_local(float(points[0].get("lat")), float(points[0].get("lon")))
    assert first[:2] == pytest.approx((log.poses["east_m"][0], log.poses["north_m"][0]), abs=2e-3)
    assert points[1].find("{*}time").text > points[0].find("{*}time").text


@pytest.mark.parametrize("name", ["m.gpx", "m.csv"])
def test_our_own_exports_come_in_again(log, tmp_path, name):
    from fieldkit import plugins

    what = ("poses",) if name.endswith("csv") else ("poses", "sources")
    (path,) = export(log, tmp_path / name, what)
    track = plugins.load("fieldkit.tracks", "file")(path)
    assert len(track.spots) == len(log.poses)


def test_a_time_range_keeps_what_is_in_it(log, tmp_path):
    (path,) = export(log, tmp_path / "poses.csv", ("poses",), from_s=1.0, to_s=2.0)
    times = [float(row["t_s"]) for row in csv.DictReader(path.open())]
    assert min(times) >= 1.0 and max(times) <= 2.0 and len(times) == 20


def nothing_new(folder: Path) -> bool:
    return {path.name for path in folder.iterdir()} == {"mission.mcap"}


@pytest.mark.parametrize(
    ("out", "what", "options", "error", "says"),
    [
        ("p.csv", ("poses",), {"from_s": 100.0}, DataError, "the log goes from"),
        ("p.csv", ("poses",), {"from_s": 2.0, "to_s": 1.0}, DataError, "from 2 s is later than to 1 s"),
        ("p.xls", ("poses",), {}, ConfigError, "csv, parquet, geojson"),
        ("p.csv", ("poses", "readings"), {}, ConfigError, "one table"),
        ("p.csv", ("pose",), {}, ConfigError, "tables are"),
        ("p.kml", ("notes",), {}, ConfigError, "on a map"),
        ("p.csv", ("notes",), {}, RecordingError, "holds no notes"),
        ("all", ("poses", "notes"), {"form": "csv"}, RecordingError, "holds no notes"),
    ],
)
def test_bad_requests_are_refused_and_leave_nothing(log, tmp_path, out, what, options, error, says):
    with pytest.raises(error, match=says):
        export(log, tmp_path / out, what, **options)
    assert nothing_new(tmp_path)


def test_an_export_without_readings_says_what_there_is(tmp_path):
    path = tmp_path / "mission.mcap"
    with RecordingWriter(path, mission_toml=FIELD) as writer:
        writer.event(1, 5, Pose(5, "r1", 1.0, 2.0))
    with pytest.raises(RecordingError, match="holds no readings; it holds 1 on /in/pose"):
        export(fieldkit.open_log(path), tmp_path / "readings.csv", ("readings",))
    assert nothing_new(tmp_path)


def test_a_package_that_is_not_installed_is_named_with_its_extra():
    with pytest.raises(ConfigError, match=r"needs nosuchthing.*pip install 'spog-fieldkit\[post\]'"):
        need("nosuchthing.inner", "post")
