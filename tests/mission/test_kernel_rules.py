"""Whom the kernel steers, when a leg is over, and what ends a mission: each limit just below and just above."""

import math
from dataclasses import replace

import pytest
from light import S, light_settings

from fieldkit.messages import (
    EndMission,
    GoTo,
    Operator,
    Plan,
    Pose,
    ReceiverState,
    Tick,
    VehicleState,
    Waypoint,
)
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.core.tasks import LATE_LEGS
from mission.safety.limits import BatteryLimits, RadioLimits


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> KernelSettings:
    return light_settings(tmp_path_factory.mktemp("mission"))


class Driven:
    """A kernel whose planner says what a test wants: each robot has its own way-points."""

    TEAM_BY_TEAM = False

    def __init__(self, settings: KernelSettings, **paths: tuple[Waypoint, ...]) -> None:
        self.kernel = Kernel(settings)
        self.paths, self.asked = paths, []
        self.kernel.planner = self  # type: ignore[assignment]
        self.robots = settings.engine.robots
        for k, robot in enumerate(self.robots):
            self.put(0.0, robot, 2.0 + k, 1.0)
            self.kernel.step(VehicleState(0, robot, "guided", True))

    def plan(self, situation, belief) -> Plan:  # type: ignore[no-untyped-def]
        self.asked.append(situation)
        return Plan(situation.t_ns, dict(self.paths))

    def put(self, t_s: float, robot: str, east: float, north: float) -> None:
        self.kernel.step(Pose(round(t_s * S), robot, east, north))

    def tick(self, t_s: float) -> list[GoTo]:
        return [c for c in self.kernel.step(Tick(round(t_s * S))).commands if isinstance(c, GoTo)]

    def ends(self, t_s: float) -> list[str]:
        return [
            c.reason for c in self.kernel.step(Tick(round(t_s * S))).commands if isinstance(c, EndMission)
        ]


FAR = (Waypoint(2.0, 5.0, 0.4, 3.0), Waypoint(6.0, 5.0, 0.2))


# Legs


@pytest.mark.parametrize("arrive_m", [0.15, 0.6])
def test_the_next_leg_begins_within_the_arrival_distance(settings: KernelSettings, arrive_m: float) -> None:
    for off_m, arrived in ((0.01, False), (-0.01, True)):
        field = Driven(replace(settings, arrive_m=arrive_m), r1=FAR)
        assert field.tick(0) == [GoTo(0, "r1", FAR[0])]
        away_m = arrive_m + off_m
        field.put(1, "r1", 2.0 + 0.6 * away_m, 5.0 - 0.8 * away_m)
        assert field.tick(1) == ([GoTo(S, "r1", FAR[1])] if arrived else [])
        assert field.kernel.legs_timed_out["r1"] == 0


@pytest.mark.parametrize(("speed_m_s", "leg_s"), [(0.4, 10.0), (0.2, 20.0), (8.0, 0.5)])
def test_a_leg_has_three_fifths_more_than_its_time_and_five_seconds(
    settings: KernelSettings, speed_m_s: float, leg_s: float
) -> None:
    field = Driven(settings, r1=(Waypoint(2.0, 5.0, speed_m_s), *FAR))
    field.tick(100)
    limit_s = 1.6 * leg_s + 5.0
    assert field.tick(100 + limit_s - 0.01) == []
    assert [c.waypoint for c in field.tick(100 + limit_s + 0.01)] == [FAR[0]]
    assert field.kernel.legs_timed_out["r1"] == 1


def test_a_team_waits_for_its_slower_robot_and_only_that_one_is_late(settings: KernelSettings) -> None:
    team = settings.engine.teams[0]
    field = Driven(settings, **{team[0]: FAR, team[1]: (Waypoint(8.0, 5.0, 0.1), FAR[1])})
    assert {c.robot for c in field.tick(0)} == set(team)
    field.put(1, team[0], 2.0, 5.0)
    assert field.tick(1) == [], "the other is still on its way"
    long_s = 1.6 * math.hypot(8.0 - 3.0, 4.0) / 0.1 + 5.0
    assert field.tick(long_s - 0.5) == []
    assert {c.robot for c in field.tick(long_s + 0.5)} == set(team)
    assert dict(field.kernel.legs_timed_out) == {team[1]: 1}


def test_legs_that_end_late_in_a_row_are_worth_a_word_and_an_arrival_begins_the_count_anew(
    settings: KernelSettings,
) -> None:
    legs = tuple(Waypoint(2.0, 5.0 + 0.01 * k, 0.4) for k in range(9))
    field = Driven(settings, r1=legs)
    said: list[int] = []
    for k in range(8):  # every leg takes 25 s and may take 21 s
        if k == LATE_LEGS:
            field.put(25 * k, "r1", 2.0, 5.0)  # the third one is driven
        notes = field.kernel.step(Tick(25 * k * S)).notes
        said += [k for note in notes if "legs in a row ended by time-out, the last 4." in note]
        field.put(25 * k, "r1", 2.0, 1.0)
    assert said == [2 * LATE_LEGS], "three after that"
    assert field.kernel.legs_timed_out["r1"] == 6


