"""Odd logs and what a survey says of them."""

from pathlib import Path

import numpy as np
import pytest

from drivers.positions.readings import read_readings
from drivers.positions.sanity import looked_at
from drivers.positions.survey import Settings, as_geojson, evaluate
from drivers.positions.table import number, read_table, timed
from drivers.positions.tracks import Spot, Track, read_track
from fieldkit.channel.antenna_file import read_antenna, spread_of
from fieldkit.errors import DataError
from fieldkit.messages import Pose, RssReading

CASES = Path(__file__).parents[3] / "shared" / "cases" / "survey"
cases = pytest.mark.skipif(not CASES.is_dir(), reason="the odd logs are not here")


def surveyed(readings, positions, antenna, **changes):
    file = read_antenna(CASES / f"{antenna}.toml")
    settings = Settings(file.antenna, spread=spread_of(file), **changes)
    return evaluate(read_readings(CASES / readings), read_track(CASES / positions), settings)


@cases
@pytest.mark.parametrize("positions", ["p_glitch.csv", "p_comma.csv"])
def test_one_bad_fix_and_decimal_commas_do_not_move_the_source(positions):
    result = surveyed("r.csv", positions, "antenna")
    (source,) = result.sources
    assert np.hypot(source.east_m - 180.0, source.north_m - 120.0) < 5.0
    assert any("111195 m off" in note for note in result.notes) == (positions == "p_glitch.csv")
    features = as_geojson(result, read_track(CASES / positions))["features"]
    assert [each["geometry"]["type"] for each in features] == ["Point", "MultiPolygon", "LineString"]


@cases
def test_a_date_in_a_column_of_its_own_is_read():
    result = surveyed("d2_r.csv", "d2_p.csv", "antenna")
    assert len(result.sources) == 1 and result.duration_s > 86_400.0 and result.without_place == 0


@cases
def test_equal_readings_are_one_wide_source():
    (source,) = surveyed("eq_r.csv", "eq_p.csv", "ant_wide").sources
    assert source.state == "candidate" and np.sqrt(np.trace(source.cov_m2)) > 5.0


@cases
def test_a_drone_knows_that_it_flies():
    result = surveyed("up_r.csv", "up_p.csv", "ant30")
    (found,) = result.found
    assert found.posterior.holds(np.array([70.0, 45.0]), 0.9)


@cases
def test_an_hour_between_clocks_that_still_overlap_is_told():
    result = surveyed("r.csv", "p_comma.csv", "antenna", shift_s=3600.0)
    assert any("-3600 s later" in note and "--shift-s" in note for note in result.notes)
    assert not any("clocks" in note for note in surveyed("r.csv", "p_comma.csv", "antenna").notes)


# Tables


def written(tmp_path, text, name="t.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "t_ns"),
    [
        ("time,rss_dbm\n1767225600,-70\n", 1_767_225_600_000_000_000),
        ("time,rss_dbm\n1767225600000,-70\n", 1_767_225_600_000_000_000),
        ("time;rss_dbm\n5,25;-70,5\n", 5_250_000_000),
        ("date,time,rss_dbm\n2026-01-01,00:00:05,-70\n", 1_767_225_605_000_000_000),
        ("date,time,rss_dbm\n01.01.2026,00:00:05,-70\n", 1_767_225_605_000_000_000),
    ],
)
def test_times_are_read_as_they_come(tmp_path, text, t_ns):
    ((_, found, _),) = timed(read_table(written(tmp_path, text)))
    assert found == t_ns


@pytest.mark.parametrize(
    ("text", "value"),
    [("5.2 W", -5.2), ("5.2 E", 5.2), ("47,5", None), ("-70 dBm", -70.0), ("12 m", 12.0), ("nan", None)],
)
def test_cells_may_carry_hemisphere_and_unit(text, value):
    assert number({"lon_deg": text}, "lon_deg") == value


def test_a_hemisphere_in_its_own_column_signs_the_number():
    assert number({"lon_deg": "5.2", "east_west": "W"}, "lon_deg") == -5.2


