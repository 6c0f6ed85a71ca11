"""One path-loss law: every place that writes it out, for speed or to fit it, agrees with `Antenna.mean_rss_dbm`.

These fail where the law is changed in one of them alone.
"""

import numpy as np
import pytest
from scipy.stats import norm

from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.engine.likelihood.pairwise import attenuation_db
from fieldkit.messages import Detection

ANTENNA = Antenna(2.53, -62.0, 3.3, -95.0)
RANGES_M = np.array([0.3, 0.7, 1.0, 1.9, 3.7, 6.1, 9.0, 14.0])
LEVELS_DB = (-6.0, 0.0, 3.0)


def test_the_nominal_range_is_where_the_mean_falls_to_the_threshold() -> None:
    for power_db in LEVELS_DB:
        range_m = ANTENNA.nominal_range_m(power_db)
        assert ANTENNA.mean_rss_dbm(range_m, power_db) == pytest.approx(ANTENNA.threshold_dbm, abs=1e-9)


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


def test_the_papers_attenuation_is_what_the_law_loses() -> None:
    points = np.column_stack([RANGES_M, np.zeros(RANGES_M.size)])
    lost_db = attenuation_db(points, np.zeros((1, 2)), ANTENNA.path_loss_exponent, MIN_RANGE_M)
    assert np.ravel(lost_db) == pytest.approx(
        ANTENNA.mean_rss_dbm(1.0) - ANTENNA.mean_rss_dbm(RANGES_M), abs=1e-9
    )
