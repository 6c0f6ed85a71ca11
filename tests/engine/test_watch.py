"""Receivers against each other: a shifted one is corrected, an insensitive one's silence left out; both are named."""

from dataclasses import replace

import numpy as np
import pytest
from sizes import size

from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import assumed
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.watch import Measured, mean_of
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening

RADIO = Antenna(2.5, -50.0, 3.0, -85.0)
ROBOTS = ("a", "b", "c")
FIELD = EngineSettings(Grid(20.0, 20.0, 0.5), RADIO, (("a", "b"), ("c",)), (0.0,))
SOURCE = np.array([9.0, 11.0])
S = 1_000_000_000


def heard(
    seed: int, *, offset_db=(0.0, 0.0, 0.0), insensitive: str = "", packets: int = 40, power_db: float = 0.0
):
    belief, rng, said = IntensityBelief(FIELD), np.random.default_rng(seed), []
    for k in range(packets):
        place = rng.uniform(4.0, 16.0, (3, 2))
        z = RADIO.mean_rss_dbm(np.hypot(*(place - SOURCE).T), power_db) + rng.normal(0.0, 3.0, 3)
        z = np.where(np.round(z) > RADIO.threshold_dbm, np.round(z) + offset_db, np.nan)
        z = np.where(np.array(ROBOTS) == insensitive, np.nan, z)
        belief.listen(Listening(20 * k * S, 20 * (k + 1) * S, ROBOTS, place))
        belief.detect(Detection(20 * k * S, ROBOTS, place, np.zeros(3), z, np.zeros(3, bool)))
        said += belief.said()
    return belief, said


@pytest.mark.parametrize("seed", range(size(2, 6)))
def test_nothing_is_said_of_receivers_that_are_alike(seed: int) -> None:
    assert heard(seed)[1] == []


@pytest.mark.parametrize("offset_db", [6.0, -8.0])
def test_a_shifted_receiver_is_named_and_its_offset_learnt(offset_db: float) -> None:
    belief, said = heard(1, offset_db=(0.0, offset_db, 0.0), packets=60)
    named = [text for text in said if "reports" in text]
    assert named[0].startswith("b: reports ") and not any(text.startswith(("a", "c")) for text in named)
    assert belief.mixture.watch.of["b"].offset_db == pytest.approx(offset_db, abs=2.0)
    assert belief.mixture.ears.receivers["b"].offset_db == belief.mixture.watch.of["b"].offset_db


def standing(seed: int, *, place_db: float = 5.0, packets: int = 80):
    """Receivers that stand still in a field with shadowing: what each place adds is in all its readings."""
    belief, rng, said = IntensityBelief(FIELD), np.random.default_rng(seed), []
    place = rng.uniform(4.0, 16.0, (3, 2))
    shadow_db = rng.normal(0.0, place_db, 3)
    for k in range(packets):
        z = RADIO.mean_rss_dbm(np.hypot(*(place - SOURCE).T)) + shadow_db + rng.normal(0.0, 1.0, 3)
        belief.listen(Listening(20 * k * S, 20 * (k + 1) * S, ROBOTS, place))
        belief.detect(Detection(20 * k * S, ROBOTS, place, np.zeros(3), np.round(z), np.zeros(3, bool)))
        said += belief.said()
    return belief, said


@pytest.mark.parametrize("seed", range(size(4, 12)))
def test_a_place_is_not_taken_for_the_receivers_that_stand_there(seed: int) -> None:
    belief, said = standing(seed)
    assert not any("are taken off its readings" in text for text in said)
    assert all(its.offset_db == 0.0 for its in belief.mixture.watch.of.values())


