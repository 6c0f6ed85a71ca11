"""Theorem 1 against the reference values, its laws, and the compiled kernel against its plain twin."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldkit.channel.model import Antenna
from fieldkit.engine.likelihood.pairwise import (
    RANGE_DB,
    PairwiseModel,
    attenuation_db,
    log_e10,
    log_e11,
    log_likelihood_exact,
    ratio_tables,
)
from fieldkit.engine.likelihood.pairwise_loops import BLOCK
from fieldkit.messages import Detection
from mission.lab.bench import pairwise_numpy, random_detection, settings

VECTORS = json.loads((Path(__file__).parent.parent / "golden" / "team.json").read_text())["vectors"]


def vectors(kind: str) -> list:
    return [pytest.param(v, id=v["id"]) for v in VECTORS if v["kind"] == kind]


@pytest.mark.parametrize("vector", vectors("E11"))
def test_both_heard_matches_the_reference(vector: dict) -> None:
    given_ = vector["inp"]
    x = np.array(given_["D_dB"] - given_["delta"])
    assert log_e11(x, given_["sigma"]) == pytest.approx(vector["logL"], abs=1e-9)
    assert np.exp(log_e11(x, given_["sigma"])) == pytest.approx(vector["L"], rel=1e-9)


@pytest.mark.parametrize("vector", vectors("E10"))
def test_one_heard_matches_the_reference_far_into_the_tail(vector: dict) -> None:
    given_ = vector["inp"]
    x = np.array(given_["D_dB"] - given_["delta"])
    assert log_e10(x, given_["sigma"]) == pytest.approx(vector["logL"], abs=1e-9)
    assert np.exp(log_e10(x, given_["sigma"])) == pytest.approx(vector["L"], rel=1e-9)


@pytest.mark.parametrize("vector", vectors("D"))
def test_difference_of_attenuation_matches_the_reference(vector: dict) -> None:
    g = vector["inp"]
    radio = Antenna(g["beta"], 0.0, 3.3, -90.0)
    a = attenuation_db(np.array([g["cell"]]), np.array([g["p"], g["q"]]), radio, g["dmin"])
    assert a[1, 0] - a[0, 0] == pytest.approx(vector["D_dB"], abs=1e-9)


@pytest.mark.parametrize("vector", vectors("theorem1_loglik_unnormalised"))
def test_theorem_1_matches_the_reference(vector: dict) -> None:
    g = vector["inp"]
    rss = np.array(g["z"], dtype=float)
    rss[rss <= g["zeta"]] = np.nan
    antenna = Antenna(g["beta"], 0.0, g["sigma"], g["zeta"])
    log = log_likelihood_exact(np.array(g["cells"]), np.array(g["robots"]), rss, antenna, g["dmin"])
    assert log == pytest.approx(vector["logL"], abs=1e-9)


def test_doubling_the_range_loses_ten_beta_log_two() -> None:
    a = attenuation_db(
        np.array([[1.0, 0.0], [2.0, 0.0]]), np.zeros((1, 2)), Antenna(2.53, 0.0, 3.3, -90.0), 0.25
    )
    assert a[0, 1] - a[0, 0] == pytest.approx(10 * 2.53 * np.log10(2.0))


@given(x=st.floats(-100, 100), sigma=st.floats(0.5, 12))
def test_terms_are_probabilities(x: float, sigma: float) -> None:
    assert log_e11(np.array(x), sigma) <= 1e-12
    assert log_e10(np.array(x), sigma) <= 1e-12


def test_a_silent_partner_far_away_says_nothing_and_one_nearby_much() -> None:
    assert log_e10(np.array(200.0), 3.3) == pytest.approx(0.0, abs=1e-12)
    assert log_e10(np.array(-40.0), 3.3) < -30.0


@pytest.mark.parametrize("hearing", [1, 2, 4, 6])
def test_compiled_kernel_agrees_with_plain_numpy_and_with_the_exact_terms(hearing: int) -> None:
    engine = settings()
    points = engine.grid.centres_m
    for seed in range(5):
        detection = random_detection(engine, np.random.default_rng(seed), hearing)
        fast = PairwiseModel(engine.antenna, points, 0.25).log_likelihood(detection)
        exact = log_likelihood_exact(points, detection.position_m, detection.rss_dbm, engine.antenna, 0.25)
        assert fast == pytest.approx(
            pairwise_numpy(points, detection, engine.antenna, 0.25, by_table=True), rel=1e-9, abs=1e-9
        )
        near = exact > exact.max() - 40
        assert np.abs(fast - exact)[near].max() < 1e-4


def test_ratios_beyond_the_table_are_taken_for_its_ends() -> None:
    antenna = Antenna(2.53, -50.0, 3.3, -90.0)
    octaves, _, both, one = ratio_tables(antenna.sigma_db, antenna.path_loss_exponent)
    for rss, expected in ((1e4, one[0]), (-1e4, one[-1])):
        heard = Detection(
            0, ("a", "b"), np.zeros((2, 2)), np.zeros(2), np.array([rss, np.nan]), np.zeros(2, dtype=bool)
        )
        log = PairwiseModel(antenna, np.array([[3.0, 4.0]]), 0.25).log_likelihood(heard)
        assert log == pytest.approx([expected], rel=1e-9)
    assert 5.0 * 2.53 * np.log10(2.0) * octaves >= RANGE_DB
    assert both[0] == pytest.approx(both[-1], rel=1e-9)  # even in x


@pytest.mark.parametrize("cells", [1, 7, BLOCK, BLOCK + 1])
def test_a_cell_says_the_same_whatever_cells_stand_beside_it(cells: int) -> None:
    engine = settings()
    points = engine.grid.centres_m[:cells]
    detection = random_detection(engine, np.random.default_rng(4), 3)
    whole = PairwiseModel(engine.antenna, engine.grid.centres_m, 0.25).log_likelihood(detection)
    part = PairwiseModel(engine.antenna, points, 0.25).log_likelihood(detection)
    assert (part == whole[:cells]).all()


def test_order_of_robots_does_not_matter() -> None:
    engine = settings()
    d = random_detection(engine, np.random.default_rng(3), 3)
    order = np.array([4, 2, 0, 5, 1, 3])
    shuffled = Detection(
        0,
        tuple(d.robots[i] for i in order),
        d.position_m[order],
        d.heading_deg[order],
        d.rss_dbm[order],
        d.saturated,
    )
    model = PairwiseModel(engine.antenna, engine.grid.centres_m, 0.25)
    exact = [
        log_likelihood_exact(engine.grid.centres_m, x.position_m, x.rss_dbm, engine.antenna, 0.25)
        for x in (d, shuffled)
    ]
    assert exact[1] == pytest.approx(exact[0], abs=1e-9)
    assert model.log_likelihood(shuffled) == pytest.approx(model.log_likelihood(d), abs=1e-4)
