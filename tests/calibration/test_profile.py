"""Profile intervals agree with the sandwich where much is known and are lopsided where little is."""

import numpy as np
import pytest

from calibration import study
from calibration.fit import fit
from calibration.profile import profile
from fieldkit.channel.model import Antenna


def simulated(n, packets, truth=study.TRUTH, seed=0):
    rng = np.random.default_rng(seed)
    return study.simulate(truth, np.exp(rng.uniform(np.log(0.15), np.log(4.9), n)), packets, rng)


@pytest.mark.parametrize("name", ["power_at_1m_dbm", "path_loss_exponent", "sigma_db"])
def test_with_many_places_the_profile_is_the_sandwich(name):
    result = fit(simulated(200, 10))
    low, high = result.intervals_95[name]
    np.testing.assert_allclose(profile(result, name).interval_95, (low, high), atol=0.1 * (high - low))


def test_sigma_from_few_readings_may_be_much_larger_but_not_much_smaller():
    result = fit(simulated(12, 1, Antenna(2.5, -60.0, 3.0, -99.0)))
    low, high = profile(result, "sigma_db").interval_95
    assert high - result.antenna.sigma_db > 1.3 * (result.antenna.sigma_db - low) > 0.0


def test_the_curve_is_lowest_at_the_fit():
    result = fit(simulated(60, 10))
    curve = profile(result, "path_loss_exponent")
    at = curve.value[np.argmin(curve.drop)]
    assert abs(at - result.antenna.path_loss_exponent) < 0.1 * np.ptp(curve.value)