def test_the_means_variance_is_that_of_readings_drawn_from_the_model() -> None:
    """Against plain simulation: a receiver that met two sources from three places, two of them near each other."""
    spread = replace(assumed(RADIO), sigma_time_db=2.0, sigma_place_db=4.0, lobe_db=0.0, correlation_m=3.0)
    rng = np.random.default_rng(4)
    at = np.array([[0.0, 0.0], [1.0, 1.0], [9.0, 0.0]])[[0, 0, 0, 1, 1, 2, 2, 2, 0, 1]]
    source = np.array([0, 0, 0, 0, 0, 0, 1, 1, 1, 1])
    apart = np.hypot(*(at[:, None] - at).T)
    cov = 16.0 * np.exp(-apart / 3.0) * (source[:, None] == source) + 4.0 * np.eye(10)
    drawn = rng.multivariate_normal(np.zeros(10), cov, 40_000).mean(axis=1)
    measured = [Measured(1.0, 0.0, *place, who) for place, who in zip(at, source, strict=True)]
    mean = mean_of(measured, spread)
    assert mean.mean_db == 1.0 and mean.variance_db2 == pytest.approx(drawn.var(), rel=0.03)


def test_an_insensitive_receiver_is_named_and_its_silence_left_out() -> None:
    belief, said = heard(1, insensitive="c")
    assert said == [text for text in said if text.startswith("c: heard 0 of ")] and len(said) == 1
    before = belief.exposure_s.sum()
    belief.listen(Listening(0, 100 * S, ("c",), np.array([[5.0, 5.0]])))
    assert belief.exposure_s.sum() == before
    last = list(belief.mixture.open.values())[-1].detection
    assert "c" not in last.robots


def test_an_insensitive_receiver_that_hears_again_counts_again() -> None:
    belief, said = heard(1, insensitive="c")
    rng = np.random.default_rng(9)
    for k in range(80):
        place = rng.uniform(4.0, 16.0, (3, 2))
        z = np.round(RADIO.mean_rss_dbm(np.hypot(*(place - SOURCE).T)) + rng.normal(0.0, 3.0, 3))
        belief.detect(Detection((2000 + k) * S, ROBOTS, place, np.zeros(3), z, np.zeros(3, bool)))
        said += belief.said()
    assert any(text.startswith("c: hears again") for text in said)
    assert not belief.mixture.watch.of["c"].insensitive


def test_sources_that_all_read_stronger_than_was_told_are_said_once() -> None:
    belief, rng, said = IntensityBelief(FIELD), np.random.default_rng(2), []
    for k in range(60):
        place = rng.uniform(1.0, 19.0, (3, 2))
        source = np.array([[5.0, 6.0], [15.0, 13.0]][k % 2])
        z = np.round(RADIO.mean_rss_dbm(np.hypot(*(place - source).T), 8.0) + rng.normal(0.0, 3.0, 3))
        belief.listen(Listening(20 * k * S, 20 * (k + 1) * S, ROBOTS, place))
        belief.detect(Detection(20 * k * S, ROBOTS, place, np.zeros(3), z, np.zeros(3, bool)))
        said += belief.said()
    common = [text for text in said if "beyond the power levels" in text]
    assert len(common) == 1 and "+8 dB" in common[0]


def test_receivers_heard_no_more_keep_their_offset_and_others_are_compared_with_them() -> None:
    belief, _ = heard(1, offset_db=(0.0, 6.0, 0.0), packets=60)
    learnt = belief.mixture.watch.offsets_db()
    assert learnt.keys() == {"b"}
    belief.part_with_robots()
    assert not belief.mixture.watch.of and belief.mixture.watch.offsets_db() == learnt
    rng, said, names = np.random.default_rng(2), [], ("d", "e", "f")
    for k in range(60, 120):  # another day, and another receiver that reads too much
        place = rng.uniform(4.0, 16.0, (3, 2))
        z = RADIO.mean_rss_dbm(np.hypot(*(place - SOURCE).T)) + rng.normal(0.0, 3.0, 3)
        z = np.where(np.round(z) > RADIO.threshold_dbm, np.round(z) + np.array([0.0, 6.0, 0.0]), np.nan)
        belief.listen(Listening(20 * k * S, 20 * (k + 1) * S, names, place))
        belief.detect(Detection(20 * k * S, names, place, np.zeros(3), z, np.zeros(3, bool)))
        said += belief.said()
    assert belief.mixture.watch.of.keys() == set(names)
    assert any(text.startswith("e: reports ") for text in said) and not any(text[0] in "abc" for text in said)
    assert belief.mixture.watch.offsets_db()["b"] == learnt["b"]
    assert belief.mixture.ears.receivers["b"].offset_db == learnt["b"]
