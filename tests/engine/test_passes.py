"""Passes over what a new packet can have changed, against passes over everything."""

import numpy as np
import pytest

from fieldkit.engine.belief.intensity import passes
from fieldkit.engine.belief.intensity.arena import Arena
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.responsibilities import Attribution, attribute
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from fieldkit.tuning import IntensityTuning
from fieldkit.world.channel import sample_rss_dbm
from mission.lab.study.trust import antenna
from tests.engine.test_attribution import some_candidates

RADIO = antenna()
S = 1_000_000_000
SOURCES_M = np.array([[6.0, 6.0], [30.0, 8.0], [8.0, 31.0], [32.0, 30.0]])
"""So far apart that nothing is heard of two of them at one place."""


def searched(packets: int) -> IntensityBelief:
    """Two robots that drive from source to source, hearing a few packets of each in turn."""
    belief = IntensityBelief(
        EngineSettings(Grid(38.0, 38.0, 0.5), RADIO, (("a", "b"),), (0.0,), reference_rate_hz=0.05)
    )
    rng, now_ns = np.random.default_rng(3), 0
    for packet in range(packets):
        source_m = SOURCES_M[packet // 3 % len(SOURCES_M)]
        while True:
            at_m = source_m + rng.normal(0.0, 1.5, (2, 2))
            belief.listen(Listening(now_ns, now_ns + 5 * S, ("a", "b"), at_m))
            now_ns += 5 * S
            rss_dbm = sample_rss_dbm(RADIO, np.hypot(*(at_m - source_m).T), 0.0, rng)
            if not np.isnan(rss_dbm).all():
                break
        belief.detect_all(
            [Detection(now_ns, ("a", "b"), at_m, np.zeros(2), rss_dbm, np.zeros(2, dtype=bool))]
        )
        while belief.reflect():
            pass
    return belief


def test_a_packet_concerns_what_its_own_source_sent_and_nothing_else() -> None:
    mixture = searched(36).mixture
    newest = max(mixture.open)
    concerned = passes.concerned(mixture, [newest])
    here_m = mixture.open[newest].near_m.mean(axis=0)
    away_m = {n: np.hypot(*(each.near_m.mean(axis=0) - here_m)) for n, each in mixture.open.items()}
    assert newest in concerned and 6 <= len(concerned) <= 14
    assert max(away_m[number] for number in concerned) < 12.0
    assert sum(away < 12.0 for away in away_m.values()) == len(concerned)


def test_what_is_believed_is_what_passes_over_everything_lead_to(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "LITTLE_WORK", 0)
    local = searched(48)
    assert not local.mixture.unswept, "what was left alone is looked at when nothing is heard"
    monkeypatch.setattr(passes, "SHARE", 0.0)
    monkeypatch.setattr(passes, "concerned", lambda mixture, new: list(mixture.open))
    monkeypatch.setattr("fieldkit.engine.belief.intensity.mixture.concerned", passes.concerned)
    monkeypatch.setattr(
        "fieldkit.engine.belief.intensity.mixture.shares_of", lambda candidate: list(candidate.responsibility)
    )
    whole = searched(48)
    ours = sorted((each.east_m, each.north_m) for each in local.sources())
    theirs = sorted((each.east_m, each.north_m) for each in whole.sources())
    assert len(ours) == len(theirs) == len(SOURCES_M)
    np.testing.assert_allclose(ours, theirs, atol=0.02)
    assert local.probability_left() == pytest.approx(whole.probability_left(), abs=0.01)


def test_who_has_little_of_a_detection_keeps_it_and_the_others_share_the_rest() -> None:
    candidates = some_candidates(np.random.default_rng(5), 4, 6)
    numbers = list(range(6))
    for candidate in candidates[:2]:
        for number in candidate.responsibility:
            candidate.set_responsibility(number, 4e-4)
    before = [dict(candidate.responsibility) for candidate in candidates]
    attribute(
        candidates[0].arena if candidates else Arena(),
        candidates,
        numbers,
        np.full(6, -14.0),
        np.full(6, -18.0),
        lambda: np.full(4, 50.0),
        IntensityTuning().rate_shape,
        20.0,
        Attribution(np.ones(6), np.full(6, -18.0)),
        passes=2,
        least_share=1e-3,
    )
    assert [candidate.responsibility for candidate in candidates[:2]] == before[:2]
    assert any(candidates[2].responsibility[n] != before[2][n] for n in candidates[2].responsibility)
    for number in numbers:
        shares = [candidate.responsibility.get(number, 0.0) for candidate in candidates]
        assert sum(shares) <= 1.0 + 1e-9
