"""The kernel's parts one by one: robots, tasks, turns and endings, each limit just at and just beyond."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.messages import (
    Detection,
    GoTo,
    Plan,
    Pose,
    ReceiverState,
    SourceEstimate,
    VehicleState,
    Waypoint,
)
from mission.core.endings import Progress, reason_to_end
from mission.core.fleet import Fleet
from mission.core.kernel_settings import KernelSettings
from mission.core.tasks import LATE_LEGS, SETTING_OFF_S, SLOWER, Task, Tasks
from mission.core.turns import NEWS_EVERY_S, NEWS_RANGES, PlanningTurns
from mission.lab.synthetic import small_mission
from mission.safety.limits import BatteryLimits, RadioLimits

S = 1_000_000_000
ONE, TWO = ("r1", "r2"), ("r3", "r4")


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> KernelSettings:
    return small_mission(tmp_path_factory.mktemp("mission")).kernel


# Robots


def seen(settings: KernelSettings) -> Fleet:
    fleet = Fleet(settings)
    for k, robot in enumerate(settings.engine.robots):
        fleet.take_in(Pose(0, robot, float(k), 1.0))
    return fleet


def test_home_is_where_a_robot_was_first_seen(settings: KernelSettings) -> None:
    fleet = Fleet(settings)
    assert fleet.positions_m() == fleet.homes_m() == {}
    fleet.take_in(Pose(0, "r1", 2.0, 3.0))
    fleet.take_in(Pose(1, "r1", 4.0, 5.0))
    fleet.take_in(Pose(1, "stranger", 4.0, 5.0))
    assert fleet.homes_m() == {"r1": (2.0, 3.0)} and fleet.positions_m() == {"r1": (4.0, 5.0)}


def test_only_robots_that_have_been_seen_have_a_height(settings: KernelSettings) -> None:
    fleet = Fleet(settings)
    assert fleet.heights_m() == {}
    fleet.take_in(Pose(0, "r1", 2.0, 3.0, 12.5))
    fleet.take_in(Pose(0, "r3", 2.0, 3.0, 0.0))
    assert fleet.heights_m() == {"r1": 12.5, "r3": 0.0}


def test_a_robot_without_a_position_is_not_steered_and_one_without_a_vehicle_is(
    settings: KernelSettings,
) -> None:
    fleet = Fleet(settings)
    assert not fleet.is_steerable("r1", 0)
    fleet.take_in(Pose(0, "r1", 2.0, 3.0))
    assert fleet.is_steerable("r1", 0)
    assert fleet.steerable_teams(0) == (("r1",),), "its partner is not there, the other team neither"


def test_a_receiver_is_down_since_its_first_word_of_it(settings: KernelSettings) -> None:
    fleet = seen(replace(settings, radio=RadioLimits(10.0)))
    for t_s in (5, 6, 14):
        fleet.take_in(ReceiverState(t_s * S, "r1", False))
    assert fleet.is_steerable("r1", 15 * S)
    assert not fleet.is_steerable("r1", 15 * S + 1000)
    fleet.take_in(ReceiverState(16 * S, "r1", True))
    assert fleet.is_steerable("r1", 100 * S)
    fleet.take_in(ReceiverState(200 * S, "r1", False))
    assert fleet.is_steerable("r1", 210 * S), "counted anew"


def test_somebody_is_held_or_nobody(settings: KernelSettings) -> None:
    fleet = seen(settings)
    assert not fleet.any_held()
    fleet.robots["r4"].held = True
    assert fleet.any_held() and not fleet.is_steerable("r4", 0)
    assert fleet.steerable_teams(0) == (ONE, ("r3",))


@pytest.mark.parametrize(
    ("left_pct", "reserve_pct", "per_m", "range_m"),
    [(65.0, 25.0, 0.5, 80.0), (20.0, 25.0, 0.5, 0.0), (65.0, 25.0, 0.0, None), (None, 25.0, 0.5, None)],
)
def test_the_range_is_what_is_above_the_reserve(
    settings: KernelSettings, left_pct: float | None, reserve_pct: float, per_m: float, range_m: float | None
) -> None:
    fleet = seen(replace(settings, battery=BatteryLimits(reserve_pct, per_m)))
    assert fleet.range_m("r1") is None, "its vehicle has said nothing"
    fleet.take_in(VehicleState(0, "r1", "guided", True, True, left_pct))
    assert fleet.range_m("r1") == range_m


def test_a_distance_is_straight(settings: KernelSettings) -> None:
    fleet = seen(settings)
    assert fleet.distance_m("r2", Waypoint(4.0, 5.0, 1.0)) == 5.0


# Tasks

PATH = (Waypoint(3.0, 5.0, 0.5), Waypoint(6.0, 9.0, 0.25))


def under_way(settings: KernelSettings, **paths: tuple[Waypoint, ...]) -> Tasks:
    fleet = seen(settings)
    tasks = Tasks(settings, fleet)
    for team in (ONE, TWO):
        if any(robot in paths for robot in team):
            tasks.of[team] = Task({robot: paths.get(robot, ()) for robot in team}, 0)
    return tasks


def go(tasks: Tasks, t_s: float) -> dict[str, Waypoint]:
    commands = tasks.follow(round(t_s * S), [])
    assert all(isinstance(c, GoTo) and c.t_ns == round(t_s * S) for c in commands)
    return {c.robot: c.waypoint for c in commands if isinstance(c, GoTo)}


def put(tasks: Tasks, robot: str, east: float, north: float) -> None:
    tasks.fleet.take_in(Pose(0, robot, east, north))


def test_a_team_sets_out_once_and_goes_on_from_leg_to_leg(settings: KernelSettings) -> None:
    tasks = under_way(settings, r1=PATH)
    assert go(tasks, 0) == {"r1": PATH[0]}
    assert go(tasks, 0.5) == {}, "it is on its way"
    put(tasks, "r1", 3.0, 5.0)
    assert go(tasks, 1) == {"r1": PATH[1]}
    put(tasks, "r1", 6.0, 9.0)
    assert go(tasks, 2) == {} and tasks.of == {}, "driven to its end"
    assert not tasks.timed_out


@pytest.mark.parametrize(("speed_m_s", "distance_m"), [(0.5, 5.0), (0.25, 5.0), (0.25, 1.0)])
def test_a_leg_may_take_so_much_longer_than_at_its_speed(
    settings: KernelSettings, speed_m_s: float, distance_m: float
) -> None:
    tasks = under_way(settings, r1=(Waypoint(0.0, 1.0 + distance_m, speed_m_s), *PATH))
    limit_s = SLOWER * distance_m / speed_m_s + SETTING_OFF_S
    go(tasks, 7)
    assert go(tasks, 7 + limit_s) == {}
    assert go(tasks, 7 + limit_s + 0.001) == {"r1": PATH[0]}
    assert dict(tasks.timed_out) == {"r1": 1}


def test_the_slowest_of_a_team_sets_the_limit(settings: KernelSettings) -> None:
    slow = Waypoint(1.0, 5.0, 0.1)
    tasks = under_way(settings, r1=PATH, r2=(slow, PATH[1]))
    assert go(tasks, 0) == {"r1": PATH[0], "r2": slow}
    put(tasks, "r1", 3.0, 5.0)
    limit_s = SLOWER * 40.0 + SETTING_OFF_S
    assert go(tasks, limit_s) == {}
    assert go(tasks, limit_s + 0.001) == {"r1": PATH[1], "r2": PATH[1]}
    assert dict(tasks.timed_out) == {"r2": 1}, "the other had arrived"


def test_a_way_point_without_a_speed_is_not_waited_for_for_ever(settings: KernelSettings) -> None:
    tasks = under_way(settings, r1=(Waypoint(0.0, 2.0, 0.0), PATH[0]))
    go(tasks, 0)
    assert tasks.of[ONE].leg_limit_s == SLOWER * 1000.0 + SETTING_OFF_S


def test_arrival_is_within_its_distance(settings: KernelSettings) -> None:
    for off_m, arrived in ((0.5, True), (0.500001, False)):
        tasks = under_way(replace(settings, arrive_m=0.5), r1=PATH)
        go(tasks, 0)
        put(tasks, "r1", 3.0, 5.0 - off_m)
        assert bool(go(tasks, 1)) == arrived


def test_late_legs_in_a_row_are_noted_once(settings: KernelSettings) -> None:
    legs = tuple(Waypoint(0.0, 5.0 + k, 1.0) for k in range(2 * LATE_LEGS + 2))
    tasks = under_way(settings, r1=legs)
    notes: list[str] = []
    for k in range(LATE_LEGS + 2):
        tasks.follow(k * 100 * S, notes)
    (note,) = notes
    assert note.startswith(
        f"r1: {LATE_LEGS} legs in a row ended by time-out, the last {4 + LATE_LEGS - 1}.0 m"
    )
    assert dict(tasks.timed_out) == {"r1": LATE_LEGS + 1}


def test_a_robot_that_cannot_be_steered_ends_its_teams_task_only(settings: KernelSettings) -> None:
    tasks = under_way(settings, r1=PATH, r3=PATH)
    tasks.fleet.robots["r2"].held = True
    assert go(tasks, 0) == {"r3": PATH[0]}
    assert set(tasks.of) == {TWO}


@pytest.mark.parametrize("paths", [{}, {"r1": ()}])
def test_a_team_without_a_path_waits_for_a_period(
    settings: KernelSettings, paths: dict[str, tuple[Waypoint, ...]]
) -> None:
    tasks = under_way(settings)
    tasks.of[ONE] = Task(paths, 10 * S)
    period_s = settings.engine.planning_period_s
    assert go(tasks, 10 + period_s - 0.001) == {} and ONE in tasks.of
    assert go(tasks, 10 + period_s) == {} and ONE not in tasks.of


def test_teams_are_dropped_by_their_robots_and_kept_by_their_names(settings: KernelSettings) -> None:
    tasks = under_way(settings, r1=PATH, r3=PATH)
    tasks.drop({"stranger"})
    assert set(tasks.of) == {ONE, TWO}
    tasks.keep({TWO})
    assert set(tasks.of) == {TWO}
    tasks.drop({"r4"})
    assert tasks.of == {}


def test_what_remains_of_a_plan_begins_with_the_present_leg(settings: KernelSettings) -> None:
    tasks = under_way(settings, r1=PATH, r2=PATH[:1])
    assert tasks.remaining(5) == {ONE: Plan(5, {"r1": PATH, "r2": PATH[:1]})}
    tasks.of[ONE].leg = 1
    assert tasks.remaining(5) == {ONE: Plan(5, {"r1": PATH[1:], "r2": ()})}
    assert tasks.of[ONE].targets() == {"r1": PATH[1]} and tasks.of[ONE].legs == 2


def test_a_robot_that_flies_goes_at_its_height_and_others_as_planned(settings: KernelSettings) -> None:
    high = Waypoint(3.0, 5.0, 0.5, 3.0)
    tasks = under_way(replace(settings, altitude_m={"r1": 12.0}), r1=(high,), r3=(high,))
    assert {robot: w.up_m for robot, w in go(tasks, 0).items()} == {"r1": 12.0, "r3": 3.0}


# Turns


def turn(turns: PlanningTurns, t_s: float, busy: tuple[tuple[str, ...], ...] = (), **more: bool) -> list[str]:
    options = {"found_more": False, "one_at_a_time": True} | more
    return [team[0] for team in turns.take(round(t_s * S), (ONE, TWO), busy, **options)]


def test_a_period_is_over_when_it_is(settings: KernelSettings) -> None:
    turns, period_s = PlanningTurns(settings.engine), settings.engine.planning_period_s
    assert turns.is_due(0)
    turn(turns, 3)
    assert not turns.is_due(round((3 + period_s) * S) - 1) and turns.is_due(round((3 + period_s) * S))
    turns.start_anew()
    assert turns.is_due(0)


def test_team_by_team_the_longest_planned_comes_first(settings: KernelSettings) -> None:
    turns, period_s = PlanningTurns(settings.engine), settings.engine.planning_period_s
    assert [turn(turns, 1), turn(turns, 2, (ONE,))] == [["r1"], ["r3"]]
    busy = (ONE, TWO)
    assert turn(turns, 3, busy) == [], "all have a task"
    assert turn(turns, 4, (ONE,)) == ["r3"]
    assert turn(turns, 1 + period_s, busy) == ["r1"], "planned for at 1, the other at 4"
    assert turn(turns, 2 + period_s, busy) == ["r3"]
    assert turn(turns, 3 + period_s, busy) == []


def test_all_at_once_is_all_at_once(settings: KernelSettings) -> None:
    turns = PlanningTurns(settings.engine)
    assert turn(turns, 1, one_at_a_time=False) == ["r1", "r3"]
    assert turn(turns, 2, (ONE, TWO), one_at_a_time=False) == []
    assert turn(turns, 3, (ONE, TWO), one_at_a_time=False, found_more=True) == ["r1", "r3"]


def test_a_find_begins_the_period_anew(settings: KernelSettings) -> None:
    turns, period_s = PlanningTurns(settings.engine), settings.engine.planning_period_s
    turn(turns, 0)
    turn(turns, 5, (ONE, TWO), found_more=True)
    assert not turns.is_due(round(period_s * S)) and turns.is_due(round((5 + period_s) * S))


def source(east: float, north: float, state: str = "candidate") -> SourceEstimate:
    return SourceEstimate(1, east, north, np.eye(2), 4, 3.0, 0.1, 0.9, 0.5, state)  # type: ignore[arg-type]


def heard_at(east: float, north: float, robot: str = "r1", rss_dbm: float = -60.0) -> Detection:
    place = np.array([[east, north], [0.0, 0.0]])
    other = "r3" if robot != "r3" else "r1"
    levels = np.array([rss_dbm, np.nan])
    return Detection(0, (robot, other), place, np.zeros(2), levels, np.zeros(2, dtype=bool))


def news(
    settings: KernelSettings, detection: Detection, *sources: SourceEstimate, t_s: float = 100.0
) -> list[str]:
    """Whom it makes plan anew, both having been planned for at 1 s and busy."""
    turns = PlanningTurns(settings.engine)
    turn(turns, 1, one_at_a_time=False)
    turns._next_ns = 10**15
    turns.hear(round(t_s * S), (ONE, TWO), [detection], sources)
    return turn(turns, t_s, (ONE, TWO), one_at_a_time=False)


def test_news_is_what_is_heard_near_a_source_not_found_yet(settings: KernelSettings) -> None:
    engine = settings.engine
    reach_m = NEWS_RANGES * float(engine.antenna.nominal_range_m(max(engine.power_levels_db)))
    for off_m, expected in ((reach_m - 1e-6, ["r1"]), (reach_m + 1e-6, [])):
        assert (
            news(settings, heard_at(50.0, 50.0), source(50.0 + 0.6 * off_m, 50.0 - 0.8 * off_m)) == expected
        )
    assert news(settings, heard_at(50.0, 50.0, "r3"), source(50.0, 50.0)) == ["r3"]
    assert news(settings, heard_at(50.0, 50.0, rss_dbm=np.nan), source(50.0, 50.0)) == [], "in silence"
    assert news(settings, heard_at(50.0, 50.0)) == [], "nothing is known there"
    assert news(settings, heard_at(50.0, 50.0), source(5000.0, 50.0), source(50.0, 50.0)) == ["r1"]


@pytest.mark.parametrize(
    ("state", "open_still"),
    [("candidate", True), ("inconsistent", True), ("found", False), ("removed", False)],
)
def test_a_source_that_is_found_or_gone_is_no_news(
    settings: KernelSettings, state: str, open_still: bool
) -> None:
    assert news(settings, heard_at(5.0, 5.0), source(5.0, 5.0, state)) == (["r1"] if open_still else [])


def test_news_makes_no_team_plan_anew_every_moment(settings: KernelSettings) -> None:
    assert news(settings, heard_at(5.0, 5.0), source(5.0, 5.0), t_s=1 + NEWS_EVERY_S - 0.001) == []
    assert news(settings, heard_at(5.0, 5.0), source(5.0, 5.0), t_s=1 + NEWS_EVERY_S) == ["r1"]


def test_a_team_never_planned_for_is_not_kept_from_it(settings: KernelSettings) -> None:
    turns = PlanningTurns(settings.engine)
    turns._next_ns = 10**15
    turns.hear(100 * S, (ONE,), [heard_at(5.0, 5.0)], [source(5.0, 5.0)])
    assert turn(turns, 100, (ONE, TWO)) == ["r1"]


# Endings


def ends(
    settings: KernelSettings, elapsed_s: float = 0.0, idle_s: float = 0.0, found: tuple[float, ...] = ()
) -> str:
    return reason_to_end(settings, Progress(elapsed_s, idle_s, found))


def test_a_mission_that_has_no_reason_to_end_goes_on(settings: KernelSettings) -> None:
    endless = replace(settings, max_duration_s=1e9, sources_expected=None, stop_after_periods=None)
    assert ends(endless, 1e8, 0.0, (1.0, 2.0)) == ""


def test_each_ending_comes_at_its_limit(settings: KernelSettings) -> None:
    plain = replace(settings, max_duration_s=500.0, idle_limit_s=50.0, sources_expected=None)
    assert ends(plain, 499.9) == "" and ends(plain, 500.0) == "time is up (500 s)"
    assert ends(plain, 100.0, 50.0) == ""
    assert ends(plain, 100.0, 50.1) == "no robot could be steered for 50 s"
    wanted = replace(plain, sources_expected=2)
    assert ends(wanted, 1.0, 0.0, (1.0,)) == ""
    assert ends(wanted, 1.0, 0.0, (1.0, 2.0)) == ends(wanted, 1.0, 0.0, (1.0, 2.0, 3.0)) != ""


def test_so_many_periods_count_from_the_last_find_or_from_the_start(settings: KernelSettings) -> None:
    period_s = settings.engine.planning_period_s
    patient = replace(settings, max_duration_s=1e9, sources_expected=None, stop_after_periods=3)
    assert ends(patient, 3 * period_s - 0.1) == "" and "3 planning periods" in ends(patient, 3 * period_s)
    assert ends(patient, 3 * period_s, 0.0, (7.0, 2.0)) == ""
    assert ends(patient, 3 * period_s + 6.9, 0.0, (7.0, 2.0)) == ""
    assert "3 planning periods" in ends(patient, 3 * period_s + 7.0, 0.0, (7.0, 2.0))
