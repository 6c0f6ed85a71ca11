"""Pairs that talk only in range: they end up knowing what one computer would have known."""

import numpy as np
import pytest

from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection
from fieldkit.world.sources import random_sources
from mission.lab.study.apart import Ring, Train, Walk, search_apart
from mission.lab.study.dprwa import trial
from mission.lab.study.experiment import Job
from mission.lab.study.prwa import LEVELS_DB, engine

HIDDEN = tuple(random_sources(3, 25.0, 25.0, LEVELS_DB, 0.05, np.random.default_rng(5)))


def start(robots: int) -> np.ndarray:
    return np.array([(2.0 + 1.6 * k, 1.0) for k in range(robots)])


class Noting(SpogBelief):
    """A belief that notes what it was told; all of them in `made`."""

    made: list["Noting"] = []  # noqa: RUF012

    def __init__(self, settings: EngineSettings) -> None:
        super().__init__(settings)
        self.told: list[Detection] = []
        self.states: list[bytes] = []
        Noting.made.append(self)

    def detect(self, detection: Detection) -> None:
        super().detect(detection)
        self.told.append(detection)
        self.states.append(self.digest())


@pytest.mark.parametrize(
    ("motion", "robots"), [("ring", 8), ("ring", 6), ("ring", 2), ("walk", 8), ("train", 8)]
)
def test_all_pairs_go_through_the_same_beliefs_bit_for_bit(motion: str, robots: int) -> None:
    settings = engine(3, robots)
    Noting.made = []
    movers = {"ring": Ring(settings), "walk": Walk(settings), "train": Train(settings, 6.0)}
    result = search_apart(settings, movers[motion], HIDDEN, start(robots), 3, 2500.0, 6.0, Noting)
    told = sorted(Noting.made, key=lambda belief: len(belief.told))
    assert len(told) == robots // 2
    longest = told[-1]
    assert len(longest.told) > 10
    for other in told:
        assert other.states == longest.states[: len(other.states)]
    central = SpogBelief(settings)  # one computer that is told all at once
    for detection, state in zip(longest.told, longest.states, strict=True):
        central.detect(detection)
        assert central.digest() == state
    assert result.detections >= len(longest.told)


def test_the_train_always_knows_all_and_holds_nearly_nothing() -> None:
    settings = engine(1, 8)
    train = search_apart(settings, Train(settings, 6.0), HIDDEN, start(8), 1, 1500.0, 6.0)
    walk = search_apart(settings, Walk(settings), HIDDEN, start(8), 1, 1500.0, 6.0)
    assert max(train.lag_s[20:]) == 0.0
    assert train.most_held < walk.most_held
    assert np.mean(walk.lag_s) > 10.0


def test_a_wider_range_shortens_the_lag_of_the_ring() -> None:
    settings = engine(2, 8)
    near, far = (
        search_apart(settings, Ring(settings), HIDDEN, start(8), 2, 2000.0, range_m)
        for range_m in (2.0, 15.0)
    )
    assert np.mean(far.lag_s) < np.mean(near.lag_s)
    assert max(near.lag_s) < 1500.0, "the ring sees to a checkpoint in every period, however short the range"


def test_a_trial_is_repeatable() -> None:
    first, again = (trial(Job("dprwa-fig3c", "dprwa", 2, 4)) for _ in range(2))
    assert first["value"] == again["value"] and first["most_held"] == again["most_held"]
    held = trial(Job("dprwa-fig3a", "pair-patrol", 6, 4))
    assert held["value"] == held["most_held"]
