"""The papers' experiments in short: common random numbers, censoring said so, one search the same every time."""

import numpy as np
import pytest

from fieldkit.engine.belief.spog import SpogBelief
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.walks import PairPatrol, Patrol
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from mission.lab.study import agents, planners, prwa, rover, rwa, shadowing, trust, world
from mission.lab.study.experiment import Experiment, Job, key, plot, run, summarise, table_csv
from mission.lab.study.packets import transmissions
from mission.lab.study.twin import against_numpy


def quiet(share: float, text: str) -> None:
    """Nobody watches."""


def fake_trial(job: Job) -> dict[str, object]:
    value = None if job.seed == 2 else 10.0 * job.x + job.seed
    return {"value": value, "detections": job.seed}


EXPERIMENT = Experiment("fake", "Fake", "x", "s", ("one", "other"), (1.0, 2.0), fake_trial, cap=100.0)


def test_censored_trials_are_counted_and_take_part_with_the_limit() -> None:
    summary = summarise([fake_trial(Job("fake", "one", 1.0, seed)) for seed in range(3)], 100.0)
    assert (summary["trials"], summary["censored"]) == (3, 1)
    assert summary["mean"] == pytest.approx(10.5)
    assert summary["mean_with_censored"] == pytest.approx((10 + 11 + 100) / 3)
    nothing = summarise([{"value": None}], 100.0)
    assert nothing["mean"] is None and nothing["mean_with_censored"] == 100.0


def test_a_result_says_every_trial_and_can_be_drawn(tmp_path) -> None:  # type: ignore[no-untyped-def]
    result = run(EXPERIMENT, 3, 0, quiet, workers=1)
    assert result["scenarios"][key("other", 2.0)]["censored"] == 1
    lines = table_csv(result).splitlines()
    assert len(lines) == 1 + 2 * 2 * 3 and lines[0].startswith("method,x,seed,value")
    plot(result, tmp_path / "fake.png")
    assert (tmp_path / "fake.png").stat().st_size > 5000


def test_of_an_experiment_the_points_that_are_named_are_run(tmp_path) -> None:  # type: ignore[no-untyped-def]
    result = run(EXPERIMENT, 2, 0, quiet, workers=1, only="one, 2")
    assert result["scenarios"].keys() == {key("one", 2.0)} and len(result["trials_table"]) == 2
    some = run(EXPERIMENT, 2, 0, quiet, workers=1, only="o")
    assert some["methods"] == ["one", "other"] and some["xs"] == [1.0, 2.0]
    del some["scenarios"][key("other", 1.0)]
    plot(some, tmp_path / "some.png")
    assert (tmp_path / "some.png").stat().st_size > 5000
    with pytest.raises(ConfigError, match=r"'two': no row .*rows are: one, 1; other, 1; one, 2"):
        run(EXPERIMENT, 2, 0, quiet, only="two")


@pytest.mark.parametrize("study", [trust, planners, world, shadowing, agents, rover])
def test_a_row_that_no_study_has_is_refused_and_those_it_has_are_named(study) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ConfigError, match=r"--only 'no such row'.*rows are: \w"):
        study.run(1, 0, quiet, only="no such row")


def test_every_method_meets_the_same_packets() -> None:
    hidden = (prwa.random_sources(2, 25.0, 25.0, (0.0,), 0.05, np.random.default_rng(0)),) * 2
    one, other = (transmissions(tuple(sources), 7, 2000.0) for sources in hidden)
    assert (one.t_s == other.t_s).all() and (one.source == other.source).all()
    assert (np.diff(one.t_s) >= 0).all()
    assert len(one.t_s) == pytest.approx(2 * 0.05 * 2000, rel=0.35)


@pytest.mark.parametrize("method", prwa.METHODS)
def test_a_search_is_repeatable_and_finds_one_source(method: str) -> None:
    first, again = (prwa.trial(Job("prwa-fig5a", method, 1, 5)) for _ in range(2))
    assert first["value"] == again["value"] and first["detections"] == again["detections"]
    assert first["simulated_s"] <= prwa.CAP_S


def test_one_robot_with_a_directional_antenna_finds_two_sources() -> None:
    row = rwa.trial(Job("rwa-fig6c", "rwa", 2, 0))
    assert row["value"] is not None and row["value"] < 10_000.0
    with pytest.raises(ValueError, match="study"):
        prwa.trial(Job("prwa-fig9", "prwa", 1, 0))


@pytest.mark.parametrize(
    ("planner", "engine"),
    [(PairPatrol, prwa.engine(0, 6)), (Patrol, prwa.engine(0, 6)), (Patrol, rwa.engine(0))],
)
def test_a_patrol_comes_along_every_lane(planner: type[PairPatrol], engine: EngineSettings) -> None:
    walk = planner(engine)
    size = engine.grid.size_east_m
    place = {robot: (0.08 * size + 0.06 * size * k, 0.04 * size) for k, robot in enumerate(engine.robots)}
    passed: set[int] = set()
    for _ in range(7):  # two corners each: once round the twelve
        plan = walk.plan(Situation(0, place, engine.teams[:1], {}), SpogBelief(engine))
        for robot in engine.teams[0]:
            path = plan.paths[robot]
            passed |= {round(point.east_m // (size / 6.0)) for point in path}
            place[robot] = (path[-1].east_m, path[-1].north_m)
    assert passed == set(range(6))


def test_the_search_in_plain_numpy_is_the_same_search() -> None:
    hidden = tuple(prwa.random_sources(3, 25.0, 25.0, prwa.LEVELS_DB, 0.05, np.random.default_rng(4)))
    compared = against_numpy(prwa.engine(4, 6), hidden, 1500.0)
    assert compared["detections"] > 5
    assert compared["same_outcome"]
