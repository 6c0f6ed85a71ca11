"""The default belief: what it must find, what it must not claim, and the symmetries it keeps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st

from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from fieldkit.tuning import Tuning
from fieldkit.world.channel import sample_rss_dbm

ANTENNA = Antenna(2.53, -62.0, 3.3, -70.0)
LEVELS = (-8.0, -6.0, -4.0, -2.0, 0.0)
FIELD = EngineSettings(
    Grid(8.0, 8.0, 0.2), ANTENNA, (("a", "b"),), LEVELS, reference_rate_hz=0.1, expected_sources=2.0
)


def hear(
    truth: tuple[float, float],
    power_db: float,
    robots: np.ndarray,
    rng: np.random.Generator,
    antenna: Antenna = ANTENNA,
) -> Detection | None:
    """One transmission as the channel gives it to robots (m, 2); None when nobody heard."""
    rss = sample_rss_dbm(antenna, np.hypot(*(robots - truth).T), power_db, rng)
    if np.isnan(rss).all():
        return None
    m = len(robots)
    return Detection(0, tuple(f"r{i}" for i in range(m)), robots, np.zeros(m), rss, np.zeros(m, bool))


def pairs_near(truth: tuple[float, float], rng: np.random.Generator, spread_m: float = 1.0) -> np.ndarray:
    """A pair of robots somewhere round a point."""
    centre = np.array(truth) + rng.normal(0.0, spread_m, 2)
    angle = rng.uniform(0, 2 * np.pi)
    half = 0.35 * np.array([np.cos(angle), np.sin(angle)])
    return np.array([centre - half, centre + half])


def feed(
    belief: IntensityBelief, sources: list, rng: np.random.Generator, rounds: int, **options: object
) -> None:
    for _ in range(rounds):
        for place, power in sources:
            heard = hear(place, power, pairs_near(place, rng), rng, **options)  # type: ignore[arg-type]
            if heard is not None:
                belief.detect(heard)


def test_one_source_is_found_where_it_is() -> None:
    belief = IntensityBelief(FIELD)
    feed(belief, [((3.1, 4.3), -4.0)], np.random.default_rng(0), 25)
    (found,) = [s for s in belief.sources() if s.state == "found"]
    assert np.hypot(found.east_m - 3.1, found.north_m - 4.3) < 0.25
    assert found.p_here > 0.9
    assert 0.1 < found.power_db + 8.0 < 8.0


def test_two_sources_two_cells_apart_stay_two() -> None:
    sources = [((3.0, 4.0), 0.0), ((3.45, 4.0), 0.0)]
    belief = IntensityBelief(FIELD)
    feed(belief, sources, np.random.default_rng(5), 30)
    found = [s for s in belief.sources() if s.state == "found"]
    assert len(found) == 2
    assert sorted(s.east_m for s in found) == pytest.approx([3.0, 3.45], abs=0.25)


def test_two_sources_that_cannot_be_told_apart_yet_are_kept_in_mind() -> None:
    sources = [((3.0, 4.0), 0.0), ((3.5, 4.0), 0.0)]
    belief, rng = IntensityBelief(FIELD), np.random.default_rng(4)
    for _ in range(8):
        for place, power in sources:
            heard = hear(place, power, pairs_near(place, rng, 0.8), rng)
            if heard is not None:
                belief.detect(heard)
    (one,) = belief.sources()
    assert one.state == "found" and "may be two sources" in one.note
    assert [u.ident for u in belief.unresolved(8, np.random.default_rng(0))] == [one.ident], (
        "a planner is sent to see"
    )
    before = belief.probability_left()
    belief.candidates[0].two_source = None
    assert belief.probability_left() < before
    for _ in range(8):
        for place, power in sources:
            heard = hear(place, power, pairs_near(place, rng, 0.8), rng)
            if heard is not None:
                belief.detect(heard)
    found = [s for s in belief.sources() if s.state == "found"]
    assert sorted(s.east_m for s in found) == pytest.approx([3.0, 3.5], abs=0.25)


def test_three_receptions_from_one_side_are_not_a_find() -> None:
    belief = IntensityBelief(FIELD)
    rng = np.random.default_rng(1)
    robots = np.array([[2.0, 2.0], [2.7, 2.0]])
    for _ in range(3):
        heard = None
        while heard is None:
            heard = hear((3.5, 3.5), 0.0, robots, rng)
        belief.detect(heard)
    assert all(s.state == "candidate" for s in belief.sources())


def test_power_outside_the_levels_is_doubted_not_claimed() -> None:
    """Sources 12 dB louder than any level the belief was told of."""
    belief = IntensityBelief(FIELD)
    rng = np.random.default_rng(2)
    feed(belief, [((4.0, 4.0), 12.0)], rng, 25)
    assert not [
        s for s in belief.sources() if s.state == "found" and np.hypot(s.east_m - 4, s.north_m - 4) > 0.4
    ]
    assert any("does not explain" in s.note for s in belief.sources())


def test_silence_empties_the_ground_it_covers() -> None:
    belief = IntensityBelief(FIELD)
    before = belief.presence()
    left = belief.probability_left()
    belief.listen(Listening(0, 60_000_000_000, ("a", "b"), np.array([[2.0, 2.0], [2.7, 2.0]])))
    after = belief.presence()
    assert (after <= before + 1e-15).all()
    assert after[10, 10] < 0.2 * before[10, 10]
    assert after[35, 35] == pytest.approx(before[35, 35], rel=1e-3)
    assert belief.probability_left() < left


@budget(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), duration=st.floats(1.0, 100.0))
def test_more_silence_never_raises_a_cell_it_covers(seed: int, duration: float) -> None:
    belief = IntensityBelief(FIELD)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        belief.listen(Listening(0, round(duration * 1e9), ("a", "b"), rng.uniform(0, 8, (2, 2))))
        before = belief.presence()
        belief.listen(Listening(0, round(duration * 1e9), ("a", "b"), rng.uniform(0, 8, (2, 2))))
        assert (belief.presence() <= before + 1e-15).all()


def _story(transform: object) -> IntensityBelief:
    belief = IntensityBelief(replace(FIELD, grid=Grid(8.0, 8.0, 0.2)))
    rng = np.random.default_rng(7)
    for _ in range(8):
        robots = pairs_near((3.1, 4.3), rng)
        heard = hear((3.1, 4.3), -4.0, robots, rng)
        belief.listen(Listening(0, 5_000_000_000, ("a", "b"), transform(robots)))  # type: ignore[operator]
        if heard is not None:
            belief.detect(replace(heard, position_m=transform(heard.position_m)))  # type: ignore[operator]
    return belief


def test_a_quarter_turn_of_the_field_turns_the_belief() -> None:
    plain = _story(lambda p: p)
    turned = _story(lambda p: np.ascontiguousarray(np.column_stack([8.0 - p[:, 1], p[:, 0]])))
    (a,), (b,) = plain.sources(), turned.sources()
    assert (b.east_m, b.north_m) == pytest.approx((8.0 - a.north_m, a.east_m), abs=1e-6)
    assert np.rot90(turned.presence()) == pytest.approx(plain.presence(), abs=1e-6)


def test_the_order_of_robots_does_not_matter() -> None:
    def swapped(belief: IntensityBelief, flip: bool) -> IntensityBelief:
        rng = np.random.default_rng(3)
        for _ in range(8):
            heard = hear((3.0, 3.0), 0.0, pairs_near((3.0, 3.0), rng), rng)
            if heard is not None:
                order = [1, 0] if flip else [0, 1]
                belief.detect(
                    replace(
                        heard, position_m=heard.position_m[order].copy(), rss_dbm=heard.rss_dbm[order].copy()
                    )
                )
        return belief

    a, b = swapped(IntensityBelief(FIELD), False), swapped(IntensityBelief(FIELD), True)
    assert a.presence() == pytest.approx(b.presence(), abs=1e-9)


@budget(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    rss=st.lists(st.one_of(st.integers(-69, -20).map(float), st.just(float("nan"))), min_size=1, max_size=5),
)
def test_whatever_is_heard_the_belief_stays_a_probability(seed: int, rss: list[float]) -> None:
    belief = IntensityBelief(FIELD)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        if np.isnan(rss).all():
            continue
        m = len(rss)
        position = rng.uniform(-3.0, 11.0, (m, 2))  # robots may stand outside the field
        belief.detect(
            Detection(0, tuple(map(str, range(m))), position, np.zeros(m), np.array(rss), np.zeros(m, bool))
        )
        presence = belief.presence()
        assert np.isfinite(presence).all() and (presence >= 0).all() and (presence <= 1).all()
        assert belief.activity().sum() == pytest.approx(1.0)
        assert 0.0 <= belief.probability_left() <= 1.0


def test_a_field_of_one_cell_and_a_single_robot_work() -> None:
    belief = IntensityBelief(replace(FIELD, grid=Grid(0.2, 0.2, 0.2), teams=(("a",),)))
    belief.listen(Listening(0, 10**9, ("a",), np.array([[0.1, 0.1]])))
    belief.detect(
        Detection(0, ("a",), np.array([[0.1, 0.1]]), np.zeros(1), np.array([-50.0]), np.zeros(1, bool))
    )
    assert np.isfinite(belief.presence()).all()


def test_same_calls_give_the_same_digest_and_others_another() -> None:
    def told(seed: int) -> bytes:
        belief = IntensityBelief(FIELD)
        feed(belief, [((3.0, 4.0), 0.0)], np.random.default_rng(seed), 4)
        return belief.digest()

    assert told(1) == told(1)
    assert told(1) != told(2)


def test_cost_does_not_grow_with_the_number_of_detections() -> None:
    """Old detections are marginalised into their sources; the find stays, and so does its count."""
    few = Tuning().with_tables({"intensity": {"max_open": 20}})
    belief = IntensityBelief(replace(FIELD, tuning=few))
    feed(belief, [((3.0, 4.0), 0.0)], np.random.default_rng(4), 60)
    assert len(belief.mixture.open) <= 20
    (found,) = [s for s in belief.sources() if s.state == "found"]
    assert found.receptions > 40
    assert np.hypot(found.east_m - 3.0, found.north_m - 4.0) < 0.2
