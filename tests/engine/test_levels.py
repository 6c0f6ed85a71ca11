"""The exact likelihood: against a plain scipy twin, normalisation, and the laws of hearing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st
from scipy.stats import norm

from fieldkit.channel.antenna_file import Receiver
from fieldkit.channel.model import MIN_RANGE_M, Antenna
from fieldkit.engine.likelihood import levels_loops
from fieldkit.engine.likelihood.ears import Ears
from fieldkit.engine.likelihood.levels import LevelsModel
from fieldkit.messages import Detection
from fieldkit.tuning import LikelihoodTuning
from fieldkit.world.channel import sample_rss_dbm

RADIO = LikelihoodTuning()

ANTENNA = Antenna(2.53, -62.0, 3.3, -70.0, -36.0)
LEVELS = (-8.0, -4.0, 0.0)


def detection(
    rss: list[float], position: list[tuple[float, float]], saturated: list[bool] | None = None
) -> Detection:
    m = len(rss)
    return Detection(
        0,
        tuple(f"r{i}" for i in range(m)),
        np.array(position, dtype=float),
        np.zeros(m),
        np.array(rss, dtype=float),
        np.array(saturated or [False] * m),
    )


def twin(model: LevelsModel, d: Detection, point: np.ndarray, level_dbm: float) -> float:
    """log p by scipy, robot by robot, straight from the module's docstring."""
    total = 0.0
    for place, rss, saturated in zip(d.position_m, d.rss_dbm, d.saturated, strict=True):
        distance = max(float(np.hypot(*(place - point))), MIN_RANGE_M)
        mean = level_dbm - 25.3 * np.log10(distance)
        smear = 25.3 / np.log(10) * model.place_sigma_m / np.hypot(distance, model.place_sigma_m)
        sigma = np.hypot(3.3, smear)
        if np.isnan(rss):
            p = RADIO.packet_loss + (1 - RADIO.packet_loss) * norm.cdf(-70.0 + 0.5, mean, sigma)
        elif saturated:
            p = (1 - RADIO.packet_loss) * (
                (1 - RADIO.outliers) * norm.sf(rss - 0.5, mean, sigma)
                + RADIO.outliers * norm.sf(rss - 0.5, mean, RADIO.outlier_width * sigma)
            )
        else:
            wide = np.sqrt(sigma**2 + 1 / 12)
            p = (1 - RADIO.packet_loss) * (
                (1 - RADIO.outliers) * norm.pdf(rss, mean, wide)
                + RADIO.outliers * norm.pdf(rss, mean, RADIO.outlier_width * wide)
            )
        total += np.log(p)
    return total


def test_kernel_agrees_with_a_plain_twin() -> None:
    model = LevelsModel(ANTENNA, LEVELS, 0.05)
    d = detection([-60.0, np.nan, -36.0], [(1.0, 1.0), (4.0, 1.0), (1.5, 1.6)], [False, False, True])
    points = np.random.default_rng(0).uniform(0, 5, (40, 2))
    log = model.log_likelihood(d, points)
    for h, level in enumerate(model.level_dbm):
        assert log[h] == pytest.approx([twin(model, d, p, level) for p in points], abs=1e-4)


def test_varying_hypothesis_is_the_mean_over_the_known_levels() -> None:
    model = LevelsModel(ANTENNA, LEVELS, 0.05)
    log = model.log_likelihood(detection([-65.0], [(0.0, 0.0)]), np.array([[1.0, 1.0]]))
    assert np.exp(log[-1]) == pytest.approx(np.exp(log[:3]).mean(axis=0))


def test_all_outcomes_of_one_robot_sum_to_one() -> None:
    """Silence and every integer reading up to the ceiling, at one place and level."""
    model = LevelsModel(Antenna(2.53, -62.0, 3.3, -70.0), LEVELS, 0.01)
    point = np.array([[0.9, 0.0]])
    silent = np.exp(model.log_likelihood(detection([np.nan], [(0, 0)]), point)[2, 0])
    heard = sum(
        np.exp(model.log_likelihood(detection([float(z)], [(0, 0)]), point)[2, 0]) for z in range(-69, 0)
    )
    assert silent + heard == pytest.approx(1.0, abs=0.004)


@budget(max_examples=30)
@given(power=st.sampled_from(LEVELS), distance=st.floats(0.2, 3.0))
def test_hearing_probability_matches_the_simulated_channel(power: float, distance: float) -> None:
    model = LevelsModel(ANTENNA, LEVELS, 0.001)
    rng = np.random.default_rng(1)
    heard = ~np.isnan(sample_rss_dbm(ANTENNA, np.full(4000, distance), power, rng))
    predicted = float(np.exp(model.log_hear(np.array(distance), np.array(-62.0 + power)))) / (
        1 - RADIO.packet_loss
    )
    assert heard.mean() == pytest.approx(predicted, abs=0.04)


def test_exposure_kernel_agrees_with_a_plain_twin() -> None:
    model = LevelsModel(ANTENNA, LEVELS, 0.05)
    robots = np.array([[1.0, 2.0], [3.0, 2.5]])
    exposure = np.zeros((model.level_dbm.size, 20, 30))
    levels_loops.add_exposure(exposure, 0.2, robots, model.hear, model.step2_m2, model.limit2_m2, 2.0)
    north, east = np.meshgrid((np.arange(20) + 0.5) * 0.2, (np.arange(30) + 0.5) * 0.2, indexing="ij")
    silent = np.ones_like(exposure)
    for place in robots:
        distance = np.hypot(east - place[0], north - place[1])
        silent *= 1.0 - np.exp(model.log_hear(distance[None], model.level_dbm[:, None, None]))
    assert exposure == pytest.approx(2.0 * (1.0 - silent), abs=0.04)


def test_louder_is_heard_further() -> None:
    assert ANTENNA.nominal_range_m(0.0) / ANTENNA.nominal_range_m(-8.0) == pytest.approx(10 ** (8 / 25.3))


def test_a_radio_far_more_sensitive_than_the_calibrated_one_makes_no_error() -> None:
    """What the others hear from nearer than the common table resolves counts as not heard."""
    levels = (-40.0, 0.0)
    ears = Ears(ANTENNA, receivers={"r1": Receiver(offset_db=60.0)})
    model = LevelsModel(ANTENNA, levels, 0.1, ears=ears)
    assert model.limit2_m2[0] == 0.0 < model.limit2_m2[-1]
