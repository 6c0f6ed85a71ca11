"""Readings files: what is read, and what is said about those that cannot be."""

import numpy as np
import pytest

from calibration.dataset import read_readings
from fieldkit.errors import DataError

GOOD = "place,distance_m,sample,rss_dbm\n"


def read(tmp_path, text, **options):
    path = tmp_path / "r.csv"
    path.write_text(text)
    return read_readings(path, **options)


def test_an_empty_reading_is_a_missed_packet(tmp_path):
    readings = read(tmp_path, GOOD + "a,1,0,-50\nb,2,1,\n")
    assert readings.missed.tolist() == [False, True]
    assert readings.places == ("a", "b")


def test_positions_give_distances(tmp_path):
    readings = read(tmp_path, "tx_east_m,tx_north_m,rx_east_m,rx_north_m,rssi\n0,0,3,4,-50\n")
    assert readings.distance_m.tolist() == [5.0]


def test_latitude_and_longitude_give_distances(tmp_path):
    text = "tx_lat_deg,tx_lon_deg,rx_lat_deg,rx_lon_deg,rss_dbm\n0,0,0,0.001,-90\n"
    # One thousandth of a degree of the equator: 6378137 m * pi / 180000.
    assert read(tmp_path, text).distance_m[0] == pytest.approx(111.319, abs=0.01)


def test_a_column_map_reads_another_logs_names(tmp_path):
    readings = read(
        tmp_path, "d;level\n1;50\n2;61\n", names={"distance_m": "d", "rss_dbm": "level"}, negate=True
    )
    assert readings.rss_dbm.tolist() == [-50.0, -61.0]


def test_where_keeps_some_rows(tmp_path):
    readings = read(tmp_path, "room,distance_m,rss_dbm\na,1,-50\nb,2,-60\n", where={"room": "b"})
    assert readings.distance_m.tolist() == [2.0]


def test_rows_given_twice_are_used_once_and_reported(tmp_path):
    readings = read(tmp_path, GOOD + "a,1,0,-50\na,1,0,-50\na,1,1,-50\n")
    assert len(readings.rss_dbm) == 2
    assert "given twice" in readings.warnings[0]


def test_places_that_are_copies_are_reported(tmp_path):
    rng = np.random.default_rng(0)
    levels = rng.integers(-70, -50, 20)
    text = GOOD + "".join(f"{p},{d},{i},{z}\n" for p, d in (("a", 1), ("b", 2)) for i, z in enumerate(levels))
    assert "places a and b carry the same" in read(tmp_path, text).warnings[0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        (GOOD, "no rows"),
        ("a,b\n1,2\n", "no column of readings"),
        ("place,rss_dbm\na,-50\n", "no distances"),
        (GOOD + "a,1,0,-50\na,x,1,-51\n", "line 3: distance_m is 'x'"),
        (GOOD + "a,1,0,-50\na,,1,-51\n", "line 3: distance_m is empty"),
        (GOOD + "a,0,0,-50\n", "line 2: the distance is 0 m"),
        (GOOD + "a,1,0,nan\n", "line 2: rss_dbm is 'nan'"),
        (GOOD + "a,inf,0,-50\n", "line 2: distance_m is 'inf'"),
        (GOOD + 'a,"1,5",0,-50\n', "decimal comma"),
        (GOOD + "a,1,5,0,-50\n", "5 values under 4"),
        ("place;distance_m;rss_dbm\na;1,5;-50\n", "decimal comma"),
        (GOOD + "a,1,0,50\nb,2,0,60\n", "--negate"),
        (GOOD + "a,1,0,-50\nb,2,0,-61\nb,2,1,9999\n", "line 4: rss_dbm is 9999"),
        (GOOD + "a,1,0,-50\nb,2,0,0\n", "zero means"),
        (GOOD + "a,1,0,-50\nb,2,0,-255\n", "weaker than any receiver"),
        (GOOD + "a,1,0,\n", "no packet was received"),
        ("tx_lat_deg,tx_lon_deg,rx_lat_deg,rx_lon_deg,rss_dbm\n120,30,30,120,-50\n", "look swapped"),
    ],
)
def test_bad_files_are_refused_with_line_and_remedy(tmp_path, text, says):
    with pytest.raises(DataError, match=r"r\.csv") as caught:
        read(tmp_path, text)
    assert says in str(caught.value)


def test_a_missing_or_binary_file_is_refused(tmp_path):
    with pytest.raises(DataError, match="no such file"):
        read_readings(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(DataError, match="not a text table"):
        read_readings(tmp_path / "b.csv")
