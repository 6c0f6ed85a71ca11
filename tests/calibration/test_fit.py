"""The fit finds the truth on simulated data, and the published numbers on real readings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration import bench, study
from calibration.dataset import from_arrays, read_readings
from calibration.fit import Options, fit
from calibration.verdict import judge
from fieldkit.channel.model import Antenna

ROOT = Path(__file__).parents[2]
DATASETS = ROOT.parent / "shared" / "datasets"
real_data = pytest.mark.skipif(not DATASETS.is_dir(), reason=f"no shared datasets beside {ROOT.name}")


def simulated(seed=0, n=60, packets=20, truth=study.TRUTH, **more):
    rng = np.random.default_rng(seed)
    distance = np.exp(rng.uniform(np.log(0.15), np.log(4.5), n))
    return study.simulate(truth, distance, packets, rng, **more)


def test_the_truth_lies_in_the_intervals_and_the_threshold_is_exact():
    result = fit(simulated(seed=1, n=200))
    assert result.converged and result.missed == "counted"
    for name, (low, high) in result.intervals_95.items():
        assert low <= getattr(study.TRUTH, name) <= high, name
    assert result.antenna.saturation_dbm == study.TRUTH.saturation_dbm


def test_doubling_the_range_loses_ten_beta_log_two():
    result = fit(simulated(seed=2))
    loss = result.mean_dbm(np.array([1.0])) - result.mean_dbm(np.array([2.0]))
    assert loss[0] == pytest.approx(10.0 * result.antenna.path_loss_exponent * np.log10(2.0))


def test_ignoring_what_was_missed_would_be_badly_wrong():
    readings = simulated(seed=3, n=200)
    heard = ~readings.missed
    naive, _ = np.polyfit(-10.0 * np.log10(readings.distance_m[heard]), readings.rss_dbm[heard], 1)
    assert naive < study.TRUTH.path_loss_exponent - 0.3
    assert abs(fit(readings).antenna.path_loss_exponent - study.TRUTH.path_loss_exponent) < 0.1


def test_bias_is_small_and_intervals_cover_the_truth():
    heard = []
    report = study.run(trials=24, seed=5, progress=lambda done, text: heard.append(done))
    for name in study.CONDITIONS:
        said = report[name]
        assert abs(said["bias"]["path_loss_exponent"]) < 0.02, name
        assert abs(said["bias"]["power_at_1m_dbm"]) < 0.15, name
        assert abs(said["bias"]["threshold_dbm"]) < 0.15, name
        assert np.mean(list(said["coverage"].values())) > 0.88, name
        assert said["missed"] == pytest.approx(0.11, abs=0.01)
        assert said["saturated"] == pytest.approx(0.21, abs=0.02)
    assert report["plain"]["threshold_exact"] > 0.8
    assert heard[-1] == 1.0 and heard == sorted(heard)


def test_the_benchmark_measures_the_fit_and_least_squares_on_the_same_readings():
    said = bench._measure(40, 5, 0.05, 1)
    assert said["readings"] == 200 and said["distinct_rows"] > 150
    assert said["fit_s"] > 0.0 and said["least_squares_s"] > 0.0
    assert abs(said["exponent_error"]) < abs(said["least_squares_exponent_error"])


def test_shadowing_widens_the_intervals_far_beyond_the_naive_ones():
    result = fit(simulated(seed=6, n=40, packets=50, truth=Antenna(2.5, -60.0, 1.5, -95.0), shadowing_db=4.0))
    naive = np.sqrt(result.naive_covariance[1, 1])
    assert result.errors()["path_loss_exponent"] > 4.0 * naive
    assert result.sigma_time_db == pytest.approx(1.5, abs=0.2)
    assert result.sigma_place_db == pytest.approx(4.0, abs=1.2)


def test_a_thousand_copies_of_a_place_say_nothing_new_about_the_exponent():
    few = fit(simulated(seed=7, packets=10, truth=Antenna(2.5, -60.0, 0.5, -99.0), shadowing_db=4.0))
    many = fit(simulated(seed=7, packets=300, truth=Antenna(2.5, -60.0, 0.5, -99.0), shadowing_db=4.0))
    assert many.errors()["path_loss_exponent"] > 0.8 * few.errors()["path_loss_exponent"]


def test_a_few_outliers_are_left_out_and_counted():
    readings = simulated(seed=8, n=100)
    level = readings.rss_dbm.copy()
    far = np.flatnonzero(readings.distance_m > 2.0)[:5]
    level[far] = -53.0
    result = fit(from_arrays(readings.distance_m, level, readings.place))
    assert result.n_outliers >= 4
    assert abs(result.antenna.path_loss_exponent - 2.53) < 0.12


def test_packets_lost_close_by_do_not_bend_the_fit():
    readings = simulated(seed=9, n=100)
    level = readings.rss_dbm.copy()
    near = np.flatnonzero(readings.distance_m < 0.3)
    level[near[:: max(1, len(near) // 20)]] = np.nan
    result = fit(from_arrays(readings.distance_m, level, readings.place))
    assert result.n_lost_near > 10
    assert abs(result.antenna.path_loss_exponent - 2.53) < 0.12
    assert any("collisions" in text for text in judge(result).warnings)


def test_receivers_that_differ_are_told_apart():
    rng = np.random.default_rng(10)
    readings = simulated(seed=10, n=120, truth=Antenna(2.5, -50.0, 2.0, -95.0))
    receiver = rng.integers(0, 3, len(readings.rss_dbm))
    level = readings.rss_dbm + np.array([0, 4, -3])[receiver]
    data = from_arrays(
        readings.distance_m, level, readings.place, receiver=receiver, receivers=("a", "b", "c")
    )
    offsets = fit(data, Options(receiver_offsets=True)).receiver_offsets_db
    assert offsets["b"][0] == pytest.approx(4.0, abs=0.3)
    assert offsets["c"][0] == pytest.approx(-3.0, abs=0.3)
    (said,) = [text for text in judge(fit(data)).warnings if text.startswith("receivers differ")]
    assert float(said.split()[3]) == pytest.approx(7.0, abs=0.5) and "--receiver-offsets" in said
    assert not any(
        "receivers differ" in text for text in judge(fit(data, Options(receiver_offsets=True))).warnings
    )
    alike = replace(data, rss_dbm=readings.rss_dbm)
    assert not any("receivers differ" in text for text in judge(fit(alike)).warnings)


def test_a_million_readings_shrink_to_their_distinct_ones():
    readings = simulated(seed=11, n=50, packets=20_000)
    result = fit(readings)
    assert result.n_readings + result.n_missed + result.n_outliers == 1_000_000
    assert len(result.rows.count) < 3000
    assert abs(result.antenna.path_loss_exponent - 2.53) < 0.01


@real_data
@pytest.mark.parametrize(
    ("name", "where", "exponent", "sigma", "error"),
    [
        ("xbee_walk.csv", None, 2.90, 4.5, 0.26),
        ("xbee_triangles.csv", {"room": "room1"}, 1.53, 4.9, 0.3),
        ("xbee_triangles.csv", {"room": "room2"}, 2.46, 4.2, 0.3),
    ],
)
def test_real_xbees_give_the_published_exponents(name, where, exponent, sigma, error):
    result = fit(read_readings(DATASETS / name, where=where))
    assert result.antenna.path_loss_exponent == pytest.approx(exponent, abs=0.02)
    assert result.antenna.sigma_db == pytest.approx(sigma, abs=0.1)
    assert result.errors()["path_loss_exponent"] == pytest.approx(error, abs=0.06)
    assert judge(result).state == "accepted with warnings"


@real_data
def test_a_walk_with_lora_has_its_missed_packets_counted():
    readings = read_readings(DATASETS / "lora_foot.csv")
    assert (len(readings.rss_dbm), readings.missed.sum()) == (520, 9)
    result = fit(readings)
    assert result.converged and 2.0 < result.antenna.path_loss_exponent < 3.2
    assert any("sigma" in text for text in judge(result).warnings)


def test_the_shipped_example_is_what_its_generator_writes_and_fits_its_truth():
    from calibration.example_log import TRUTH, example_csv

    path = ROOT / "examples" / "readings.csv"
    assert path.read_text() == example_csv(1)
    result = fit(read_readings(path))
    assert judge(result).state == "accepted"
    errors = result.errors()
    for name in ("path_loss_exponent", "power_at_1m_dbm", "sigma_db"):
        assert abs(getattr(result.antenna, name) - getattr(TRUTH, name)) < 3.0 * errors[name]
    assert result.antenna.threshold_dbm == TRUTH.threshold_dbm
