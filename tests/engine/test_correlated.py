"""The likelihood under correlated shadowing: laws, limits, and plain numpy twins of its loops."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from fieldkit.channel.model import Antenna
from fieldkit.channel.reml import by_place, design
from fieldkit.channel.spread import ChannelSpread, Draw, draws
from fieldkit.engine.likelihood import correlated_loops as loops
from fieldkit.engine.likelihood.correlated import conditioned, log_likelihood, residuals, together
from fieldkit.engine.location.ground import Posterior, explore, polygon
from fieldkit.engine.location.one_source import OneSource, Radio, locate

ANTENNA = Antenna(2.5, -40.0, 4.0, -95.0)
KNOWN = np.diag([1e-14, 1e-14, 1e-14, 1e-14, 1e-14])


def walk(n=40, seed=0, up=0.0):
    rng = np.random.default_rng(seed)
    place = np.column_stack([np.cumsum(rng.normal(0.5, 0.8, (n, 2)), axis=0), np.full(n, up)])
    return place, rng.normal(-70.0, 5.0, n)


def one_by_one(place, level):
    """Every reading a place of its own."""
    return together(place, level, 1e-9)


def test_without_place_noise_it_is_the_sum_of_independent_densities():
    place, level = walk()
    draw = Draw(9.0, 0.0, 0.0, np.array([-40.0, 2.5, 0.0, 0.0, 0.0]), KNOWN)
    points = np.array([[3.0, 4.0, 0.0], [20.0, 10.0, 0.0]])
    (logs,), _ = log_likelihood(points, *one_by_one(place, level), [draw], 0.05)
    for point, log in zip(points, logs, strict=True):
        mean = ANTENNA.mean_rss_dbm(np.sqrt(((place - point) ** 2).sum(axis=1)))
        assert log == pytest.approx(norm.logpdf(level, mean, np.sqrt(9.0 + 1 / 12)).sum(), abs=1e-9)


def test_with_all_neighbours_it_is_the_joint_normal_density():
    """Eleven places and ten neighbours: nothing is left out of the conditioning."""
    place, level = walk(11)
    covariance = np.diag([25.0, 0.1, 4.0, 4.0, 1.0])
    draw = Draw(4.0, 16.0, 2.0, np.array([-40.0, 2.5, 0.0, 0.0, 0.0]), covariance)
    point = np.array([3.0, 4.0, 0.0])
    (logs,), best = log_likelihood(point[None], *one_by_one(place, level), [draw], 0.05)
    columns = design(place, point, 0.05)
    apart = np.sqrt(((place[:, None] - place[None]) ** 2).sum(axis=-1))
    cov = 16.0 * np.exp(-apart / 2.0) + (4.0 + 1 / 12) * np.eye(11)
    joint = cov + columns @ covariance @ columns.T
    assert logs[0] == pytest.approx(multivariate_normal(columns @ draw.mean, joint).logpdf(level), abs=1e-8)
    gain = covariance @ columns.T @ np.linalg.inv(joint)
    assert best[0] == pytest.approx(draw.mean + gain @ (level - columns @ draw.mean), abs=1e-8)


def test_nearest_earlier_places_are_those_of_the_plain_loop():
    place, _ = walk(60, seed=3)
    found = np.empty((60, 5), dtype=np.int64)
    loops.nearest_earlier(place, 5, found)
    for k in range(60):
        away = ((place[:k] - place[k]) ** 2).sum(axis=1)
        expected = np.argsort(away, kind="stable")[:5]
        assert found[k].tolist() == expected.tolist() + [-1] * (5 - expected.size)


def test_weights_and_deviations_are_those_of_the_normal_law():
    place, level = walk(30, seed=4)
    places, neighbours = one_by_one(place, level)
    draw = Draw(4.0, 16.0, 3.0, np.zeros(5), KNOWN)
    heard = conditioned(places, neighbours, draw)
    for k in range(30):
        near = neighbours[k][neighbours[k] >= 0]
        apart = np.sqrt(((places.place_m[near][:, None] - places.place_m[near][None]) ** 2).sum(axis=-1))
        cov = 16.0 * np.exp(-apart / 3.0) + (4.0 + 1 / 12) * np.eye(near.size)
        cross = 16.0 * np.exp(-np.sqrt(((places.place_m[near] - places.place_m[k]) ** 2).sum(axis=1)) / 3.0)
        weights = np.linalg.solve(cov, cross) if near.size else np.zeros(0)
        assert heard.weights[k][: near.size] == pytest.approx(weights, abs=1e-10)
        assert heard.deviation[k] ** 2 == pytest.approx(16.0 + 4.0 + 1 / 12 - weights @ cross, abs=1e-9)


def test_the_compiled_features_are_the_plain_ones():
    place, _ = walk(20, seed=5, up=40.0)
    out = np.empty((20, loops.FEATURES))
    loops.features(3.0, -2.0, 1.5, place, 0.5, out)
    assert out == pytest.approx(design(place, np.array([3.0, -2.0, 1.5]), 0.5), abs=1e-12)


def test_twice_as_far_in_three_dimensions_costs_ten_beta_log_two():
    place = np.array([[0.0, 30.0, 40.0], [0.0, 60.0, 80.0]])
    columns = design(place, np.zeros(3), 0.05)
    assert 2.5 * (columns[0, 1] - columns[1, 1]) == pytest.approx(25.0 * np.log10(2.0))
    assert columns[0, 4] == pytest.approx(columns[1, 4])  # the same elevation


def spread(**changes):
    return ChannelSpread(**{"sigma_time_db": 2.0, "sigma_place_db": 4.0, "correlation_m": 5.0, **changes})


def located(level, place, **changes):
    return locate(OneSource(place, level), Radio(ANTENNA, spread(**changes)), (-40.0, -40.0, 60.0, 60.0))


def grid_walk():
    east, north = np.meshgrid(np.arange(0.0, 21.0, 4.0), np.arange(0.0, 21.0, 4.0))
    return np.column_stack([east.ravel(), north.ravel(), np.zeros(east.size)])


def test_thirty_packets_at_each_place_sharpen_no_more_than_the_place_allows():
    rng = np.random.default_rng(2)
    place = grid_walk()
    mean = ANTENNA.mean_rss_dbm(np.hypot(place[:, 0] - 9.0, place[:, 1] - 12.0))
    shadowed = mean + rng.normal(0.0, 4.0, mean.size)

    def spread_m(packets):
        level = np.repeat(shadowed, packets) + rng.normal(0.0, 0.5, mean.size * packets)
        found = located(level, np.repeat(place, packets, axis=0), sigma_time_db=0.5)
        return float(np.sqrt(np.trace(found.posterior.cov_m2)))

    once, often = spread_m(1), spread_m(30)
    assert often > 0.8 * once


def test_the_power_of_the_source_does_not_matter_when_it_is_unknown():
    place = grid_walk()
    mean = ANTENNA.mean_rss_dbm(np.hypot(place[:, 0] - 9.0, place[:, 1] - 12.0))
    quiet, loud = (
        located(mean - 6.0, place, transmitter_db=30.0),
        located(mean + 6.0, place, transmitter_db=30.0),
    )
    assert np.hypot(*(quiet.posterior.centre_m() - loud.posterior.centre_m())) < 0.5
    assert loud.power_db - quiet.power_db == pytest.approx(12.0, abs=0.5)


@pytest.mark.parametrize("seed", [1, 2])
def test_regions_cover_as_stated_where_the_model_holds(seed):
    """60 sources under shadowing of 4 dB over 5 m: 78 to 98 % in the 90 % regions, 32 to 68 % in the half ones."""
    rng = np.random.default_rng(seed)
    place = grid_walk()
    apart = np.sqrt(((place[:, None] - place[None]) ** 2).sum(axis=-1))
    root = np.linalg.cholesky(16.0 * np.exp(-apart / 5.0) + 1e-9 * np.eye(place.shape[0]))
    exact = spread(
        transmitter_db=3.0,
        transmitter_exponent=1e-3,
        lobe_db=1e-3,
        mean_covariance=((1e-9, 0, 0), (0, 1e-9, 0), (0, 0, 1e-9)),
    )
    radio = Radio(ANTENNA, exact)
    ninety = half = 0
    for _ in range(60):
        source = rng.uniform(0.0, 20.0, 2)
        level = ANTENNA.mean_rss_dbm(np.maximum(np.hypot(*(place[:, :2] - source).T), 0.3))
        level = level + 3.0 * rng.standard_normal() + root @ rng.standard_normal(level.size)
        level = level + 2.0 * rng.standard_normal(level.size)
        found = locate(OneSource(place, level), radio, (0.0, 0.0, 20.0, 20.0), count=1).posterior
        ninety += found.holds(source, 0.9)
        half += found.holds(source, 0.5)
    assert 47 <= ninety <= 59 and 19 <= half <= 41


def test_residuals_are_white_where_the_model_holds_and_large_where_it_does_not():
    rng = np.random.default_rng(7)
    place = grid_walk()
    apart = np.sqrt(((place[:, None] - place[None]) ** 2).sum(axis=-1))
    root = np.linalg.cholesky(16.0 * np.exp(-apart / 5.0) + 1e-9 * np.eye(place.shape[0]))
    draw = Draw(4.0, 16.0, 5.0, np.array([-40.0, 2.5, 0.0, 0.0, 0.0]), np.diag([9.0, 1e-6, 1e-6, 1e-6, 1e-6]))
    point = np.array([9.0, 12.0, 0.0])
    squares, wrong = [], []
    for _ in range(30):
        level = design(place, point, 0.3) @ draw.mean + root @ rng.standard_normal(place.shape[0])
        level = level + 2.0 * rng.standard_normal(level.size)
        squares.append(np.mean(residuals(point, *one_by_one(place, level), draw, 0.3) ** 2))
        wrong.append(np.mean(residuals(point, *one_by_one(place, 3.0 * level + 140.0), draw, 0.3) ** 2))
    assert 0.85 < np.mean(squares) < 1.15
    assert np.mean(wrong) > 2.5


def test_draws_are_always_the_same_and_the_first_is_the_calibration_itself():
    first, second = draws(ANTENNA, spread(), 6), draws(ANTENNA, spread(), 6)
    assert [d.place_var for d in first] == [d.place_var for d in second]
    assert first[0].place_var == pytest.approx(16.0) and first[0].correlation_m == pytest.approx(5.0)
    assert first[0].mean[:2] == pytest.approx([-40.0, 2.5])


def test_readings_of_one_cell_become_one_with_their_number():
    place = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    told = by_place(place, np.array([-60.0, -70.0, -64.0]), 1.0, 100)
    assert told.count.tolist() == [2.0, 1.0] and told.level_db.tolist() == [-62.0, -70.0]
    assert told.within == pytest.approx(8.0) and told.freedom == 1


# The ground


def bump(points):
    return -0.5 * ((points - np.array([3.0, -2.0])) ** 2).sum(axis=1) / 0.04, np.zeros((points.shape[0], 5))


def test_a_sharp_posterior_is_refined_until_it_is_smooth():
    found = explore(bump, (-50.0, -50.0, 50.0, 50.0))
    assert found.centre_m() == pytest.approx([3.0, -2.0], abs=0.02)
    assert np.sqrt(np.diag(found.cov_m2)) == pytest.approx([0.2, 0.2], rel=0.1)
    assert found.within(np.array([3.0, -2.0]), 0.2 * 2.146) == pytest.approx(0.9, abs=0.03)
    assert found.log_evidence == pytest.approx(np.log(2 * np.pi * 0.04 / 1e4), abs=0.02)


def test_the_outline_of_a_region_has_its_area():
    found = explore(bump, (-50.0, -50.0, 50.0, 50.0))
    area = 0.0
    for ring in polygon(found, 0.9):
        x, y = np.array(ring).T
        area += 0.5 * float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))
    assert area == pytest.approx(found.region(0.9).size * found.cell_m**2)
    assert area == pytest.approx(np.pi * 0.04 * 4.605, rel=0.1)


def test_a_far_tail_does_not_pull_the_centre_along():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [500.0, 500.0]])
    found = Posterior(points, np.array([0.5, 0.2, 0.2, 0.1]), 1.0, 0.0, np.zeros((4, 5)))
    assert np.hypot(*found.centre_m()) < 0.5 and np.hypot(*found.mean_m) > 50.0
