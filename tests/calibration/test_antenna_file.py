"""What an antenna file says about directions and about its own uncertainty."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from fieldkit.channel.antenna_file import (
    AntennaFile,
    dump_antenna,
    gain_db,
    parse_antenna,
    predictive_sigma_db,
)
from fieldkit.channel.model import Antenna
from fieldkit.channel.pattern import dipole_gain_db, lobe_gain_db
from fieldkit.errors import ConfigError

ANTENNA = Antenna(2.5, -60.0, 3.0, -80.0)
NAMES = ["power_at_1m_dbm", "path_loss_exponent", "sigma_db"]
COVARIANCE = [[1.0, 0.12, 0.05], [0.12, 0.04, 0.01], [0.05, 0.01, 0.25]]
UNSURE = AntennaFile(ANTENNA, covariance={"names": NAMES, "matrix": COVARIANCE})
HEADING = np.arange(0.0, 360.0, 5.0)
LOBE = {"front_deg": 40.0, "narrowness": 1.5, "floor_db": 12.0, "offset_db": 5.0}
DIRECTED = AntennaFile(
    ANTENNA,
    model="lobe",
    pattern={
        "family": "lobe",
        "heading_deg": HEADING.tolist(),
        "gain_db": lobe_gain_db(HEADING, **LOBE).tolist(),
        "gain_sigma_db": [0.5] * len(HEADING),
        "parameters": LOBE,
    },
)


def back(file):
    return parse_antenna(tomllib.loads(dump_antenna(file)), "a.toml")


@pytest.mark.parametrize("range_m", [0.1, 1.0, 7.0, 200.0])
def test_predictive_sigma_is_the_spread_of_readings_over_all_likely_parameters(range_m):
    rng = np.random.default_rng(1)
    power, exponent, sigma = rng.multivariate_normal([-60.0, 2.5, 3.0], COVARIANCE, 400_000).T
    readings = power - 10.0 * exponent * np.log10(range_m) + sigma * rng.normal(size=len(power))
    assert predictive_sigma_db(UNSURE, range_m) == pytest.approx(np.std(readings), rel=0.005)


def test_predictive_sigma_is_least_near_where_the_readings_were_and_grows_beyond():
    sigma = predictive_sigma_db(UNSURE, np.array([0.01, 0.5, 1e3]))
    assert sigma[1] < sigma[0] and sigma[1] < sigma[2]
    assert np.all(sigma > ANTENNA.sigma_db)


def test_without_a_covariance_there_is_only_sigma():
    np.testing.assert_array_equal(predictive_sigma_db(AntennaFile(ANTENNA), np.array([1.0, 9.0])), 3.0)


def test_the_patterns_error_adds_in_square():
    assert predictive_sigma_db(DIRECTED, 3.0, 17.0) == pytest.approx(np.hypot(3.0, 0.5))


def test_a_directional_file_survives_writing_and_reading():
    file = back(DIRECTED)
    heading = np.linspace(-180.0, 540.0, 77)
    assert file.model == "lobe"
    np.testing.assert_allclose(gain_db(file, heading), lobe_gain_db(heading, **LOBE))
    np.testing.assert_array_equal(gain_db(AntennaFile(ANTENNA), heading), 0.0)


def test_a_table_goes_on_round_the_circle():
    table = {"family": "spline", "heading_deg": [0.0, 90.0, 180.0, 270.0], "gain_db": [4.0, 0.0, -4.0, 0.0]}
    file = back(AntennaFile(ANTENNA, model="tabulated", pattern=table))
    np.testing.assert_allclose(gain_db(file, [0, 45, 315, 360, -90]), [4.0, 2.0, 2.0, 4.0, 0.0])


def test_the_lobe_is_the_papers():
    # RWA eq 6: cos^2(4 phi) within 20 degrees, cos^2(80 degrees) elsewhere; "about 15 dB higher" at the peak.
    floor = -20.0 * np.log10(np.cos(np.radians(80.0)))
    gain = lobe_gain_db(np.array([0.0, 10.0, 20.0, 90.0, 180.0]), 0.0, 4.0, floor)
    expected = 20.0 * np.log10(np.cos(np.radians([0.0, 40.0, 80.0, 80.0, 80.0])))
    np.testing.assert_allclose(gain, expected, atol=1e-9)
    assert floor == pytest.approx(15.2, abs=0.05)


def test_the_dipole_is_the_papers():
    # CSMA-PF eq 3, as a power gain: 1.4825 cos ahead, 1.0654 |cos| behind.
    gain = dipole_gain_db(np.array([0.0, 60.0, 180.0, 120.0]), 0.0, 10 * np.log10(1.4825 / 1.0654), 40.0)
    power = np.array([1.4825, 1.4825 * 0.5, 1.0654, 1.0654 * 0.5]) / 1.4825
    np.testing.assert_allclose(gain, 10.0 * np.log10(power), atol=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"schema": 99}, "newer than this fieldkit"),
        ({"schema": "1"}, "schema: expected the integer"),
        ({"schema": True}, "schema: expected the integer"),
        ({"model": "yagi"}, "model: expected one of"),
        ({"model": "lobe"}, "pattern: expected equally long lists"),
        ({"covariance": {"names": ["a"], "matrix": [[1.0, 2.0]]}}, "covariance: expected names"),
        ({"covariance": {"names": ["a"], "matrix": [[float("nan")]]}}, "covariance: expected names"),
        ({"parameters": {"path_loss_exponent": 2.0}}, "power_at_1m_dbm: expected a finite number"),
    ],
)
def test_a_malformed_file_is_named_with_its_key(change, says):
    raw = {**tomllib.loads(dump_antenna(AntennaFile(ANTENNA))), **change}
    with pytest.raises(ConfigError, match=r"a\.toml") as caught:
        parse_antenna(raw, "a.toml")
    assert says in str(caught.value)


def test_a_lobe_without_its_parameters_is_refused():
    broken = replace(DIRECTED, pattern={**DIRECTED.pattern, "parameters": {"front_deg": 0.0}})
    with pytest.raises(ConfigError, match=r"pattern\.parameters\.narrowness"):
        back(broken)