def test_rejected_and_repeated_rows_are_counted_and_named(tmp_path):
    text = "time_s,rssi\n1,-70\n1,-70\n2,loud\n3,-72 dBm\n4,-73\n"
    notes: list[str] = []
    heard = read_readings(written(tmp_path, text), notes=notes)
    assert [item.rss_dbm for item in heard] == [-70.0, -72.0, -73.0]
    assert "1 rows left out: line 4" in notes[0] and "1 rows repeat" in notes[1]


def test_relative_levels_are_taken_where_the_user_says_so(tmp_path):
    path = written(tmp_path, "time_s,rss_dbm\n1,12.5\n2,-171\n")
    assert [item.rss_dbm for item in read_readings(path, relative=True)] == [12.5, -171.0]
    with pytest.raises(DataError, match="--relative"):
        read_readings(path)


# Sanity of positions


def track(points, geodetic=True):
    spots = [Spot(k * 1_000_000_000, "radio", lat, lon) for k, (lat, lon) in enumerate(points)]
    return Track(Path("p.csv"), geodetic, spots)


def test_a_frozen_fix_is_named_and_its_readings_have_no_place():
    points = [(52.0 + k * 1e-5, 5.0) for k in range(60)] + [(52.0006, 5.0)] * 90
    found = looked_at(track(points))
    assert len(found.spots) == 61 and any("froze" in note for note in found.notes)


def test_standing_still_in_metres_is_not_frozen():
    assert len(looked_at(track([(1.0, 2.0)] * 200, geodetic=False)).spots) == 200


def test_a_jump_is_told():
    points = [(52.0 + k * 1e-5, 5.0) for k in range(40)] + [(52.1 + k * 1e-5, 5.0) for k in range(40)]
    assert any("jump by 11" in note for note in looked_at(track(points)).notes)


def test_a_height_missing_in_one_row_leaves_the_row_out(tmp_path):
    path = written(tmp_path, "time_s,east_m,north_m,up_m\n0,0,0,40\n1,1,0,\n2,2,0,40\n")
    found = read_track(path)
    assert [spot.up_m for spot in found.spots] == [40.0, 40.0] and "no height" in found.notes[0]


# Known senders


def two_senders():
    poses = [Pose(k * 1_000_000_000, "radio", float(k % 40), 4.0 * (k // 40)) for k in range(400)]
    readings = []
    for k in range(0, 400, 4):
        for name, east, north in (("A", 8.0, 10.0), ("B", 30.0, 28.0)):
            away = max(0.5, float(np.hypot(k % 40 - east, 4.0 * (k // 40) - north)))
            level = round(-40.0 - 25.0 * np.log10(away))
            readings.append(
                RssReading(
                    k * 1_000_000_000 + (name == "B"), "radio", float(level), "sim", None, f"{name}/{k}"
                )
            )
    return readings, poses


def test_known_senders_are_one_source_each(tmp_path):
    from fieldkit.channel.model import Antenna

    readings, poses = two_senders()
    spots = [Spot(pose.t_ns, "radio", pose.east_m, pose.north_m, 0.0, 0.0, 0.05) for pose in poses]
    settings = Settings(Antenna(2.5, -40.0, 4.0, -95.0), identity=True, window_s=1e-6)
    result = evaluate(list(readings), Track(Path("p.csv"), False, spots), settings)
    assert {found.name for found in result.found} == {"A", "B"}
    for found in result.found:
        truth = (8.0, 10.0) if found.name == "A" else (30.0, 28.0)
        assert np.hypot(found.estimate.east_m - truth[0], found.estimate.north_m - truth[1]) < 3.0


def test_identity_without_names_is_refused(tmp_path):
    from fieldkit.channel.model import Antenna

    readings = [RssReading(k * 1_000_000_000, "radio", -60.0) for k in range(10)]
    spots = [Spot(k * 1_000_000_000, "radio", float(k), 0.0) for k in range(10)]
    with pytest.raises(DataError, match="no reading carries a name"):
        evaluate(
            list(readings),
            Track(Path("p.csv"), False, spots),
            Settings(Antenna(2.5, -40.0, 4.0, -95.0), identity=True),
        )