def test_a_robot_that_flies_is_sent_at_its_altitude(settings: KernelSettings) -> None:
    assert Driven(settings, r1=FAR).tick(0)[0].waypoint.up_m == 3.0
    assert Driven(replace(settings, altitude_m={"r1": 15.0}), r1=FAR).tick(0)[0].waypoint.up_m == 15.0


def test_a_plan_is_made_anew_at_its_period_and_when_a_path_is_driven(settings: KernelSettings) -> None:
    field = Driven(settings, **dict.fromkeys(settings.engine.robots, FAR))
    period_s = settings.engine.planning_period_s
    field.tick(0)
    field.tick(period_s - 0.1)
    assert len(field.asked) == 1
    field.tick(period_s + 0.1)
    assert len(field.asked) == 2


# Who is steered


def steered(field: Driven, t_s: float = 1.0) -> bool:
    return bool(field.tick(t_s))


@pytest.mark.parametrize(
    ("mode", "link_up", "ours"),
    [("guided", True, True), ("hold", True, True), ("guided", False, False), ("hold", False, False),
     ("other", True, False), ("return", True, False), ("land", True, False), ("unknown", True, False)],
)  # fmt: skip
def test_a_robot_is_steered_while_it_is_heard_and_ours(
    settings: KernelSettings, mode: str, link_up: bool, ours: bool
) -> None:
    field = Driven(settings, r1=FAR)
    field.kernel.step(VehicleState(0, "r1", mode, True, link_up))  # type: ignore[arg-type]
    assert steered(field) == ours


@pytest.mark.parametrize("limit_s", [10.0, 40.0])
def test_a_robot_whose_radio_is_down_for_longer_than_its_limit_is_left(
    settings: KernelSettings, limit_s: float
) -> None:
    for down_s, ours in ((limit_s - 0.1, True), (limit_s + 0.1, False)):
        field = Driven(replace(settings, radio=RadioLimits(limit_s)), r1=FAR)
        field.kernel.step(ReceiverState(5 * S, "r1", False))
        field.kernel.step(ReceiverState(6 * S, "r1", False))
        assert steered(field, 5 + down_s) == ours
        field.kernel.step(ReceiverState(100 * S, "r1", True))
        assert steered(field, 100 + 200) or ours


@pytest.mark.parametrize("action", ["hold", "return", "release", "withdraw"])
def test_orders_of_the_operator_end_steering_until_resumed(settings: KernelSettings, action: str) -> None:
    field = Driven(settings, r1=FAR, r3=FAR)
    notes = field.kernel.step(Operator(0, action, "r1", reason="why")).notes  # type: ignore[arg-type]
    assert notes == (f"{'safety' if action == 'withdraw' else 'operator'}: {action} r1: why",)
    assert [c.robot for c in field.tick(1)] == ["r3"]
    field.kernel.step(Operator(0, "resume", "r1"))
    assert "r1" in {c.robot for c in field.tick(2)}


def test_a_flying_robot_whose_positions_have_no_height_is_noted_once_and_nobody_else(
    settings: KernelSettings,
) -> None:
    kernel = Kernel(replace(settings, altitude_m={"r2": 12.0}))
    kernel.step(VehicleState(0, "r2", "guided", True))
    said = [
        kernel.step(Pose(t_ns, robot, 2.0, 1.0, up_m, origin="camera")).notes
        for t_ns, robot, up_m in ((1, "r1", 0.0), (2, "r2", 12.0), (3, "r2", 0.0), (4, "r2", 0.0))
    ]
    assert [len(notes) for notes in said] == [0, 0, 1, 0]
    assert said[2][0].startswith("r2: it flies, and its positions (camera) have no height")


@pytest.mark.parametrize(
    ("orders", "steered_again"),
    [
        (["withdraw"], True),
        (["hold"], True),
        (["release"], False),
        (["release", "withdraw"], False),
        (["release", "hold"], True),
    ],
)
def test_a_word_to_all_resumes_whom_nobody_else_was_given(
    settings: KernelSettings, orders: list[str], steered_again: bool
) -> None:
    field = Driven(settings, r1=FAR)
    for action in orders:
        field.kernel.step(Operator(0, action, "r1"))  # type: ignore[arg-type]
    assert field.tick(1) == []
    field.kernel.step(Operator(S, "resume"))
    assert [c.robot for c in field.tick(2)] == (["r1"] if steered_again else [])


def test_a_robot_that_is_resumed_makes_everybody_plan_anew(settings: KernelSettings) -> None:
    field = Driven(settings, r1=FAR, r3=FAR)
    field.tick(1)
    field.kernel.step(Operator(S, "hold", "r1"))
    field.tick(2)
    before = len(field.asked)
    field.kernel.step(Operator(2 * S, "resume", "r1"))
    field.tick(3)
    assert [situation.teams for situation in field.asked[before:]] == [settings.engine.teams]


