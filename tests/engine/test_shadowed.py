"""Receptions of one place share a chance: what their number is worth under shadows that belong to places."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.belief.intensity import births, hypotheses
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.unknown import another_source, expected_unknown
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from mission.lab.study.trust import antenna

RADIO = antenna()
SPREAD = ChannelSpread(
    2.0, 6.0, 5.0, transmitter_db=0.1, transmitter_exponent=0.0, lobe_db=0.0, receiver_db=0.0
)
FIELD = EngineSettings(
    Grid(12.0, 12.0, 0.5),
    replace(RADIO, sigma_db=float(np.hypot(2.0, 6.0))),
    (("a", "b"),),
    (0.0,),
    reference_rate_hz=0.05,
    spread=SPREAD,
    found_within_m=1.0,
)
S = 1_000_000_000


def searched(packets: int, deeper_db: float = 0.0, *, packet_s: int = 20) -> IntensityBelief:
    """Two robots within a metre and a half of a source, whose shadow all about is so many dB deep."""
    belief, rng, source = IntensityBelief(FIELD), np.random.default_rng(1), np.array([6.0, 6.0])
    for k in range(packets):
        at = source + rng.uniform(-1.5, 1.5, (2, 2))
        belief.listen(Listening(k * packet_s * S, (k + 1) * packet_s * S, ("a", "b"), at))
        rss = RADIO.mean_rss_dbm(np.hypot(*(at - source).T)) - deeper_db + rng.normal(0.0, 2.0, 2)
        rss = np.where(np.round(rss) > RADIO.threshold_dbm, np.round(rss), np.nan)
        if not np.isnan(rss).all():
            belief.detect(
                Detection((k + 1) * packet_s * S, ("a", "b"), at, np.zeros(2), rss, np.zeros(2, bool))
            )
    return belief


def test_evidence_of_a_candidate_does_not_hang_on_how_much_ground_is_looked_at() -> None:
    # The median exposure of its ground once stood in for its own: hypotheses on wide ground lost by tens of nats.
    mixture = searched(12).mixture
    (known,) = mixture.candidates
    row0, row1, column0, column1 = mixture.grid.box_around(np.array([[6.0, 6.0]]), 2.5)
    near = births.new_candidate(mixture, (column0, column1), (row0, row1), spacing=1.0)
    wide = births.new_candidate(mixture, (0, mixture.grid.n_east), (0, mixture.grid.n_north), spacing=1.0)
    for candidate in (near, wide):
        candidate.rate_trust = 0.1
        candidate.expose(candidate.exposure_s)
        for number in known.responsibility:
            candidate.know(
                number, mixture.model.log_likelihood(mixture.open[number].detection, candidate.points_m)
            )
            candidate.set_responsibility(number, 1.0)
    away = np.abs(wide.points_m - 6.0).max(axis=1) > 2.0
    assert wide.posterior()[:, away].sum() < 0.01
    assert abs(near.log_evidence() - wide.log_evidence()) < 0.1


def test_a_hypothesis_is_estimated_with_the_trust_of_what_it_claims() -> None:
    # Trusted whole, a dozen packets of one place rule out true ground, and points once dropped do not come back.
    mixture = searched(12).mixture
    (known,) = mixture.candidates
    claimed = dict.fromkeys(known.responsibility, 1.0)
    fresh = hypotheses._fresh(mixture, known, claimed, most=500)
    assert len(claimed) >= 8 and fresh.rate_trust < 0.3
    assert np.ptp(fresh.log_exposure) < 0.3 * np.ptp(np.log(fresh.rate_prior_s + fresh.exposure_s)) + 1e-9


def test_packets_of_a_shadowed_source_find_no_more_than_one_other_beside_it() -> None:
    # Dozens seemed likely, each for the same packets, and planners searched round a find for the rest of the mission.
    belief = searched(40, deeper_db=6.0)
    assert [each.state for each in belief.sources()] == ["found"]
    mixture = belief.mixture
    whole, expected = float(another_source(mixture).sum()), float(expected_unknown(mixture).sum())
    mixture.open = {}
    unheard = float(expected_unknown(mixture).sum())
    assert unheard == pytest.approx(float(another_source(mixture).sum()))
    assert whole > unheard + 1.2
    assert unheard < expected < unheard + 0.9


def test_what_nobody_claims_is_one_source_wherever_it_may_be() -> None:
    mixture = searched(6).mixture
    for candidate in list(mixture.candidates):
        mixture.remove(candidate)
    mixture.explained = {number: stored.log_clutter for number, stored in mixture.open.items()}
    odds = another_source(mixture).sum(axis=0)
    expected = expected_unknown(mixture)
    mixture.open = {}
    heard = float(expected.sum() - expected_unknown(mixture).sum())
    assert odds.sum() > 1e9
    assert 0.9 < heard < 1.0 + 1e-6
    assert (expected <= odds * (1.0 + 1e-9)).all()
