"""One source or two, where most of what is known of the first is marginalised: it counts for both hypotheses."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.channel.spread import assumed
from fieldkit.engine.belief.intensity import hypotheses
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from fieldkit.tuning import Tuning
from mission.lab.study.trust import antenna, known_power

RADIO = antenna()
FEW_OPEN = Tuning().with_tables({"intensity": {"max_open": 20}})
FIELD = EngineSettings(
    Grid(10.0, 10.0, 0.2), RADIO, (("a", "b"),), (-4.0, -2.0, 0.0), reference_rate_hz=0.1, tuning=FEW_OPEN
)
S = 1_000_000_000
PERIOD_S = 10


class Heard:
    """Two robots about a place, and what they hear; hypotheses are looked at after each transmission."""

    def __init__(self, seed: int, settings: EngineSettings = FIELD) -> None:
        self.belief, self.rng, self.t_s = IntensityBelief(settings), np.random.default_rng(seed), 0
        self.most = 0
        """Candidates with as many receptions as a find needs, at any time."""

    def go(self, periods: int, *sources: tuple[float, float]) -> None:
        """In each period one of them sends, in turn; robots are near all of them."""
        for k in range(periods):
            place = np.mean(sources, axis=0) + self.rng.uniform(-2.5, 2.5, (2, 2))
            self.belief.listen(Listening(self.t_s * S, (self.t_s + PERIOD_S) * S, ("a", "b"), place))
            self.t_s += PERIOD_S
            away = np.hypot(*(place - sources[k % len(sources)]).T)
            z = np.round(RADIO.mean_rss_dbm(away) + self.rng.normal(0.0, RADIO.sigma_db, 2))
            z = np.where(z > RADIO.threshold_dbm, z, np.nan)
            if not np.isnan(z).all():
                self.belief.detect(
                    Detection(self.t_s * S, ("a", "b"), place, np.zeros(2), z, np.zeros(2, bool))
                )
                while self.belief.reflect():
                    pass
            self.most = max(self.most, sum(c.receptions > 3.9 for c in self.belief.candidates))


@pytest.mark.parametrize("seed", range(4))
def test_one_source_stays_one_however_much_of_it_is_marginalised(seed: int) -> None:
    """Its marginalised evidence is sharper than the points on which hypotheses are compared are apart."""
    world = Heard(seed)
    world.go(150, (5.03, 5.03))
    (known,) = [c for c in world.belief.candidates if c.receptions > 3.9]
    assert known.frozen_receptions > 50.0
    assert world.most == 1
    east, north = world.belief.mixture.summary(known).mean_m
    assert np.hypot(east - 5.03, north - 5.03) < 0.3


def test_one_source_stays_one_where_places_are_taken_to_make_noise() -> None:
    """They do not here. Known by its strong packets alone, each place let its silence speak for a source far away."""
    world = Heard(0, replace(FIELD, spread=known_power(assumed(RADIO)), tuning=Tuning()))
    world.go(320, (5.03, 5.03))
    assert [source.state for source in world.belief.sources() if source.receptions > 3.9] == ["found"]
    assert world.most == 1


def found_at(seed: int, places: np.ndarray, *heard: int) -> bool:
    """Whether the candidates at the end are those, after so many periods of the first alone and of both."""
    world = Heard(seed)
    for periods, count in zip(heard, (1, 2), strict=True):
        world.go(periods, *map(tuple, places[:count]))
    means = [world.belief.mixture.summary(c).mean_m for c in world.belief.candidates if c.receptions > 3.9]
    return len(means) == 2 and bool(np.abs(np.array(sorted(map(tuple, means))) - places).max() < 0.5)


@pytest.mark.parametrize("heard", [(0, 200), (80, 120)])
def test_two_sources_are_two_though_most_of_both_is_marginalised(heard: tuple[int, int]) -> None:
    """Also where the second one begins to send when much of the first is marginalised.

    With so few kept open a rival that nobody believes in any more may be marginalised as well, now and then.
    """
    places = np.array([(4.0, 5.0), (6.25, 5.25)])
    assert sum(found_at(seed, places, *heard) for seed in range(6)) >= 5


def test_with_frozen_alone_leaves_nothing_but_what_is_marginalised() -> None:
    world = Heard(0)
    world.go(60, (5.0, 5.0))
    (known,) = [c for c in world.belief.candidates if c.receptions > 3.9]
    alone = known.with_frozen_alone()
    assert alone.receptions == pytest.approx(known.frozen_receptions) and not alone.logs
    again = hypotheses._with_frozen(world.belief.mixture, known, dict(known.responsibility))
    again.set_responsibilities(list(known.responsibility), list(known.responsibility.values()))
    assert again.receptions == pytest.approx(known.receptions)
    np.testing.assert_allclose(again.evidence, known.evidence, rtol=1e-9)


def test_what_is_marginalised_was_not_sent_from_another_sources_place() -> None:
    """Hundreds of receptions rule out another place by hundreds of nats: else far sources become one after hours."""
    world = Heard(0)
    world.go(200, (4.0, 5.0), (6.5, 5.0))
    one, other = (c for c in world.belief.candidates if c.receptions > 3.9)
    for here, there in ((one, other), (other, one)):
        theirs, taken = there.frozen(), here.copy()
        before = taken.log_evidence()
        taken._add_frozen(there, theirs)
        assert taken.log_evidence() - before < theirs.max() - 3.0 * there.frozen_receptions
