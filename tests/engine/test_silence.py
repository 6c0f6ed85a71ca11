"""Sources that stop, and sources that move: last heard, the odds of the silence since, and what it is called."""

import numpy as np
import pytest

from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.candidate import merged_gain
from fieldkit.engine.belief.intensity.merging import merge
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from mission.lab.study.trust import antenna

RADIO = antenna()
FIELD = EngineSettings(Grid(12.0, 12.0, 0.5), RADIO, (("a", "b"),), (0.0,), reference_rate_hz=0.05)
S = 1_000_000_000
PERIOD_S = 20


class Searched:
    """Two robots about a place; a transmission every `PERIOD_S` where a source is."""

    def __init__(self, seed: int = 1) -> None:
        self.belief, self.rng, self.t_s = IntensityBelief(FIELD), np.random.default_rng(seed), 0

    def go(self, periods: int, about: tuple[float, float], source: tuple[float, float] | None) -> None:
        for _ in range(periods):
            place = np.array(about) + self.rng.uniform(-1.2, 1.2, (2, 2))
            self.belief.listen(Listening(self.t_s * S, (self.t_s + PERIOD_S) * S, ("a", "b"), place))
            self.t_s += PERIOD_S
            if source is not None:
                z = RADIO.mean_rss_dbm(np.hypot(*(place - source).T)) + self.rng.normal(0.0, 3.3, 2)
                z = np.where(np.round(z) > RADIO.threshold_dbm, np.round(z), np.nan)
                if not np.isnan(z).all():
                    self.belief.detect(
                        Detection(self.t_s * S, ("a", "b"), place, np.zeros(2), z, np.zeros(2, bool))
                    )
            self.belief.reflect()


def test_a_find_that_falls_silent_is_flagged_within_ten_of_its_own_periods() -> None:
    world = Searched()
    world.go(12, (6.0, 6.0), (6.0, 6.0))
    (found,) = [each for each in world.belief.sources() if each.state == "found"]
    assert "silent" not in found.note and found.last_heard_ns == world.t_s * S
    world.go(10, (6.0, 6.0), None)
    (found,) = [each for each in world.belief.sources() if each.state == "found"]
    assert "gone silent: last heard 200 s ago" in found.note and found.silence_odds < 0.01


def test_silence_where_nobody_listens_says_nothing() -> None:
    world = Searched()
    world.go(12, (3.0, 3.0), (3.0, 3.0))
    world.go(30, (10.5, 10.5), None)
    (found,) = [each for each in world.belief.sources() if each.state == "found"]
    assert "silent" not in found.note and found.silence_odds > 0.5


def test_one_that_moved_keeps_both_places_and_says_so() -> None:
    world = Searched()
    world.go(12, (3.0, 6.0), (3.0, 6.0))
    world.go(10, (3.0, 6.0), None)
    world.go(12, (9.0, 6.0), (9.0, 6.0))
    old, new = [each for each in world.belief.sources() if each.receptions > 3.0]
    assert f"may have moved: source {new.ident} at" in old.note and "silent" not in new.note
    assert abs(old.east_m - 3.0) < 1.0 and abs(new.east_m - 9.0) < 1.0


def test_two_equal_candidates_are_one_even_after_their_detections_were_frozen() -> None:
    world = Searched()
    world.go(16, (6.0, 6.0), (6.0, 6.0))
    mixture = world.belief.mixture
    (first,) = [each for each in mixture.candidates if each.receptions > 3.0]
    twin = first.copy()
    twin.ident = mixture.next_ident()
    half = {number: share / 2.0 for number, share in first.responsibility.items()}
    for candidate in (first, twin):
        candidate.set_responsibilities(list(half), list(half.values()))
        for number in list(half)[:6]:
            candidate.forget(number)
    mixture.candidates.append(twin)
    assert twin.frozen_receptions > 1.0
    together = first.receptions + twin.receptions
    assert merged_gain(first, twin) > 0.0
    assert merge(mixture)
    (left,) = [each for each in mixture.candidates if each.receptions > 3.0]
    assert left.receptions == pytest.approx(together, rel=1e-6)
