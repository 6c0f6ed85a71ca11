"""Readings that scatter wider than the antenna file says widen what is claimed of all sources; it is said once."""

import numpy as np
import pytest

from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening

RADIO = Antenna(2.5, -50.0, 3.0, -85.0)
ROBOTS = ("a", "b", "c")
FIELD = EngineSettings(Grid(20.0, 20.0, 0.5), RADIO, (ROBOTS,), (0.0,))
SOURCE = np.array([9.0, 11.0])
S = 1_000_000_000


def heard(sigma_db: float, seed: int) -> tuple[IntensityBelief, list[str]]:
    """After forty packets, by three robots anywhere around, whose readings scatter by `sigma_db`; what was said."""
    belief, rng, said = IntensityBelief(FIELD), np.random.default_rng(seed), []
    for k in range(40):
        place = rng.uniform(4.0, 16.0, (3, 2))
        z = np.round(RADIO.mean_rss_dbm(np.hypot(*(place - SOURCE).T)) + rng.normal(0.0, sigma_db, 3))
        z = np.where(z > RADIO.threshold_dbm, z, np.nan)
        belief.listen(Listening(20 * k * S, 20 * (k + 1) * S, ROBOTS, place))
        belief.detect(Detection(20 * k * S, ROBOTS, place, np.zeros(3), z, np.zeros(3, bool)))
        said += belief.said()
    return belief, said


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_as_the_antenna_file_says_widens_nothing_to_speak_of(seed: int) -> None:
    belief, said = heard(3.0, seed)
    assert max(each.wider for each in belief.candidates) < 1.25
    assert not any("scatter" in words for words in said)


@pytest.mark.parametrize("seed", [1, 2])
def test_wider_noise_widens_the_claim_as_much_and_is_said_once(seed: int) -> None:
    belief, said = heard(4.5, seed)
    (source,) = [each for each in belief.sources() if each.receptions > 10.0]
    (candidate,) = [each for each in belief.candidates if each.ident == source.ident]
    assert 1.3 < candidate.wider < 2.25
    assert sum("scatter" in words for words in said) == 1
    claimed = source.cov_m2
    candidate.wider = 1.0
    belief.mixture.forget_summary(candidate)
    sharp = belief.mixture.summary(candidate).cov_m2
    assert np.trace(claimed) > 1.2 * np.trace(sharp)


def test_a_posterior_that_is_not_wider_is_claimed_as_it_is() -> None:
    belief, _ = heard(3.0, 1)
    (candidate,) = [each for each in belief.candidates if each.receptions > 10.0]
    candidate.wider = 1.0
    np.testing.assert_array_equal(candidate.claimed_posterior(), candidate.posterior())
    candidate.wider = 2.0
    flatter = candidate.posterior() ** 0.5
    np.testing.assert_allclose(candidate.claimed_posterior(), flatter / flatter.sum(), atol=1e-12)
