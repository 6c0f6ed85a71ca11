"""A lone robot that circles with a radio that hears far: what it can know of a place, and what it cannot.

Over a circle the distances to a point and to its mirror image, at radius^2 / distance on the same ray, have a constant
ratio (Apollonius): with the power unknown by 10 beta log10(radius / distance) dB nothing that is heard on the circle
tells the two apart. A belief must hold both for possible.
"""

from dataclasses import replace

import numpy as np
import pytest
from sizes import size

from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import assumed, known_power
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening

RADIO = Antenna(2.5, -50.0, 3.0, -85.0)
MIDDLE, RADIUS_M, SIDE_M = np.array([20.0, 20.0]), 10.0, 40.0
SOURCE = MIDDLE + np.array([3.0, 4.0])
MIRROR = MIDDLE + np.array([3.0, 4.0]) * (RADIUS_M / 5.0) ** 2
S = 1_000_000_000


def circled(*, power_known: bool, seed: int, packets: int = 40) -> IntensityBelief:
    spread = replace(assumed(RADIO), receiver_db=0.0)
    belief = IntensityBelief(
        EngineSettings(
            Grid(SIDE_M, SIDE_M, 1.0),
            RADIO,
            (("a",),),
            spread=known_power(spread) if power_known else spread,
            reference_rate_hz=0.5,
        )
    )
    rng = np.random.default_rng(seed)
    for k in range(packets):
        angle = 2.0 * 2.0 * k / RADIUS_M / 2.0
        place = MIDDLE + RADIUS_M * np.array([np.sin(angle), np.cos(angle)])
        belief.listen(Listening(2 * k * S, 2 * (k + 1) * S, ("a",), place[None]))
        z = RADIO.mean_rss_dbm(float(np.hypot(*(place - SOURCE)))) + rng.normal(0.0, RADIO.sigma_db)
        if np.round(z) > RADIO.threshold_dbm:
            heard = np.array([np.round(z)])
            belief.detect(Detection(2 * k * S, ("a",), place[None], np.zeros(1), heard, np.zeros(1, bool)))
    return belief


def test_on_a_circle_a_place_and_its_mirror_image_are_alike_but_for_the_power() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = MIDDLE + RADIUS_M * np.column_stack([np.sin(angle), np.cos(angle)])
    near, far = (RADIO.mean_rss_dbm(np.hypot(*(circle - place).T)) for place in (SOURCE, MIRROR))
    assert near - far == pytest.approx(np.full(100, 25.0 * np.log10(RADIUS_M / 5.0)), abs=1e-9)


@pytest.mark.parametrize("seed", size([0], [0, 1, 2]))
def test_with_the_power_known_a_circle_gives_one_source_in_its_place(seed: int) -> None:
    belief = circled(power_known=True, seed=seed)
    (source,) = [each for each in belief.sources() if each.receptions > 2.0]
    assert np.hypot(source.east_m - SOURCE[0], source.north_m - SOURCE[1]) < 2.5


@pytest.mark.parametrize("seed", size([0], [0, 1, 2]))
def test_with_the_power_unknown_neither_the_place_nor_its_mirror_image_is_ruled_out(seed: int) -> None:
    """One candidate, none found, and its posterior has the truth: re-estimating it does not cut its ground."""
    belief = circled(power_known=False, seed=seed)
    (source,) = [each for each in belief.sources() if each.receptions > 2.0]
    assert source.state != "found"
    (candidate,) = [each for each in belief.candidates if each.ident == source.ident]
    log = candidate.log_posterior().max(axis=0)
    for place in (SOURCE, MIRROR):
        near = np.hypot(*(candidate.points_m - place).T) < 2.5
        assert near.any() and log[near].max() > log.max() - 5.0
