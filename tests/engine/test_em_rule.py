"""SPOG's mixture weights: the compiled sweeps against plain numpy, and what happens when there are too many events."""

import numpy as np
import pytest

from fieldkit.channel.model import Antenna
from fieldkit.engine.belief import spog_loops
from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.tuning import Tuning


def test_compiled_sweeps_are_em() -> None:
    rng = np.random.default_rng(0)
    likelihood, pi = rng.uniform(0, 1, (30, 50)) ** 6, np.full(50, 0.02)
    floor, settled = rng.uniform(0, 0.1, 50), -rng.uniform(0, 1, 50)
    expected = pi.copy()
    for _ in range(4):
        share = likelihood * expected
        share /= share.sum(axis=1, keepdims=True)
        expected = (floor + share.sum(axis=0)) / 31.0
    ours = pi.copy()
    spog_loops.em_sweeps(likelihood, floor, 31.0, 4, ours)
    assert ours == pytest.approx(expected, rel=1e-10)
    share = likelihood * expected
    share /= share.sum(axis=1, keepdims=True)
    absent = np.empty(50)
    spog_loops.em_absent(likelihood, ours, settled, absent)
    assert absent == pytest.approx(settled + np.log1p(-share).sum(axis=0), rel=1e-9)


def test_events_beyond_the_limit_keep_their_last_attribution() -> None:
    few = Tuning().with_tables({"paper_beliefs": {"max_events": 20}})
    belief = SpogBelief(
        EngineSettings(Grid(5.0, 5.0, 0.5), Antenna(2.5, -50, 3.3, -70), (("a",),), tuning=few)
    )
    rng = np.random.default_rng(1)
    for _ in range(100):
        log = np.full(100, -30.0)
        log[[17, 83][int(rng.integers(2))]] = 0.0
        belief.update(log)
        assert belief._stored <= 21
    assert np.exp(belief.log_prior).sum() == pytest.approx(1.0, abs=0.02)
    assert set(np.flatnonzero(belief.presence().ravel() > 0.9)) == {17, 83}
