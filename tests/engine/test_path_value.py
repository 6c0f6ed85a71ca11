"""What a path is worth: each place where a source may be by itself, power unknown, and other teams' ways."""

import numpy as np
import pytest

from fieldkit import plugins
from fieldkit.channel.model import MIN_RANGE_M
from fieldkit.engine.belief.base import Unresolved
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.planning import path_loops
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.infogain1 import ExpectedReward
from fieldkit.engine.planning.reward import Reward
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening
from mission.lab.bench import settings

HORIZON_S = 45.0
STEPS = 30
EARS = np.array([[0.0, 1.0, 0.0]] * 2)
PAIR = np.array([[-0.75, 0.0], [0.75, 0.0]])
"""A pair abreast, from its middle."""


def may_be(places: list[tuple[float, float]], sd_m: float = 1.0, **other: object) -> Unresolved:
    """A candidate of the middle power."""
    how = {"rate_hz": 0.05, "receptions": 4.0, "p_here": 0.3, "state": "candidate", "may_be_two": False}
    cov = np.eye(2) * sd_m**2
    return Unresolved(1, np.array(places), np.full(len(places), 2.0), cov, **(how | other))  # type: ignore[arg-type]


def standing(*places: tuple[float, float]) -> FloatArray:
    """(1, STEPS, 2, 2): a pair that stays with its middle at the mean of places for equal times."""
    held = np.repeat(np.array(places), STEPS // len(places), axis=0)
    return np.asarray(held[None, :, None] + PAIR[None, None])


def reward(
    *unresolved: Unresolved, engine: EngineSettings | None = None, kind: type[Reward] = Reward
) -> Reward:
    """Nothing on the ground, these candidates."""
    engine = engine or settings(sensing="levels")
    tuning = engine.tuning.infogain1 if kind is ExpectedReward else engine.tuning.infogain
    model = IntensityBelief(engine).model
    return kind(engine, tuning, model, np.zeros((50, 50)), 0.5, HORIZON_S, list(unresolved))


def test_what_is_learnt_is_what_plain_sums_say() -> None:
    model = IntensityBelief(settings(sensing="levels")).model
    rng = np.random.default_rng(1)
    tracks, points = rng.uniform(0.0, 6.0, (3, 5, 2, 2)), rng.uniform(0.0, 6.0, (4, 2))
    level = rng.integers(0, 5, 4).astype(float)
    ears = np.array([[0.0, 1.0, 0.0], [1.2, 1.3, 0.0]])
    ours = np.empty((3, 4, 7))
    path_loops.all_learnt(tracks, 1.5, points, level, model.hear, model.step2_m2, MIN_RANGE_M, ears, ours)
    plain = np.zeros((3, 4, 7))
    for track, sums in zip(tracks, plain, strict=True):
        for point, row, total in zip(points, level.astype(int), sums, strict=True):
            for robots in track:
                away = point - robots
                flat2 = (away**2).sum(axis=1)
                far2 = (flat2 + ears[:, 0] ** 2) * ears[:, 1]
                step = (far2 / model.step2_m2).astype(int)
                hears = model.hear[row, np.minimum(step, model.hear.shape[1] - 1)]
                hears = np.where(step < model.hear.shape[1] - 1, hears, 0.0)
                d2 = np.maximum(flat2 + ears[:, 0] ** 2, MIN_RANGE_M**2)
                e, n = away.T
                each = [e * e / d2**2, e * n / d2**2, n * n / d2**2, e / d2, n / d2, np.ones(2)]
                total[0] += 1.5 * (1.0 - np.prod(1.0 - hears))
                total[1:] += 1.5 * (hears * np.array(each)).sum(axis=1)
    assert ours == pytest.approx(plain, rel=1e-9)


def test_all_about_one_of_two_places_is_worth_less_than_enough_about_both() -> None:
    candidate = may_be([(10.0, 10.0), (13.0, 10.0)], sd_m=1.6)
    one_only, both = standing((10.0, 10.6)), standing((10.0, 10.6), (13.0, 10.6))
    value = reward(candidate).of(np.concatenate([one_only, both]), EARS)
    assert value[1] > value[0]


def test_a_power_that_is_not_known_asks_for_readings_from_several_sides() -> None:
    """With one power, readings from one side tell how far a source is; with several they tell little."""
    candidate = may_be([(10.0, 10.0)], sd_m=0.5)
    several = settings(sensing="levels")
    one = EngineSettings(several.grid, several.antenna, several.teams, (-4.0,), sensing="levels")
    tracks = np.concatenate([standing((10.0, 11.5)), standing((10.0, 11.5), (10.0, 8.5), (11.5, 10.0))])
    known = reward(may_be([(10.0, 10.0)], sd_m=0.5), engine=one)
    unknown = reward(candidate, engine=several)
    flat = np.zeros((2, 1, 7))
    flat[:, 0, 1:7] = [[0.0, 0.0, 20.0, 0.0, 20.0, 20.0], [0.0, 0.0, 20.0, 0.0, 0.0, 20.0]]
    # As much information about north: from one side, and from two.
    (_, _, from_one), (_, _, from_two) = (known._precision(candidate, each[None]) for each in flat)
    assert from_one == pytest.approx(from_two)
    (_, _, from_one), (_, _, from_two) = (unknown._precision(candidate, each[None]) for each in flat)
    assert (from_one < 0.8 * from_two).all()
    assert np.isfinite(unknown.of(tracks, EARS)).all()


def test_a_place_nearly_certain_keeps_a_team_until_one_more_packet_is_heard() -> None:
    """Nothing is left to be learnt of the place, but a find needs the reception."""
    candidate = may_be([(10.0, 10.0)], sd_m=0.15, p_here=0.93)
    near, far = standing((10.0, 10.6)), standing((18.0, 10.6))
    value = reward(candidate).of(np.concatenate([near, far]), EARS)
    before = reward(candidate, kind=ExpectedReward).of(np.concatenate([near, far]), EARS)
    assert value[0] > 2.0 and value[1] < 0.001
    assert before[0] < 0.5, "a stretch of ground not searched yet was worth as much"


def test_a_packet_that_two_teams_hear_counts_once_and_is_read_at_two_places() -> None:
    first, second = standing((10.0, 10.6)), standing((10.0, 8.5))
    for sd_m, least, most in ((0.05, 0.0, 0.1), (0.6, 0.3, 0.6)):  # a place that is known, one that is not
        candidate = may_be([(10.0, 10.0)], sd_m=sd_m)
        taken = reward(candidate)
        alone = taken.of(second, EARS)[0]
        taken.take(first[0], EARS)
        assert least * alone <= taken.of(second, EARS)[0] < most * alone
    candidate = may_be([(10.0, 10.0)], sd_m=0.6)
    alone = reward(candidate).of(second, EARS)[0]
    passing = reward(candidate)
    passing.take(standing((10.0, 10.6), *[(20.0, 20.0)] * 9)[0], EARS)
    assert passing.of(second, EARS)[0] > 0.5 * alone, "a team that only passes leaves the rest to others"


def test_a_find_is_listened_to_again_by_the_doubt_about_its_place_alone() -> None:
    near = standing((10.0, 10.6))
    sure, unsure = (
        reward(may_be([(10.0, 10.0)], sd_m=0.3, p_here=p, state="found")).of(near, EARS)[0]
        for p in (0.99, 0.9)
    )
    assert 0.0 < sure == pytest.approx(unsure / 10.0)
    assert unsure < 0.5 * reward(may_be([(10.0, 10.0)], sd_m=0.3)).of(near, EARS)[0]


def as_heard(engine: EngineSettings) -> IntensityBelief:
    """A belief that has listened for a while and heard one source three times."""
    belief, rng = IntensityBelief(engine), np.random.default_rng(5)
    for number in range(3):
        at = np.array([[9.0, 9.0 + number], [10.5, 9.0 + number], [20.0, 3.0]])
        away = np.hypot(*(at - [9.6, 11.0]).T)
        level = np.round(-76.0 - 25.3 * np.log10(away) + rng.normal(0.0, 2.0, 3))
        rss = np.where(level > engine.antenna.threshold_dbm, level, np.nan)
        t_ns, robots = (20 * number + 10) * 10**9, ("r0", "r1", "r4")
        belief.listen(Listening(t_ns - 10**10, t_ns, robots, at))
        belief.detect(Detection(t_ns, robots, at, np.zeros(3), rss, np.zeros(3, bool)))
        belief.reflect()
    return belief


BEFORE = {
    "r0": ("resolve 1", 6, (8.4321, 8.5449), (11.2568, 10.0715)),
    "r1": ("resolve 1", 6, (8.0382, 9.9283), (12.1417, 11.2054)),
    "r2": ("search", 3, (19.1367, 9.7089), (20.5793, 11.5205)),
    "r3": ("search", 3, (17.1307, 14.0636), (22.7808, 15.7797)),
    "r4": ("search", 3, (19.4518, 12.9998), (17.0836, 13.8932)),
    "r5": ("search", 3, (14.7751, 14.0565), (12.3318, 14.5315)),
}
"""Robot to its plan before search and reward were parted: purpose, legs, and where they lead first and last."""


def test_the_planner_of_before_decides_as_it_did() -> None:
    engine = settings(sensing="levels")
    place = {r: (6.0 + 5.0 * (k // 2), 8.0 + 1.2 * (k % 2)) for k, r in enumerate(engine.robots)}
    planner = plugins.load("fieldkit.planners", "infogain1")(engine)
    plan = planner.plan(Situation(0, place, engine.teams, {}), as_heard(engine))
    for robot, (purpose, legs, first, last) in BEFORE.items():
        path = plan.paths[robot]
        assert (plan.purpose[robot], len(path)) == (purpose, legs)
        assert (path[0].east_m, path[0].north_m) == pytest.approx(first, abs=1e-3)
        assert (path[-1].east_m, path[-1].north_m) == pytest.approx(last, abs=1e-3)
