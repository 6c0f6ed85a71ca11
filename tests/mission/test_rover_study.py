"""The drone over one hidden transmitter: laws of its world, and that a short look gives its figures."""

import numpy as np
import pytest
from sizes import size

from mission.lab.study import rover
from mission.lab.study.rover import PILOTS, UP_M, GaussianProcess, Job, Lanes, World, run, trial


def test_the_same_world_is_the_same_for_every_pilot() -> None:
    first, again = World(4), World(4)
    np.testing.assert_array_equal(first.source_m, again.source_m)
    at = np.array([100.0, 50.0])
    assert first.level_db(at) == again.level_db(at)


def test_levels_fall_with_the_distance_in_three_dimensions() -> None:
    world = World(2)
    ring = np.column_stack([np.sin(np.arange(0.0, 6.28, 0.1)), np.cos(np.arange(0.0, 6.28, 0.1))])
    near, far = (
        np.mean([world.level_db(at) for at in world.source_m + away * ring]) for away in (UP_M, 4.0 * UP_M)
    )
    slant = 10.0 * world.exponent * np.log10(np.hypot(4.0 * UP_M, UP_M) / np.hypot(UP_M, UP_M))
    assert near - far == pytest.approx(
        slant, abs=10.0
    )  # but for the dipoles' 2 dB and the shadow of two rings


def test_lanes_reach_every_corner_of_the_ground() -> None:
    pilot, at = Lanes(0), np.array([150.0, 5.0])
    seen = []
    while (to := pilot.next(0.0, at)) is not None and (not seen or not np.array_equal(to, seen[-1])):
        seen.append(to)
        at = to
    places = np.array(seen)
    assert places.min(axis=0).max() == 0.0 and (places.max(axis=0) >= (275.0, 250.0)).all()


def test_a_gaussian_process_says_where_it_was_loud() -> None:
    pilot, rng = GaussianProcess(1), np.random.default_rng(1)
    for at in rng.uniform(0.0, 1.0, (80, 2)) * (rover.EAST_M, rover.NORTH_M):
        pilot.read(0.0, at, -0.2 * float(np.hypot(*(at - (200.0, 80.0)))))
    assert np.hypot(*(pilot.estimate() - (200.0, 80.0))) < 25.0


@pytest.mark.parametrize("pilot", size(["to the loudest", "fieldkit"], list(PILOTS)))
def test_a_flight_is_looked_at_twice(pilot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rover, "LOOKS_S", size((10.0, 20.0), (60.0, 120.0)))
    monkeypatch.setattr(rover, "locate", _roughly)
    row = trial(Job(pilot, 5))
    assert len(row) == 6 and all(np.isfinite(value) for value in row.values())
    told = run(1, 5, lambda *_: None, only=pilot, workers=1)["scenarios"][pilot]
    assert all(
        0.0 <= look["covered_90"] <= 1.0 and look["located_median_m"] < 420.0 for look in told.values()
    )


def _roughly(*given: object) -> object:
    from fieldkit.engine.location.one_source import locate

    return locate(*given, roughly=True)  # type: ignore[arg-type]
