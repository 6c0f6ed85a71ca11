"""Sources that stop, and sources that move: last heard, the odds of the silence since, and what it is called."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fieldkit.engine.belief.intensity import silence
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.candidate import merged_gain
from fieldkit.engine.belief.intensity.merging import _may_be_one, merge
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.infogain import InfoGainPlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from fieldkit.tuning import Tuning
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


def test_where_one_has_gone_silent_others_may_sleep_and_little_can_be_said_of_what_is_left() -> None:
    world = Searched()
    world.go(12, (6.0, 6.0), (6.0, 6.0))
    before, words = world.belief.probability_left(), world.belief.left_words()
    world.go(9, (6.0, 6.0), None)  # that may be chance
    assert silence.expected_asleep(world.belief.mixture, world.belief._silent) == 0.0
    world.go(21, (6.0, 6.0), None)
    assert world.belief.probability_left() >= 1.0 - (1.0 - before) * np.exp(-FIELD.expected_sources) - 0.05
    assert "silent" not in words and "of those known 1 went silent" in world.belief.left_words()
    world.go(12, (9.0, 6.0), (9.0, 6.0))  # it has moved: nobody sleeps
    assert silence.expected_asleep(world.belief.mixture, world.belief._silent) == 0.0


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


def test_packets_that_another_may_have_sent_do_not_end_a_silence() -> None:
    world = Searched()
    world.go(12, (3.0, 6.0), (3.0, 6.0))
    moved_s = world.t_s
    world.go(20, (4.6, 6.0), (6.2, 6.0))
    old = min(world.belief.sources(), key=lambda each: abs(each.east_m - 3.0))
    assert "gone silent" in old.note and old.last_heard_ns <= (moved_s + 2 * PERIOD_S) * S


@pytest.mark.parametrize("shared", [0, 1, 3])
def test_a_silence_is_as_probable_as_rates_and_shared_packets_make_it(
    shared: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rates that are well known: gone on or ended differ by exp(-rate * time) and (old + new) / new for each packet."""
    old_hz, new_hz, then_s, since_s = 0.05, 0.08, 1e7, 100.0
    share = old_hz / (old_hz + new_hz)
    sure = dict.fromkeys(range(5), 0.999999)
    responsibility = sure | {5 + number: share for number in range(shared)}
    candidate = SimpleNamespace(
        responsibility=responsibility,
        receptions=old_hz * then_s + shared * share,
        first_ns=0,
        last_ns=4 * S,
        exposure_then_s=then_s,
        listened_at={number: then_s + 1e-9 * number for number in responsibility},
    )
    mixture = SimpleNamespace(
        open={
            number: SimpleNamespace(detection=SimpleNamespace(t_ns=number * S)) for number in responsibility
        },
        rate_prior_s=1e-6,
        tuning=SimpleNamespace(rate_shape=1e-6, claimed=0.5),
    )
    monkeypatch.setattr(silence, "listened_s", lambda *_: then_s + since_s)
    said = silence.silence(mixture, candidate)  # type: ignore[arg-type]
    expected = np.exp(-old_hz * since_s) * ((old_hz + new_hz) / new_hz) ** shared
    assert said.since_ns == 4 * S and said.odds == pytest.approx(min(1.0, expected), rel=1e-2)


def test_a_find_that_nobody_has_listened_to_for_long_is_visited_again() -> None:
    world = Searched()
    world.go(12, (3.0, 3.0), (3.0, 3.0))
    (found,) = [each for each in world.belief.sources() if each.state == "found"]
    assert not world.belief.unresolved(8, np.random.default_rng(0))
    world.go(30, (10.5, 10.5), None)
    (again,) = world.belief.unresolved(8, np.random.default_rng(0))
    assert again.ident == found.ident and 0.1 < again.p_gone < 0.3
    nothing_to_search = Tuning().with_tables({"infogain": {"ground_value": 0.0}})
    planner = InfoGainPlanner(replace(FIELD, tuning=nothing_to_search))
    at = {"a": (10.0, 10.5), "b": (11.0, 10.5)}
    plan = planner.plan(Situation(world.t_s * S, at, (("a", "b"),), {}), world.belief)
    assert plan.purpose["a"] == f"resolve {found.ident}"


