"""The CSMA particle filter: it finds, it survives what its model rules out, and it is repeatable."""

import numpy as np
import pytest

from fieldkit.channel.model import Antenna
from fieldkit.engine.belief.csma import CsmaBelief
from fieldkit.engine.belief.particles import ParticleFilter, Strength
from fieldkit.engine.grid import Grid
from fieldkit.engine.likelihood.csma import dipole_gain
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.probable import ProbablePlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection
from fieldkit.world.channel import sample_rss_dbm

GAIN = dipole_gain(np.radians(np.arange(360.0)))


def a_filter(sources: int = 1, particles: int = 2000, seed: int = 0) -> ParticleFilter:
    strength = Strength(1e5, 2.0, GAIN, sigma_db=2.0)
    return ParticleFilter((100.0, 100.0), sources, strength, np.random.default_rng(seed), particles)


def reading(robot: tuple[float, float, float], source: tuple[float, float]) -> float:
    way = np.array(source) - robot[:2]
    gain = float(dipole_gain(np.arctan2(way[1], way[0]) - robot[2]))
    return max(1.0, np.floor(1e5 * np.hypot(*way) ** -2.0 * gain + 0.5))


def test_readings_from_all_sides_leave_the_particles_at_the_source() -> None:
    pf, rng = a_filter(), np.random.default_rng(1)
    for _ in range(40):
        robot = (float(rng.uniform(0, 100)), float(rng.uniform(0, 100)), float(rng.uniform(-3, 3)))
        pf.update(robot, reading(robot, (63.0, 27.0)), 1.0, 0.0)
    place = pf.most_probable(2.0)
    assert np.hypot(place[0] - 63.0, place[1] - 27.0) < 3.0
    assert pf.probability_near(place, 4.0) > 0.9


def test_an_impossible_reading_changes_nothing_and_weights_stay_a_distribution() -> None:
    pf = a_filter(sources=3, particles=200)
    before = pf.place.copy()
    pf.update((50.0, 50.0, 0.0), 1e30, 0.33, 0.0)
    assert pf.weight.sum() == pytest.approx(1.0) and np.isfinite(pf.weight).all()
    assert pf.place.shape == before.shape


def test_a_found_source_is_pinned_and_the_others_are_asked_anew() -> None:
    pf = a_filter(sources=3, particles=500)
    pf.identify((10.0, 20.0))
    assert (pf.place[:, 0] == (10.0, 20.0)).all()
    assert pf.place[:, 1:, 0].std() > 20.0
    pf.identify((30.0, 30.0))
    assert not pf.all_found
    pf.identify((40.0, 40.0))
    assert pf.all_found


def test_a_filter_without_sources_or_particles_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 1 source"):
        a_filter(sources=0)


def heard_at(
    place: tuple[float, float], engine: EngineSettings, rng: np.random.Generator
) -> Detection | None:
    robots = np.array(place) + rng.normal(0.0, 1.2, (2, 2))
    rss = sample_rss_dbm(engine.antenna, np.hypot(*(robots - place).T), 0.0, rng)
    if np.isnan(rss).all():
        return None
    return Detection(0, ("a", "b"), robots, np.zeros(2), rss, np.zeros(2, dtype=bool))


def test_as_a_belief_it_finds_one_source_and_the_planner_goes_there() -> None:
    engine = EngineSettings(
        Grid(8.0, 8.0, 0.4), Antenna(2.5, -60.0, 2.0, -80.0), (("a", "b"),), expected_sources=1.0, seed=4
    )
    belief, twin, rng = CsmaBelief(engine), CsmaBelief(engine), np.random.default_rng(2)
    assert belief.most_probable() is not None
    for _ in range(40):
        heard = heard_at((5.0, 3.0), engine, rng)
        if heard is not None:
            belief.detect(heard)
            twin.detect(heard)
    (found,) = belief.sources()
    assert np.hypot(found.east_m - 5.0, found.north_m - 3.0) < 0.8
    assert belief.probability_left() == 0.0 and belief.activity().sum() == pytest.approx(1.0)
    assert belief.digest() == twin.digest()
    situation = Situation(0, {"a": (1.0, 1.0), "b": (2.0, 1.0)}, engine.teams, {})
    assert set(ProbablePlanner(engine).plan(situation, belief).purpose.values()) == {"walk"}
    fresh = CsmaBelief(engine)
    assert set(ProbablePlanner(engine).plan(situation, fresh).purpose.values()) == {"probable"}
