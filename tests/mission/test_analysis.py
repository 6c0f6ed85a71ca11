"""Refinement and coverage after the fact, against laws and simulated truth."""

from dataclasses import replace

import numpy as np
import pytest
from sizes import size

from fieldkit.channel.model import Antenna
from fieldkit.channel.pattern import lobe_gain_db
from fieldkit.messages import Detection, SourceEstimate
from fieldkit.settings import ELLIPSE_90
from fieldkit.world.channel import sample_rss_dbm
from mission.analysis.coverage import coverage
from mission.analysis.refine import model_fit, refine

ANTENNA = Antenna(2.5, -60.0, 3.0, -95.0, -20.0)
LEVELS = (-4.0, 0.0)


def heard_from(source, count, rng):
    """`count` transmissions of a source (east, north, power), each heard by four robots somewhere around it."""
    found = []
    for k in range(count):
        place = rng.uniform(0.0, 20.0, (4, 2))
        rss = sample_rss_dbm(ANTENNA, np.hypot(*(place - source[:2]).T), source[2], rng)
        if not np.isnan(rss).all():
            found.append(Detection(k, ("a", "b", "c", "d"), place, np.zeros(4), rss, np.zeros(4, bool)))
    return found


def guess(ident, east, north):
    return SourceEstimate(ident, east, north, np.eye(2), 9, 5.0, 0.1, 1.0, 0.9, "found", power_db=-2.0)


def run(detections, guesses):
    return refine(detections, guesses, ANTENNA, size_m=(20.0, 20.0), levels_db=LEVELS, place_sigma_m=0.01)


def test_two_sources_are_told_apart_and_placed_better_than_guessed():
    rng = np.random.default_rng(1)
    truth = np.array([[5.0, 6.0, 0.0], [15.0, 13.0, -4.0]])
    detections = heard_from(truth[0], 40, rng) + heard_from(truth[1], 40, rng)
    refined = run(detections, [guess(1, 5.5, 5.2), guess(2, 14.0, 14.0)])
    for source, true in zip(refined, truth, strict=True):
        assert np.hypot(source.east_m - true[0], source.north_m - true[1]) < 3.5 * source.sigma_m * 2**0.5
        assert source.sigma_m < 0.3
        assert source.power_db == pytest.approx(true[2], abs=3.5 * source.power_sigma_db)
    first = np.arange(len(detections)) < 40
    assert refined[0].share[first].mean() > 0.9 and refined[0].share[~first].mean() < 0.1


def test_with_a_directional_antenna_the_gain_towards_the_source_counts():
    """One robot, as in RWA: readings from everywhere, the antenna pointing anywhere."""
    gains = tuple(float(g) for g in lobe_gain_db(np.arange(360.0), 0.0, 4.0, -15.0))
    beam = replace(ANTENNA, pattern_db=gains)
    rng = np.random.default_rng(9)
    truth = np.array([8.0, 11.0, 0.0])
    detections = []
    for k in range(80):
        place, heading = rng.uniform(0.0, 20.0, (1, 2)), rng.uniform(0.0, 360.0, 1)
        way = (truth[:2] - place)[0]
        off = np.degrees(np.arctan2(*way)) - heading
        rss = sample_rss_dbm(beam, np.hypot(*way)[None], 0.0, rng, off)
        detections.append(Detection(k, ("a",), place, heading, rss, np.zeros(1, bool)))
    found = {}
    for name, antenna in (("beam", beam), ("round", ANTENNA)):
        (found[name],) = refine(
            detections,
            [guess(1, 8.6, 10.3)],
            antenna,
            size_m=(20.0, 20.0),
            levels_db=LEVELS,
            place_sigma_m=0.01,
        )
    right = found["beam"]
    assert np.hypot(right.east_m - 8.0, right.north_m - 11.0) < 3.5 * right.sigma_m * 2**0.5
    assert right.sigma_m < 0.3 and right.power_db == pytest.approx(0.0, abs=3.5 * right.power_sigma_db)
    assert found["round"].power_db < right.power_db - 3.0, "taken for one that hears the same all round"
    assert model_fit(detections, [right], beam, 0.01).spread_db == pytest.approx(3.0, rel=0.25)


