"""One path-loss law: `channel.law` has it, and every place that uses it or has a form of its own agrees.

These fail where the law is changed in one of them alone.
"""

import numpy as np
import pytest
from scipy.stats import norm

from calibration.dataset import from_arrays
from calibration.observations import fitted_mean
from fieldkit.channel import law
from fieldkit.channel.antenna_file import Receiver
from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.channel.reml import design
from fieldkit.engine.belief.csma import CsmaBelief
from fieldkit.engine.belief.particles import ParticleFilter
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood import law_loops
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.engine.likelihood.pairwise import PairwiseModel, attenuation_db, log_likelihood_exact
from fieldkit.engine.location.one_source import _mean_level
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.reward import hearing_of
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection

ANTENNA = Antenna(2.53, -62.0, 3.3, -95.0)
RANGES_M = np.array([0.3, 0.7, 1.0, 1.9, 3.7, 6.1, 9.0, 14.0])
LEVELS_DB = (-6.0, 0.0, 3.0)
MEAN_DBM = ANTENNA.mean_rss_dbm(RANGES_M)
EAST_M = np.column_stack([RANGES_M, np.zeros(RANGES_M.size)])
"""Points at those ranges from a robot at the origin."""


def test_the_law_loses_ten_beta_for_each_decade() -> None:
    assert pytest.approx(-62.0 - 25.3 * np.log10(RANGES_M), abs=1e-9) == MEAN_DBM


def test_the_nominal_range_is_where_the_mean_falls_to_the_threshold() -> None:
    for power_db in LEVELS_DB:
        range_m = ANTENNA.nominal_range_m(power_db)
        assert ANTENNA.mean_rss_dbm(range_m, power_db) == pytest.approx(ANTENNA.threshold_dbm, abs=1e-9)


def test_the_slope_is_what_the_law_loses_over_a_short_step() -> None:
    step = 1e-6
    lost_db = ANTENNA.loss_db(RANGES_M * (1.0 + step)) - ANTENNA.loss_db(RANGES_M)
    assert ANTENNA.slope_db(RANGES_M) * step * np.ones(lost_db.size) == pytest.approx(lost_db, rel=1e-4)


@pytest.mark.parametrize("more_db", [-9.0, 0.0, 2.5, 12.0])
def test_as_far_is_where_so_much_more_is_lost(more_db: float) -> None:
    square_m2 = law.as_far_m2(RANGES_M**2, more_db, ANTENNA.law)
    lost_db = ANTENNA.loss_db(np.sqrt(square_m2)) - ANTENNA.loss_db(RANGES_M)
    assert lost_db == pytest.approx(np.full(RANGES_M.size, more_db), abs=1e-9)


def test_the_compiled_law_is_the_plain_one_bit_for_bit() -> None:
    for range_m in RANGES_M:
        decades = float(np.log10(range_m))
        for compiled, plain in ((law_loops.loss_db, law.loss_db), (law_loops.slope_db, law.slope_db)):
            assert compiled(decades, ANTENNA.law) == plain(decades, ANTENNA.law)


def test_hearing_follows_the_law() -> None:
    model = LevelsModel(ANTENNA, LEVELS_DB, 0.0)
    for k, power_db in enumerate(LEVELS_DB):
        margin_db = ANTENNA.mean_rss_dbm(RANGES_M, power_db) - ANTENNA.threshold_dbm - 0.5
        expected = np.log1p(-model.tuning.packet_loss) + norm.logcdf(margin_db / ANTENNA.sigma_db)
        assert model.log_hear(RANGES_M, model.level_dbm[k]) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("range_m", RANGES_M)
