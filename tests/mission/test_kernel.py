"""The kernel: pure, repeatable, and steering only what is its to steer."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fieldkit.messages import EndMission, GoTo, Operator, Pose, RssReading, Tick, VehicleState
from fieldkit.world.sources import TransientSource
from mission.core.kernel import MOST_AT_ONCE, MOST_WAITING, Kernel, state_digest
from mission.core.kernel_settings import KernelSettings
from mission.lab.simulate import Truth, simulate
from mission.lab.synthetic import ANTENNA, LEVELS_DB, small_mission

S = 1_000_000_000


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> KernelSettings:
    kernel = small_mission(tmp_path_factory.mktemp("mission")).kernel
    return replace(kernel, engine=replace(kernel.engine, keep_teams=True))


def started(settings: KernelSettings, mode: str = "guided") -> Kernel:
    kernel = Kernel(settings)
    for index, robot in enumerate(settings.engine.robots):
        kernel.step(VehicleState(0, robot, mode, True))  # type: ignore[arg-type]
        kernel.step(Pose(0, robot, 2.0 + index, 1.0))
    return kernel


def test_the_first_ticks_send_one_team_off_after_another(settings: KernelSettings) -> None:
    kernel = started(settings)
    for turn, team in enumerate(settings.engine.teams):
        outcome = kernel.step(Tick(turn * S))
        assert {c.robot for c in outcome.commands if isinstance(c, GoTo)} == set(team)
        assert outcome.plan is not None and set(outcome.plan.paths) == set(team)
    assert kernel.step(Tick(len(settings.engine.teams) * S)).plan is None


def test_by_need_each_robot_is_sent_off_by_itself(settings: KernelSettings) -> None:
    kernel = started(replace(settings, engine=replace(settings.engine, keep_teams=False)))
    sent = [
        {c.robot for c in kernel.step(Tick(turn * S)).commands if isinstance(c, GoTo)}
        for turn in range(len(settings.engine.robots))
    ]
    assert sent == [{robot} for robot in settings.engine.robots]


def test_planners_of_pairs_keep_them(settings: KernelSettings) -> None:
    parted = replace(settings, engine=replace(settings.engine, keep_teams=False))
    for planner in ("infogain1", "pair-patrol", "prwa"):
        assert Kernel(replace(parted, planner=planner)).fleet.teams == settings.engine.teams


def test_a_planner_for_all_is_asked_for_all_teams_at_once(settings: KernelSettings) -> None:
    outcome = started(replace(settings, planner="pair-patrol")).step(Tick(0))
    assert {c.robot for c in outcome.commands if isinstance(c, GoTo)} == set(settings.engine.robots)


def test_robots_that_are_not_ours_are_not_steered(settings: KernelSettings) -> None:
    kernel = started(settings, mode="other")
    assert kernel.step(Tick(0)).commands == ()
    kernel.step(VehicleState(0, "r3", "guided", True))
    outcome = kernel.step(Tick(S))
    assert {c.robot for c in outcome.commands} == {"r3"}


def test_a_mission_without_a_steerable_robot_ends_and_says_why(settings: KernelSettings) -> None:
    kernel = started(replace(settings, max_duration_s=1000.0))
    kernel.step(Tick(0))
    for robot in settings.engine.robots:
        kernel.step(VehicleState(S, robot, "other", True))
    ends = [c for t in range(1, 400) for c in kernel.step(Tick(t * S)).commands if isinstance(c, EndMission)]
    assert len(ends) == 1 and "no robot could be steered" in ends[0].reason


def test_the_operators_hold_stops_steering_and_resume_starts_it(settings: KernelSettings) -> None:
    kernel = started(settings)
    kernel.step(Tick(0))
    kernel.step(Operator(S, "hold"))
    assert kernel.step(Tick(2 * S)).commands == ()
    kernel.step(Operator(3 * S, "resume"))
    assert kernel.step(Tick(4 * S)).commands != ()


def test_the_next_leg_comes_when_the_team_has_arrived(settings: KernelSettings) -> None:
    kernel = started(settings)
    first = {c.robot: c.waypoint for c in kernel.step(Tick(0)).commands if isinstance(c, GoTo)}
    for robot in ("r1", "r2"):
        kernel.step(Pose(S, robot, first[robot].east_m, first[robot].north_m))
    second = {c.robot for c in kernel.step(Tick(S)).commands}
    assert second == {"r1", "r2", "r3", "r4"}  # and the other team's first


def test_time_up_ends_the_mission_once(settings: KernelSettings) -> None:
    kernel = started(replace(settings, max_duration_s=10.0))
    kernel.step(Tick(0))
    (end,) = [c for c in kernel.step(Tick(11 * S)).commands if isinstance(c, EndMission)]
    assert "time is up" in end.reason
    assert kernel.step(Tick(12 * S)).commands == ()


def test_so_many_periods_without_another_find_end_the_mission(settings: KernelSettings) -> None:
    """RWA and PRWA stop after k_max periods in a row in which no additional source was found."""
    kernel = started(replace(settings, stop_after_periods=3, max_duration_s=1e6))
    period = round(settings.engine.planning_period_s)
    kernel.step(Tick(0))
    kernel.found_at_s[1] = 2.0 * period  # a find begins the count anew
    assert not [c for c in kernel.step(Tick((5 * period - 1) * S)).commands if isinstance(c, EndMission)]
    (end,) = [c for c in kernel.step(Tick(5 * period * S)).commands if isinstance(c, EndMission)]
    assert "3 planning periods" in end.reason


def test_events_of_strangers_change_nothing(settings: KernelSettings) -> None:
    kernel, other = started(settings), started(settings)
    kernel.step(RssReading(S, "stranger", -60.0))
    kernel.step(Pose(S, "stranger", 1.0, 1.0))
    kernel.step(VehicleState(S, "stranger", "guided", True))
    for k in (kernel, other):
        k.step(Tick(5 * S))
    assert state_digest(kernel) == state_digest(other)


def test_the_same_inbox_gives_the_same_state_and_another_seed_another(settings: KernelSettings) -> None:
    sources = (TransientSource(3.0, 4.0, -2.0, 0.2),)
    truth = Truth(ANTENNA, sources, ((2.0, 1.0), (2.6, 1.0), (7.0, 1.0), (7.6, 1.0)))
    short = replace(settings, max_duration_s=60.0, sources_expected=5)
    digests = [state_digest(simulate(short, truth, 3).kernel) for _ in range(2)]
    reseeded = replace(short, engine=replace(short.engine, seed=99))
    assert digests[0] == digests[1]
    assert state_digest(simulate(reseeded, truth, 3).kernel) != digests[0]


def test_a_simulated_mission_finds_its_source(settings: KernelSettings) -> None:
    sources = (TransientSource(6.3, 5.1, -2.0, 0.2),)
    truth = Truth(ANTENNA, sources, ((2.0, 1.0), (2.6, 1.0), (7.0, 1.0), (7.6, 1.0)))
    near = replace(settings.engine, found_within_m=0.2)
    result = simulate(replace(settings, engine=near, max_duration_s=1500.0, sources_expected=1), truth, 1)
    assert result.end_reason == "the expected source is found"
    assert result.false_finds == 0
    (found,) = [s for s in result.kernel.sources() if s.state == "found"]
    assert np.hypot(found.east_m - 6.3, found.north_m - 5.1) < 0.4
    assert set(LEVELS_DB) == set(settings.engine.power_levels_db)


def test_a_flood_of_transmissions_is_taken_in_little_by_little_and_its_oldest_left_out(
    tmp_path: Path,
) -> None:
    """Whatever is heard, a tick stays short: robots have to be steered meanwhile."""
    kernel = Kernel(small_mission(tmp_path).kernel)
    second = 1_000_000_000
    flood = MOST_WAITING + 60
    for t_s in (0, 1, 2):
        for k, robot in enumerate(kernel.settings.engine.robots):
            kernel.step(Pose(t_s * second, robot, 2.0 * k + 1.0, 2.0))
    kernel.step(Tick(0))
    for number in range(flood):
        kernel.step(RssReading(second // 2 + number * second // flood, "r1", -60.0, frame_id=f"x{number}"))
    taken = []
    for k in range(80):
        outcome = kernel.step(Tick(4 * second + k * second // 5))
        taken.append(len(outcome.detections))
        if k == 0:
            assert any("left out" in note for note in outcome.notes)
    assert max(taken) == MOST_AT_ONCE
    assert sum(taken) == MOST_WAITING and kernel.left_out == flood - MOST_WAITING