def test_the_ninety_percent_ellipse_holds_the_truth_nine_times_in_ten():
    inside = 0
    trials = size(40, 120)
    for trial in range(trials):
        rng = np.random.default_rng([7, trial])
        truth = np.array([*rng.uniform(6.0, 14.0, 2), -2.0])
        (source,) = run(heard_from(truth, 15, rng), [guess(1, *(truth[:2] + rng.normal(0.0, 0.3, 2)))])
        off = np.array([source.east_m, source.north_m]) - truth[:2]
        inside += off @ np.linalg.solve(source.cov_m2, off) <= ELLIPSE_90**2
    # Binomial: 108 expected of 120, standard deviation 3.3; 36 of 40, 1.9.
    low, high = {40: (30, 39), 120: (96, 118)}[trials]
    assert low <= inside <= high


def test_four_times_the_receptions_halve_the_ellipse():
    truth = np.array([10.0, 10.0, 0.0])
    once = heard_from(truth, 40, np.random.default_rng(3))
    often = [d for _ in range(4) for d in heard_from(truth, 40, np.random.default_rng(3))]
    sigma = [run(detections, [guess(1, 10.2, 9.9)])[0].sigma_m for detections in (once, often)]
    assert sigma[0] / sigma[1] == pytest.approx(2.0, rel=0.05)


def test_nothing_heard_refines_nothing():
    assert run([], [guess(1, 1.0, 1.0)]) == []


def test_the_model_fit_finds_the_spread_there_is_and_a_wrong_level():
    rng = np.random.default_rng(5)
    detections = heard_from(np.array([10.0, 10.0, 0.0]), 120, rng)
    fit = model_fit(detections, run(detections, [guess(1, 10.1, 10.0)]), ANTENNA, 0.01)
    assert fit.spread_db == pytest.approx(3.0, rel=0.15) and abs(fit.bias_db) < 0.5
    assert fit.promised_db == pytest.approx(3.01, abs=0.1)


def still(robots, duration_s=600.0):
    t = np.arange(0.0, duration_s + 0.5, 0.5)
    return {
        name: np.column_stack([t, np.full(t.size, e), np.full(t.size, n)]) for name, (e, n) in robots.items()
    }


def cover(tracks, down=None, rate_hz=0.05, duration_s=600.0):
    return coverage(tracks, down or {}, ANTENNA, LEVELS, (100.0, 100.0), rate_hz, duration_s)


def test_a_place_beside_a_robot_is_heard_as_poisson_says():
    found = cover(still({"a": (50.0, 50.0)}, 100.0), rate_hz=0.02, duration_s=100.0)
    near = found.heard[25, 25]
    assert near == pytest.approx(1.0 - np.exp(-0.98 * 0.02 * 100.0), abs=0.01)


def test_what_is_far_away_is_not_searched_and_named():
    found = cover(still({"a": (5.0, 5.0)}))
    assert found.heard[0, 0] > 0.99 and found.heard[-1, -1] < 0.01
    assert found.weakest()[0] == "the north-east" and 0.0 < found.searched_share < 0.5


def test_a_receiver_that_is_down_searches_nothing():
    tracks = still({"a": (50.0, 50.0)})
    assert cover(tracks, {"a": [(0.0, 600.0)]}).heard.max() == 0.0
    half = cover(tracks, {"a": [(300.0, 600.0)]}, rate_hz=0.002)
    assert half.heard[25, 25] < cover(tracks, rate_hz=0.002).heard[25, 25]


def test_a_directional_antenna_covers_its_share_of_the_headings():
    """A tenth of a turn heard, and the rest not: so is a tenth of the time beside it."""
    tracks = still({"a": (50.0, 50.0)}, 100.0)
    beam = replace(ANTENNA, pattern_db=tuple(np.where(np.arange(360) < 36, 0.0, -200.0)))
    found = coverage(tracks, {}, beam, LEVELS, (100.0, 100.0), 0.02, 100.0)
    exposure = -np.log(1.0 - found.heard[25, 25]) / -np.log(
        1.0 - cover(tracks, rate_hz=0.02, duration_s=100.0).heard[25, 25]
    )
    assert exposure == pytest.approx(0.1, abs=0.02)