def test_the_compiled_likelihood_is_even_round_the_laws_mean(range_m: float) -> None:
    model = LevelsModel(ANTENNA, LEVELS_DB, 1e-6)
    place, point = np.array([[2.0, 3.0]]), np.array([[2.0 + 0.6 * range_m, 3.0 - 0.8 * range_m]])
    for k, power_db in enumerate(LEVELS_DB):
        mean_dbm = float(ANTENNA.mean_rss_dbm(range_m, power_db))
        weaker, louder = (
            model.known_log_likelihood(
                Detection(
                    0, ("a",), place, np.zeros(1), np.array([mean_dbm + off_db]), np.zeros(1, dtype=bool)
                ),
                point,
            )[k, 0]
            for off_db in (-4.0, 4.0)
        )
        assert weaker == pytest.approx(louder, abs=2e-3)


def test_a_planned_path_is_heard_from_as_far_as_the_law_says() -> None:
    settings = EngineSettings(
        Grid(30.0, 30.0, 1.0), ANTENNA, (("a",),), receivers={"a": Receiver(3.0, ANTENNA.threshold_dbm)}
    )
    ears = hearing_of(settings, ("a",), {})
    far2_m2 = np.array([path_loops.as_far2(range_m**2, ears, 0) for range_m in RANGES_M])
    assert ANTENNA.loss_db(np.sqrt(far2_m2)) == pytest.approx(ANTENNA.loss_db(RANGES_M) - 3.0, abs=1e-9)


def test_the_papers_attenuation_is_what_the_law_loses() -> None:
    lost_db = attenuation_db(EAST_M, np.zeros((1, 2)), ANTENNA, MIN_RANGE_M)
    assert np.ravel(lost_db) == pytest.approx(ANTENNA.mean_rss_dbm(1.0) - MEAN_DBM, abs=1e-9)


def test_the_papers_compiled_product_follows_the_law() -> None:
    robots = np.array([[0.0, 0.0], [7.0, 1.0], [1.0, 12.0]])
    heard = Detection(
        0, ("a", "b", "c"), robots, np.zeros(3), np.array([-70.0, -83.0, np.nan]), np.zeros(3, dtype=bool)
    )
    exact = log_likelihood_exact(EAST_M, robots, heard.rss_dbm, ANTENNA, 0.25)
    assert PairwiseModel(ANTENNA, EAST_M, 0.25).log_likelihood(heard) == pytest.approx(exact, abs=1e-3)


def test_a_particles_weight_is_that_of_the_laws_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ParticleFilter, "_resample", lambda self: None)
    settings = EngineSettings(Grid(30.0, 30.0, 1.0), ANTENNA, (("a",),), (0.0,), expected_sources=1.0)
    cloud = CsmaBelief(settings).filter
    cloud.place, cloud.weight = EAST_M[:, None, :].copy(), np.full(RANGES_M.size, 1.0 / RANGES_M.size)
    reading_dbm = float(ANTENNA.mean_rss_dbm(4.0))
    cloud.update((0.0, 0.0, 0.0), 10.0 ** ((reading_dbm - ANTENNA.threshold_dbm) / 10.0), 1.0, 0.0)
    near = np.maximum(RANGES_M, cloud.strength.nearest_m)
    expected = norm.pdf(reading_dbm, ANTENNA.mean_rss_dbm(near), ANTENNA.sigma_db)
    assert cloud.weight == pytest.approx(expected / expected.sum(), abs=1e-9)


def test_surveys_and_calibration_have_the_laws_mean() -> None:
    theta = np.array([ANTENNA.power_at_1m_dbm, ANTENNA.path_loss_exponent, 0.0])
    place = np.column_stack([EAST_M, np.zeros(RANGES_M.size)])
    coefficients = np.array([*theta[:2], 0.0, 0.0, 0.0])
    assert design(place, np.zeros(3), MIN_RANGE_M) @ coefficients == pytest.approx(MEAN_DBM, abs=1e-9)
    level = _mean_level(np.zeros((1, 3)), coefficients[None], place, MIN_RANGE_M)
    assert level[0] == pytest.approx(MEAN_DBM, abs=1e-9)
    assert fitted_mean(theta, from_arrays(RANGES_M, MEAN_DBM)) == pytest.approx(MEAN_DBM, abs=1e-9)