@pytest.mark.parametrize(
    ("action", "said"),
    [
        ("mark", "r1 says: a transmitter is here, at 2.5 m east, 1.5 m north"),
        ("bearing", "r1 says: bearing 123 degrees, taken at 2.5 m east, 1.5 m north"),
    ],
)
def test_a_persons_word_is_written_down_with_its_place_and_changes_no_leg(
    settings: KernelSettings, action: str, said: str
) -> None:
    field = Driven(settings, r1=FAR)
    assert field.tick(0) == [GoTo(0, "r1", FAR[0])]
    field.put(1, "r1", 2.5, 1.5)
    outcome = field.kernel.step(Operator(S, action, "r1", reason="bearing 123 degrees"))  # type: ignore[arg-type]
    assert outcome.notes == (said,) and outcome.commands == ()
    assert field.tick(2) == [], "still on its leg"


@pytest.mark.parametrize("robot", ["stranger", None])
def test_a_word_of_nobody_who_was_seen_has_no_place(settings: KernelSettings, robot: str | None) -> None:
    notes = Driven(settings).kernel.step(Operator(S, "mark", robot)).notes
    assert notes == (f"operator: mark {robot}: where that is, is not known",)


def test_the_planner_is_told_what_the_battery_leaves_and_where_home_is(settings: KernelSettings) -> None:
    field = Driven(replace(settings, battery=BatteryLimits(25.0, 0.5)), r1=FAR)
    for robot, left_pct in (("r1", 65.0), ("r2", 10.0)):
        field.kernel.step(VehicleState(0, robot, "guided", True, True, left_pct))
    field.put(1, "r1", 2.5, 1.5)
    field.tick(1)
    (situation,) = field.asked
    assert situation.range_m == {"r1": 80.0, "r2": 0.0}
    assert situation.home_m["r1"] == (2.0, 1.0) and situation.position_m["r1"] == (2.5, 1.5)
    other = Driven(settings, r1=FAR)
    other.kernel.step(VehicleState(0, "r1", "guided", True, True, 65.0))
    other.tick(1)
    assert other.asked[0].range_m == {}, "what a metre costs is not known"


def test_a_robot_outside_the_fence_goes_back_in_first(settings: KernelSettings) -> None:
    field = Driven(settings, r1=FAR)
    field.put(1, "r1", 2.0, -0.5)
    back = next(c.waypoint for c in field.tick(1) if c.robot == "r1")
    margin_m = settings.engine.fence_margin_m + settings.arrive_m
    assert (back.east_m, back.north_m) == pytest.approx((2.0, margin_m), abs=1e-3)
    assert back.speed_m_s == settings.engine.max_speed_m_s


# What ends a mission


@pytest.mark.parametrize("most_s", [10.0, 500.0])
def test_time_is_up_at_its_limit(settings: KernelSettings, most_s: float) -> None:
    field = Driven(replace(settings, max_duration_s=most_s), r1=FAR)
    field.tick(1000)
    assert field.ends(1000 + most_s - 0.1) == []
    assert field.ends(1000 + most_s) == [f"time is up ({most_s:.0f} s)"]
    assert field.kernel.elapsed_s(1010 * S) == 10.0


def test_a_mission_that_steers_nobody_for_long_ends_but_not_under_the_operators_hold(
    settings: KernelSettings,
) -> None:
    brief = replace(settings, idle_limit_s=50.0)
    for held in (False, True):
        field = Driven(brief, r1=FAR)
        field.tick(100)
        for robot in field.robots:
            field.kernel.step(VehicleState(100 * S, robot, "other", True))
        if held:
            field.kernel.step(Operator(100 * S, "hold", "r2"))
        assert field.ends(149.9) == []
        assert bool(field.ends(150.1)) != held


@pytest.mark.parametrize(("left", "ends"), [(0.051, False), (0.049, True)])
def test_a_mission_ends_when_hardly_a_source_can_be_left(
    settings: KernelSettings, left: float, ends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    field = Driven(replace(settings, stop_probability_left=0.05), r1=FAR)
    monkeypatch.setattr(type(field.kernel.belief), "probability_left", lambda belief: left, raising=False)
    assert bool(field.ends(0)) == ends
    never = Driven(settings, r1=FAR)
    assert never.ends(0) == [], "nobody asked for it"


def test_the_end_of_the_operator_is_the_end(settings: KernelSettings) -> None:
    field = Driven(settings, r1=FAR)
    (end,) = field.kernel.step(Operator(S, "end")).commands
    assert end == EndMission(S, "the operator ended the mission")
    assert field.tick(2) == []


def test_a_source_nobody_knows_cannot_be_removed_nor_a_line_be_closed(settings: KernelSettings) -> None:
    kernel = Driven(settings).kernel
    assert "no source 7" in kernel.step(Operator(0, "remove", source=7)).notes[0] and not kernel.removed
    for area in (((0.0, 0.0), (1.0, 0.0)), ((0.0, 0.0), (1.0, 0.0), (math.nan, 1.0))):
        assert "nothing was closed" in kernel.step(Operator(0, "exclude", area_m=area)).notes[0]
    kernel.step(Operator(0, "exclude", area_m=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))))
    assert len(kernel.planner.settings.keep_out.polygons) == 1  # type: ignore[attr-defined]
