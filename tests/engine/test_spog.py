"""SPOG against the reference values, and the laws its prior rules keep or break."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.belief.spog_loops import add_shares
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood.pairwise import log_likelihood_exact
from fieldkit.errors import ConfigError
from mission.lab.bench import random_detection, settings, spog_numpy

VECTORS = json.loads((Path(__file__).parent.parent / "golden" / "team.json").read_text())["vectors"]
TWO_EVENTS = [pytest.param(v, id=v["id"]) for v in VECTORS if v["kind"] == "spog_two_events"]


@pytest.mark.parametrize("vector", TWO_EVENTS)
def test_two_events_match_the_reference(vector: dict) -> None:
    g = vector["inp"]
    rule = {"dir": "dirichlet"}.get(g["prior_rule"], g["prior_rule"])
    base = settings(prior_rule=rule)
    antenna = Antenna(g["beta"], 0.0, g["sigma"], g["zeta"])
    belief = SpogBelief(replace(base, grid=Grid(2.0, 1.5, 0.5), antenna=antenna))
    for event, expected in zip(g["events"], vector["after"], strict=True):
        rss = np.array(event["z"], dtype=float)
        rss[rss <= g["zeta"]] = np.nan
        before = np.exp(belief.log_prior)
        log = log_likelihood_exact(np.array(g["cells"]), np.array(event["robots"]), rss, antenna, g["dmin"])
        belief.update(log)
        p1 = np.exp(log) * before
        assert p1 / p1.sum() == pytest.approx(expected["P1"], abs=1e-9)
        assert belief.presence().ravel() == pytest.approx(expected["P"], abs=1e-9)


def test_compiled_update_agrees_with_plain_numpy() -> None:
    engine = settings()
    belief = SpogBelief(engine)
    detection = random_detection(engine, np.random.default_rng(0), 3)
    p1, log_absent = spog_numpy(
        engine.grid.centres_m,
        detection,
        engine,
        belief.log_prior.copy(),
        belief.log_absent.copy(),
        by_table=True,
    )
    belief.detect(detection)
    assert belief.log_absent == pytest.approx(log_absent, abs=1e-9)
    assert p1.sum() == pytest.approx(1.0)


@pytest.mark.parametrize("sharpness", [0.0, 1.0, 30.0, 800.0])
def test_compiled_shares_agree_with_plain_numpy_from_a_flat_belief_to_a_certain_one(sharpness: float) -> None:
    rng = np.random.default_rng(5)
    weight, log_absent, sums = np.exp(-sharpness * rng.random(4000)), -rng.random(4000), rng.random(4000)
    weight[17] = 1.0
    share = weight / weight.sum()
    expected = log_absent + np.log1p(-np.minimum(share, 1.0 - 1e-16)), sums + share
    add_shares(weight, float(weight.sum()), log_absent, sums)
    assert weight == pytest.approx(share, rel=1e-14)
    assert log_absent == pytest.approx(expected[0], rel=1e-12, abs=1e-15)
    assert sums == pytest.approx(expected[1], rel=1e-14)


def test_literal_rule_forgets_the_first_of_two_sources_and_em_does_not() -> None:
    """Eq 2 as printed multiplies likelihoods of different sources' transmissions; mixture weights do not."""
    shape = Grid(10.0, 10.0, 0.5)
    log_a, log_b = np.full(400, -20.0), np.full(400, -20.0)
    log_a[50], log_b[350] = 0.0, 0.0
    weight = {}
    for rule in ("literal", "em"):
        belief = SpogBelief(replace(settings(prior_rule=rule), grid=shape))
        for _ in range(6):
            belief.update(log_a)
            belief.update(log_b)
        belief.update(log_b)
        weight[rule] = belief.activity().ravel()[50]
    assert weight["literal"] < 1e-6
    assert weight["em"] > 0.3


@pytest.mark.parametrize("rule", ["literal", "uniform", "dirichlet"])
def test_presence_never_falls_without_reattribution(rule: str) -> None:
    engine = settings(prior_rule=rule)
    belief = SpogBelief(engine)
    rng = np.random.default_rng(2)
    before = belief.presence()
    for _ in range(10):
        belief.detect(random_detection(engine, rng, 2))
        assert (belief.presence() >= before - 1e-12).all()
        before = belief.presence()


def test_a_confident_cell_is_reported_as_found_with_its_place() -> None:
    belief = SpogBelief(replace(settings(prior_rule="em"), grid=Grid(10.0, 10.0, 0.5)))
    log = np.full(400, -30.0)
    log[5 * 20 + 7] = 0.0
    for _ in range(4):
        belief.update(log)
    (found,) = belief.sources()
    assert (found.east_m, found.north_m) == pytest.approx((3.75, 2.75))
    assert found.state == "found"


def test_unknown_rule_is_refused() -> None:
    with pytest.raises(ConfigError, match="prior_rule"):
        SpogBelief(settings(prior_rule="guess"))
