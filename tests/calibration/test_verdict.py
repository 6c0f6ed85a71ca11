"""Calibrations that must be refused are, with the reason and the remedy."""

import numpy as np
import pytest

from calibration import study
from calibration.dataset import from_arrays, read_readings
from calibration.fit import Options, fit
from calibration.verdict import judge
from fieldkit.channel.model import Antenna
from fieldkit.errors import CalibrationRefused

QUIET = Antenna(2.5, -55.0, 3.0, -95.0)


def simulated(distance, seed=0, packets=20, truth=QUIET, **more):
    return study.simulate(truth, np.asarray(distance, float), packets, np.random.default_rng(seed), **more)


def refusals(readings, options=None) -> str:
    return " / ".join(judge(fit(readings, options)).refusals)


def test_a_good_set_is_accepted():
    readings = simulated(np.geomspace(0.2, 12.0, 40), truth=Antenna(2.5, -55.0, 3.0, -72.0))
    assert judge(fit(readings)).state == "accepted"


def test_distances_within_a_factor_of_one_and_a_half_are_refused():
    assert "exponent is not identified" in refusals(simulated(np.linspace(2.0, 3.0, 12)))


def test_one_place_is_refused():
    with pytest.raises(CalibrationRefused, match="1 distances"):
        fit(simulated([2.0], packets=400))


def test_four_places_are_refused():
    assert "4 places" in refusals(simulated([0.5, 1.0, 2.0, 8.0], packets=100))


def test_only_readings_above_a_level_kept_is_refused():
    for seed in range(5):
        whole = simulated(np.geomspace(0.3, 8.0, 40), seed=seed)
        assert "look cut off" in refusals(whole.keep(whole.rss_dbm > -70.0)), seed


def test_missed_packets_dropped_from_the_file_are_noticed():
    for seed in range(5):
        whole = simulated(np.geomspace(0.2, 4.0, 40), seed=seed, truth=Antenna(2.53, -62.0, 3.3, -70.0))
        assert "look cut off" in refusals(whole.keep(~whole.missed)), seed


def test_a_file_with_nothing_missed_is_not_mistaken_for_a_cut_one():
    for seed in range(5):
        assert not refusals(simulated(np.geomspace(0.3, 8.0, 25), seed=seed, shadowing_db=3.0)), seed


def test_uncounted_misses_are_refused_though_the_truncated_fit_is_near():
    whole = simulated(np.geomspace(0.3, 8.0, 60))
    cut = whole.keep(whole.rss_dbm > -70.0)
    result = fit(cut, Options(missed="uncounted"))
    assert abs(result.antenna.path_loss_exponent - 2.5) < 0.25
    assert "nobody knows how many" in judge(result).refusals[0]


def test_level_that_rises_with_distance_is_refused():
    assert "rises with distance" in refusals(
        simulated(np.geomspace(0.3, 8, 20), truth=Antenna(-1.0, -60, 3, -95))
    )


def test_an_antenna_pattern_is_missed():
    rng = np.random.default_rng(1)
    readings = simulated(np.geomspace(0.3, 8.0, 60))
    heading = rng.uniform(0, 360, 60)[readings.place]
    level = np.round(readings.rss_dbm + 6.0 * np.cos(np.radians(heading)))
    data = from_arrays(readings.distance_m, level, readings.place, heading_deg=heading)
    assert "antenna pattern is missing" in refusals(data)


def test_a_bend_is_noticed():
    readings = simulated(np.geomspace(0.3, 20.0, 60), truth=Antenna(2.0, -50.0, 2.0, -120.0))
    x = np.log10(readings.distance_m)
    bent = from_arrays(
        readings.distance_m, np.round(readings.rss_dbm - 15.0 * (x - x.mean()) ** 2), readings.place
    )
    assert "bend away" in refusals(bent)


def test_exchanged_coordinates_are_named(tmp_path):
    rng = np.random.default_rng(2)
    lines = ["tx_east_m,tx_north_m,rx_east_m,rx_north_m,rss_dbm"]
    for _ in range(40):
        east, north = rng.uniform(0, 20, 2)
        d = np.hypot(east - 18.0, north - 3.0)
        level = -50.0 - 25.0 * np.log10(d) + rng.normal(0, 2)
        lines.append(f"18,3,{north:.2f},{east:.2f},{level:.0f}")
    path = tmp_path / "swapped.csv"
    path.write_text("\n".join(lines))
    assert "east and north of the receiver are exchanged" in refusals(read_readings(path))


def test_one_value_repeated_is_refused():
    with pytest.raises(CalibrationRefused, match="repeats one value"):
        fit(from_arrays(np.repeat([1.0, 2.0, 4.0], 100), np.full(300, -60.0)))


def test_coordinates_that_are_right_are_not_called_exchanged(tmp_path):
    path = tmp_path / "right.csv"
    for seed in range(10):
        rng = np.random.default_rng(seed)
        tx = rng.uniform(0, 20, 2)
        lines = ["tx_east_m,tx_north_m,rx_east_m,rx_north_m,rss_dbm"]
        for rx in rng.uniform(0, 20, (30, 2)):
            level = -50.0 - 25.0 * np.log10(np.hypot(*(rx - tx))) + rng.normal(0, 4)
            lines.append(f"{tx[0]:.2f},{tx[1]:.2f},{rx[0]:.2f},{rx[1]:.2f},{level:.0f}")
        path.write_text("\n".join(lines))
        judgement = judge(fit(read_readings(path)))
        assert "exchanged" not in " ".join(judgement.reasons), seed


def test_latitude_and_longitude_of_one_end_exchanged_are_named(tmp_path):
    rng = np.random.default_rng(3)
    lines = ["tx_lat_deg,tx_lon_deg,rx_lat_deg,rx_lon_deg,rss_dbm"]
    for north, east in rng.uniform(10, 500, (30, 2)):
        level = -30.0 - 27.0 * np.log10(np.hypot(north, east)) + rng.normal(0, 3)
        lines.append(f"11,48,{48 + north / 111_200:.7f},{11 + east / 74_500:.7f},{level:.0f}")
    path = tmp_path / "swapped.csv"
    path.write_text("\n".join(lines))
    assert "latitude and longitude of the transmitter are exchanged" in refusals(read_readings(path))