def test_two_equal_candidates_are_one_even_after_their_detections_were_frozen() -> None:
    world = Searched()
    world.go(16, (6.0, 6.0), (6.0, 6.0))
    mixture = world.belief.mixture
    (first,) = [each for each in mixture.candidates if each.receptions > 3.0]
    twin = first.copy()
    twin.ident = mixture.next_ident()
    whole = dict(first.responsibility)
    for candidate, part in ((first, 0.45), (twin, 0.55)):  # the newcomer is the larger one
        candidate.set_responsibilities(list(whole), [part * share for share in whole.values()])
        for number in list(whole)[:6]:
            candidate.forget(number)
    mixture.candidates.append(twin)
    assert twin.frozen_receptions > 1.0
    mixture.revise_at = {first.ident: 40.0}
    together = first.receptions + twin.receptions
    assert merged_gain(first, twin) > 0.0
    assert [each.ident for each in merge(mixture)] == [twin.ident]
    assert mixture.revise_at[twin.ident] == 40.0, "divided and one again: not to be divided at once"
    (left,) = [each for each in mixture.candidates if each.receptions > 3.0]
    assert left.receptions == pytest.approx(together, rel=1e-6)


def known(ident: int, first_s: float) -> SimpleNamespace:
    return SimpleNamespace(ident=ident, first_ns=int(first_s * S), receptions=9.0)


def silent_mixture(quiet_s: dict[int, float], stay_s: float = 3600.0) -> SimpleNamespace:
    return SimpleNamespace(
        candidates=[known(ident, 0.0) for ident in quiet_s],
        now_ns=2000 * S,
        stay_s=stay_s,
        settings=SimpleNamespace(min_receptions=3),
        tuning=Tuning().intensity,
    )


def test_the_longer_ago_one_was_heard_the_shorter_a_silence_tells_that_it_has_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quiet_s = {1: 900.0, 2: 90.0}
    mixture = silent_mixture(quiet_s)
    monkeypatch.setattr(
        silence,
        "silence",
        lambda _, each: silence.Silence(int((2000.0 - quiet_s[each.ident]) * S), 0.02),
    )
    assert silence.gone_silent(mixture) == {1}  # type: ignore[arg-type]


def test_where_sources_go_others_are_expected_to_go_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mean of 1 / rate's Gamma, worked out by counting simulated pasts that agree with what was seen."""
    mixture = silent_mixture({1: 0.0, 2: 0.0, 3: 800.0})
    monkeypatch.setattr(silence, "silence", lambda _, each: silence.Silence(1200 * S, 1.0))
    rng = np.random.default_rng(4)
    rate_hz = rng.exponential(1.0 / 3600.0, 400_000)
    ends = rng.exponential(1.0, (3, rate_hz.size)) / rate_hz
    stayed = (ends[0] > 2000.0) & (ends[1] > 2000.0)
    none_gone = stayed & (ends[2] > 1200.0)
    one_gone = stayed & (ends[2] > 1150.0) & (ends[2] < 1250.0)
    with_none = silence.mean_stay_s(mixture, {})  # type: ignore[arg-type]
    with_one = silence.mean_stay_s(mixture, {3: 1200 * S})  # type: ignore[arg-type]
    assert with_one == pytest.approx(1.0 / rate_hz[one_gone].mean(), rel=0.05)
    mixture.candidates = mixture.candidates[:2]
    stayed_s = silence.mean_stay_s(mixture, {})  # type: ignore[arg-type]
    assert stayed_s == pytest.approx(1.0 / rate_hz[stayed].mean(), rel=0.05)
    assert with_one < stayed_s < with_none
    assert none_gone.sum() < stayed.sum()


def test_two_that_have_come_close_are_looked_at_though_not_much_was_heard_since() -> None:
    mixture = SimpleNamespace(places=object(), merge_at={})
    one, other = SimpleNamespace(ident=1, receptions=40.0), SimpleNamespace(ident=2, receptions=40.0)
    assert _may_be_one(mixture, one, other, False) and not _may_be_one(mixture, one, other, False)
    assert _may_be_one(mixture, one, other, True) and not _may_be_one(mixture, one, other, True)
    one.receptions = 49.0
    assert _may_be_one(mixture, one, other, False)
