"""The likelihood against numbers got in another way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.stats import norm

from calibration import likelihood
from calibration.likelihood import Rows, interval_terms

INF = np.inf


def a_few_rows(seen_above_dbm=None) -> Rows:
    x = np.log10([1.0, 1.0, 3.0, 3.0, 8.0, 8.0])
    return Rows(
        np.column_stack([np.ones(6), -10.0 * x]),
        np.array([-41.5, -40.5, -55.5, -56.5, -71.5, -INF]),
        np.array([-40.5, INF, -54.5, -55.5, -70.5, -69.5]),
        np.array([5.0, 15.0, 12.0, 8.0, 3.0, 0.0 if seen_above_dbm else 14.0]),
        np.array([0, 0, 1, 1, 2, 2]),
        0.0,
        seen_above_dbm,
    )


@given(st.floats(-100, -20), st.floats(0.5, 12), st.integers(-100, -20))
def test_a_readings_probability_is_a_difference_of_normal_tails(mean, sigma, z):
    term = interval_terms(np.array([mean]), sigma, np.array([z - 0.5]), np.array([z + 0.5]))
    expected = norm.cdf(z + 0.5, mean, sigma) - norm.cdf(z - 0.5, mean, sigma)
    if expected > 1e-12:
        assert np.exp(term.value[0]) == pytest.approx(expected, rel=1e-3, abs=1e-14)


def test_readings_and_misses_of_one_packet_add_up_to_one():
    z = np.arange(-69.0, -40.0)
    low = np.concatenate([[-INF], z - 0.5, [-40.5]])
    high = np.concatenate([[-69.5], z + 0.5, [INF]])
    terms = interval_terms(np.full(len(low), -58.3), 3.3, low, high)
    assert np.exp(terms.value).sum() == pytest.approx(1.0, abs=1e-12)


def test_far_tails_stay_finite_where_probabilities_underflow():
    terms = interval_terms(np.full(3, 300.0), 1.0, np.array([-0.5, -INF, 600.0]), np.array([0.5, 0.0, INF]))
    assert np.all(np.isfinite(terms.value)) and np.all(terms.value < -4e4)
    for name in terms.__dataclass_fields__:
        assert np.all(np.isfinite(getattr(terms, name))), name


@pytest.mark.parametrize("seen_above_dbm", [None, -72.0])
def test_gradient_and_hessian_agree_with_finite_differences(seen_above_dbm):
    rows, theta = a_few_rows(seen_above_dbm), np.array([-42.0, 2.7, 1.1])
    slope = approx_fprime(theta, lambda t: likelihood.nll(t, rows), 1e-6)
    np.testing.assert_allclose(likelihood.gradient(theta, rows), slope, rtol=1e-4, atol=1e-3)
    bend = np.array(
        [approx_fprime(theta, lambda t, i=i: likelihood.gradient(t, rows)[i], 1e-6) for i in range(3)]
    )
    np.testing.assert_allclose(likelihood.hessian(theta, rows), bend, rtol=1e-4, atol=1e-3)


def test_the_scores_of_all_places_sum_to_the_gradient():
    rows, theta = a_few_rows(), np.array([-42.0, 2.7, 1.1])
    np.testing.assert_allclose(
        likelihood.place_scores(theta, rows).sum(axis=0), -likelihood.gradient(theta, rows), atol=1e-9
    )


def test_fine_readings_without_censoring_give_the_least_squares_line():
    rng = np.random.default_rng(3)
    x = rng.uniform(0, 1, 400)
    level = -50.0 - 25.0 * x + rng.normal(0, 4, 400)
    eps = 1e-4
    rows = Rows(
        np.column_stack([np.ones(400), -10.0 * x]), level - eps, level + eps, np.ones(400), np.arange(400)
    )
    theta, converged = likelihood.maximise(rows, np.array([-40.0, 2.0, 1.0]))
    slope, start = np.polyfit(-10.0 * x, level, 1)
    assert converged
    np.testing.assert_allclose(theta[:2], [start, slope], rtol=1e-5)
    assert np.exp(theta[2]) == pytest.approx(np.std(level - start + 10.0 * slope * x), rel=1e-4)
