"""Directional antennas: against the reference values, and the laws a reading's probability keeps."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from fieldkit.channel.antenna_file import AntennaFile, with_pattern
from fieldkit.channel.model import Antenna
from fieldkit.channel.pattern import lobe_gain_db
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood.directional import (
    FORMS,
    DirectionalModel,
    bearing_rad,
    log_reading,
    separation_m,
)
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.messages import Detection
from fieldkit.tuning import Tuning

VECTORS = {
    v["id"]: v
    for v in json.loads((Path(__file__).parent.parent / "golden" / "single_robot.json").read_text())[
        "vectors"
    ]
}
FLOOR_DB = -20.0 * np.log10(np.cos(np.radians(80.0)))


def rwa_antenna(step_deg: float = 1.0) -> Antenna:
    """RWA section IV.A: c = 63.09 (18 dBm at one unit of distance), beta 2.53, sigma 3.3, d_a one unit."""
    gains = lobe_gain_db(np.arange(0.0, 360.0, step_deg), 0.0, 4.0, FLOOR_DB)
    c_dbm = 10.0 * np.log10(63.09)
    return Antenna(2.53, float(c_dbm), 3.3, -90.0, pattern_db=tuple(gains.tolist()), alike_within_m=1.0)


def test_mean_readings_match_the_reference() -> None:
    vector = VECTORS["mu_tro"]
    antenna = rwa_antenna()
    for (distance, off_deg), expected in zip(vector["input"]["cases"], vector["expect"], strict=True):
        mean = antenna.mean_rss_dbm(distance) + antenna.gain_db(off_deg, distance)
        assert float(mean) == pytest.approx(expected, abs=1e-9)


def test_bearings_match_the_reference() -> None:
    vector = VECTORS["bearing"]
    names = {"recommended": "", "tro_printed": "rwa", "icra_printed": "rwa-2009"}
    for (x, y, theta), (cx, cy), k in zip(
        vector["input"]["pose"], vector["input"]["cell"], (0, 1), strict=True
    ):
        for name, printed in names.items():
            ours = float(bearing_rad(x, y, theta, cx, cy, printed=printed))
            assert ours == pytest.approx(vector["expect"][name][k], abs=1e-9)


def test_the_truncated_form_stays_exact_where_the_printed_quotient_is_nought_over_nought() -> None:
    vector = VECTORS["icra_8bit"]
    i = vector["input"]
    ours = float(log_reading(i["z"], i["mu"], i["sigma"], 1, 255, "truncated"))
    assert ours == pytest.approx(vector["expect"]["log"], abs=1e-9)


@given(mu=st.floats(-130.0, 0.0), form=st.sampled_from([f for f in FORMS if f != "interval"]))
def test_probabilities_of_all_readings_sum_to_one(mu: float, form: str) -> None:
    every = [float(log_reading(z, mu, 3.3, -95, -40, form)) for z in range(-95, -39)]  # type: ignore[arg-type]
    # RWA-2009 truncates at the integers themselves, so its two end cells are halves.
    assert np.exp(every).sum() == pytest.approx(1.0, abs=1e-9)


@given(mu=st.floats(-90.0, -45.0), z=st.integers(-94, -41))
def test_the_interval_form_is_equation_9(mu: float, z: int) -> None:
    expected = norm.cdf(z + 0.5, mu, 3.3) - norm.cdf(z - 0.5, mu, 3.3)
    assert float(np.exp(log_reading(z, mu, 3.3, -95, -40, "interval"))) == pytest.approx(expected, abs=1e-12)


def test_the_two_sigma_rule_separates_readings_by_two_sigma() -> None:
    d = separation_m(3.3, 2.53, FLOOR_DB)
    antenna = rwa_antenna()
    side = antenna.mean_rss_dbm(d) + antenna.gain_db(90.0)
    assert float(antenna.mean_rss_dbm(1.0)) - float(side) == pytest.approx(2 * 3.3)


def detection(heading_deg: float, rss_dbm: float) -> Detection:
    return Detection(
        0,
        ("r",),
        np.array([[5.0, 5.0]]),
        np.array([heading_deg]),
        np.array([rss_dbm]),
        np.zeros(1, dtype=bool),
    )


def test_a_strong_reading_says_ahead_and_a_turn_of_the_robot_turns_the_belief() -> None:
    grid = Grid(10.0, 10.0, 0.5)
    model = DirectionalModel(rwa_antenna(), (0.0,), grid.centres_m, 0.25)
    east = model.log_likelihood(detection(90.0, 3.0)).reshape(grid.shape)
    north = model.log_likelihood(detection(0.0, 3.0)).reshape(grid.shape)
    row, column = np.unravel_index(int(np.argmax(east)), east.shape)
    assert grid.east_m[column] > 6.0 and abs(grid.north_m[row] - 5.0) < 1.0
    assert np.rot90(north) == pytest.approx(east, abs=1e-6)


def test_an_antenna_without_a_pattern_is_refused_for_directional_sensing() -> None:
    plain = Antenna(2.53, 18.0, 3.3, -90.0)
    grid = Grid(4.0, 4.0, 0.5)
    with pytest.raises(ConfigError, match="radiation pattern"):
        SpogBelief(EngineSettings(grid, plain, (("r",),), sensing="directional"))
    turned = IntensityBelief(
        EngineSettings(grid, rwa_antenna(), (("r",),))
    )  # it knows headings, and refuses nothing
    assert turned.mixture.ears.pattern_db.size == len(rwa_antenna().pattern_db) > 0
    with pytest.raises(ConfigError, match="expected one of levels"):
        EngineSettings(grid, plain, (("r",),), sensing="sideways")
    with pytest.raises(ConfigError, match="calibrate with headings"):
        with_pattern(AntennaFile(plain))
    with pytest.raises(ConfigError, match="expected one of interval"):
        DirectionalModel(rwa_antenna(), (0.0,), grid.centres_m, 0.25, "eq9")  # type: ignore[arg-type]


@pytest.mark.parametrize("rule", ["literal", "uniform", "dirichlet"])
def test_two_events_on_nine_cells_match_the_reference(rule: str) -> None:
    vector = VECTORS["spog_3x3"]
    tuning = Tuning().with_tables({"paper_beliefs": {"dirichlet_alpha": 1.0}})
    antenna = Antenna(2.5, -40, 3.3, -90)
    settings = EngineSettings(Grid(1.5, 1.5, 0.5), antenna, (("r",),), prior_rule=rule, tuning=tuning)
    belief = SpogBelief(settings)
    belief.update(np.log(vector["input"]["L1"]))
    assert belief.presence().ravel() == pytest.approx(vector["expect"]["P1"], abs=1e-9)
    if rule == "literal":
        assert np.exp(belief.log_prior) == pytest.approx(vector["expect"]["q1"], abs=1e-9)
    if rule == "dirichlet":
        assert np.exp(belief.log_prior) == pytest.approx(vector["expect"]["w1_rate_K0=1"], abs=1e-9)
    belief.update(np.log(vector["input"]["L2"]))
    name = {"literal": "P2_literal", "uniform": "P2_uniform", "dirichlet": "P2_rate_K0=1"}[rule]
    assert belief.presence().ravel() == pytest.approx(vector["expect"][name], abs=1e-9)
    if rule == "literal":
        assert np.exp(belief.log_prior) == pytest.approx(vector["expect"]["q2_literal"], abs=1e-9)
