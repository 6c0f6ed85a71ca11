"""Safety's rules, each with its limit just below and just above, for commands, for the operator and for time."""

import math
from dataclasses import replace

import pytest
from small_field import Field, S

from fieldkit.geometry.polygons import KeepOut
from fieldkit.messages import (
    CallOperator,
    Command,
    GoTo,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    Tick,
    VehicleState,
    Waypoint,
)
from mission.safety.limits import SafetySettings
from mission.safety.rules import Safety

ALONE = SafetySettings(("a",), 40.0, 40.0, max_speed_m_s=1.0, min_separation_m=1.0)
TWO = replace(ALONE, robots=("a", "b"))
WALL = ((0.0, 10.0), (20.0, 10.0), (20.0, 12.0), (0.0, 12.0))


def see(safety: Safety, t_s: float, **places: tuple[float, float]) -> None:
    for name, place in places.items():
        safety.observe(Pose(round(t_s * S), name, *place))


def ready(settings: SafetySettings = ALONE, **places: tuple[float, float]) -> Safety:
    safety = Safety(settings)
    for name in settings.robots:
        safety.observe(VehicleState(0, name, "guided", True))
    see(safety, 0, **(places or {"a": (5.0, 5.0)}))
    return safety


def goto(
    east: float, north: float, speed: float = 0.5, robot: str = "a", up: float = 0.0, t_s: float = 0
) -> GoTo:
    return GoTo(round(t_s * S), robot, Waypoint(east, north, speed, up))


def tick(safety: Safety, t_s: float) -> list[Command]:
    return safety.observe(Tick(round(t_s * S)))


def kinds(commands: list[Command]) -> list[type]:
    return [type(command) for command in commands]


# Way-points


@pytest.mark.parametrize("leg_m", [6.0, 20.0])
def test_a_leg_too_long_ends_at_the_longest_in_the_same_direction(leg_m: float) -> None:
    safety = ready(replace(ALONE, max_leg_m=leg_m))
    within = goto(5.0 + 0.59 * leg_m, 5.0 + 0.79 * leg_m)
    assert safety.allow(within) == within
    allowed = safety.allow(goto(5.0 + 3 * leg_m / 4, 5.0 + leg_m))
    assert isinstance(allowed, GoTo)
    assert (allowed.waypoint.east_m, allowed.waypoint.north_m) == pytest.approx(
        (5.0 + 0.6 * leg_m, 5.0 + 0.8 * leg_m)
    )


@pytest.mark.parametrize(("asked", "given"), [(-3.0, 0.0), (0.4, 0.4), (0.99, 0.99), (1.01, 1.0), (9.0, 1.0)])
def test_speed_lies_between_nothing_and_the_limit(asked: float, given: float) -> None:
    allowed = ready().allow(goto(8.0, 8.0, asked, up=7.0))
    assert allowed == goto(8.0, 8.0, given, up=7.0)


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_a_target_with_anything_not_finite_is_held(place: int) -> None:
    for broken in (math.nan, math.inf, -math.inf):
        target = [8.0, 8.0, 0.5, 1.0]
        target[place] = broken
        held = ready().allow(GoTo(0, "a", Waypoint(*target)))
        assert isinstance(held, Hold) and "not finite" in held.reason


def test_a_path_asked_for_at_no_speed_is_judged_like_any_other() -> None:
    safety = ready(TWO, a=(5.0, 5.0), b=(8.0, 5.0))
    held = safety.allow(goto(11.0, 5.0, 0.0))
    assert isinstance(held, Hold) and "of b" in held.reason
    assert safety.allow(goto(5.0, 9.0, 0.0)) == goto(5.0, 9.0, 0.0)


def test_each_refusal_says_why() -> None:
    safety = ready(replace(TWO, keep_out=KeepOut((WALL,))), a=(5.0, 5.0))
    for asked, why in (
        (goto(5.0, 20.0), "out of the fence or onto closed ground"),
        (goto(8.0, 8.0, robot="b"), "its position is unknown"),
        (goto(8.0, 8.0, robot="z"), "there is no such robot"),
        (goto(8.0, 8.0, t_s=2.1), "2.1 s old"),
    ):
        held = safety.allow(asked)
        assert isinstance(held, Hold) and why in held.reason and held.t_ns == asked.t_ns


def test_a_robot_never_seen_is_in_nobodys_way() -> None:
    safety = ready(TWO, a=(0.3, 2.0))
    first, second = safety.judge((goto(0.3, 0.3), goto(8.0, 8.0, robot="b")))
    assert isinstance(first, GoTo) and isinstance(second, Hold)


def test_only_changed_commands_and_own_ones_are_interventions() -> None:
    safety = ready(TWO, a=(5.0, 5.0), b=(9.0, 5.0))
    safety.judge((goto(5.0, 9.0), goto(9.0, 9.0, robot="b")))
    assert safety.interventions == 0
    safety.judge((goto(5.0, 9.0, 5.0), goto(9.0, 9.0, robot="b"), goto(5.0, 5.0, robot="z")))
    assert safety.interventions == 2
    tick(safety, 0)
    assert kinds(tick(safety, 2.5)) == [Hold, Hold] and safety.interventions == 4
    call = [c for t in range(3, 36) for c in tick(safety, t) if isinstance(c, CallOperator)]
    assert {c.robot for c in call} == {"a", "b"}
    before = safety.interventions
    assert safety.allow(Hold(0, "a", "mine")) == Hold(0, "a", "mine") and safety.interventions == before


def test_each_robot_drives_as_it_was_allowed_and_stops_as_it_was_told() -> None:
    safety = ready()
    safety.allow(goto(8.0, 9.0, 9.0))
    target = safety.robots["a"].target
    assert target is not None and (target.start_m, target.end_m, target.speed_m_s) == ((5, 5), (8, 9), 1.0)
    safety.allow(Hold(0, "a", "mine"))
    assert safety.robots["a"].target is None


def test_events_of_strangers_are_no_business_of_safety() -> None:
    safety = ready()
    for event in (
        Pose(0, "z", 1.0, 1.0), VehicleState(0, "z", "other", True), ReceiverState(0, "z", False),
        Operator(0, "hold", "z"), Operator(0, "return", "z"),
    ):  # fmt: skip
        assert safety.observe(event) == []
    assert set(safety.robots) == {"a"}


# The operator


@pytest.mark.parametrize(("reason", "said"), [("", "operator: hold"), ("lunch", "lunch")])
def test_a_hold_says_why(reason: str, said: str) -> None:
    assert ready().observe(Operator(5, "hold", reason=reason)) == [Hold(5, "a", said)]


def test_an_order_to_one_robot_leaves_the_others_alone() -> None:
    safety = ready(TWO, a=(5.0, 5.0), b=(9.0, 5.0))
    see(safety, 30, a=(5.0, 15.0), b=(9.0, 15.0))
    commands = safety.observe(Operator(30 * S, "return", "b"))
    assert [(type(c), c.robot) for c in commands] == [(Hold, "b"), (GoTo, "b")]  # type: ignore[union-attr]
    assert commands[0].reason == "operator: return, in sequence"  # type: ignore[union-attr]
    assert safety.robots["b"].moving and not safety.robots["a"].moving
    assert isinstance(safety.allow(goto(5.0, 18.0, t_s=30)), GoTo)
    refused = safety.allow(goto(9.0, 18.0, robot="b", t_s=30))
    assert isinstance(refused, Hold) and refused.reason == "a standing order: return"


@pytest.mark.parametrize("action", ["hold", "end", "release", "resume", "withdraw"])
def test_what_ends_a_return_and_what_does_not(action: str) -> None:
    field = Field()
    field.at["a"] = (2.0, 12.0)
    field.tick(5)
    field.ask("return", "a")
    field.ask(action, "a")
    goes_on = action == "withdraw"
    assert ("a" in field.safety.returning) == goes_on
    standing = {"hold": "hold", "end": "hold", "release": "release", "resume": "", "withdraw": "return"}
    assert field.safety.robots["a"].ordered == standing[action]
    assert field.safety.robots["a"].moving == (goes_on or action == "resume")


def test_a_withdrawn_robot_is_not_stopped_but_gets_nothing_new() -> None:
    safety = ready()
    safety.allow(goto(5.0, 15.0))
    assert safety.observe(Operator(0, "withdraw", "a")) == []
    assert safety.robots["a"].moving
    refused = safety.allow(goto(8.0, 8.0))
    assert isinstance(refused, Hold) and refused.reason == "a standing order: withdraw"


def test_a_released_robot_is_stopped_for_nobody_and_its_trouble_is_not_ours() -> None:
    safety = ready()
    safety.allow(goto(5.0, 15.0))
    assert safety.observe(Operator(0, "release", "a")) == [] and not safety.robots["a"].moving
    assert all(tick(safety, t) == [] for t in range(100))


def test_an_excluded_area_has_corners_that_are_numbers() -> None:
    safety = ready()
    for area in (WALL[:2], (*WALL, (math.inf, 0.0)), ((math.nan, 0.0), *WALL)):
        assert safety.observe(Operator(0, "exclude", area_m=area)) == []
        assert safety.settings.keep_out.is_nothing
    safety.observe(Operator(0, "exclude", area_m=WALL[:3]))
    assert safety.settings.keep_out.polygons == (WALL[:3],)


@pytest.mark.parametrize(("end_north_m", "stopped"), [(9.79, False), (9.81, True), (20.0, True)])
def test_closing_an_area_stops_those_on_a_path_across_it_at_once(end_north_m: float, stopped: bool) -> None:
    safety = ready(TWO, a=(5.0, 5.0), b=(30.0, 5.0))
    safety.judge((goto(5.0, end_north_m), goto(30.0, 20.0, robot="b")))
    holds = safety.observe(Operator(S, "exclude", area_m=WALL))
    reason = "an area was closed that its path leads across"
    assert holds == ([Hold(S, "a", reason)] if stopped else [])
    assert safety.robots["a"].moving != stopped and safety.robots["b"].moving


def test_closing_an_area_says_nothing_to_those_that_stand_or_are_not_ours() -> None:
    safety = ready()
    safety.allow(goto(5.0, 20.0))
    safety.observe(VehicleState(0, "a", "other", True))
    assert safety.observe(Operator(0, "exclude", area_m=WALL)) == []
    safety = ready(a=(5.0, 11.0))
    assert safety.observe(Operator(0, "exclude", area_m=WALL)) == []


def test_a_robot_on_its_way_home_goes_round_an_area_that_is_closed_meanwhile() -> None:
    field = Field()
    field.at["a"] = (2.0, 16.0)
    field.tick(5)
    field.ask("return", "a")
    field.tick(2)
    field.ask("exclude", area_m=((0.0, 6.0), (4.0, 6.0), (4.0, 9.0), (0.0, 9.0)))
    assert "closed" in field.said(Hold, "a")[-1]
    for _ in range(90):
        field.tick()
        assert field.safety.settings.bounds.clearance_m(field.at["a"]) >= 0.0
    assert math.dist(field.at["a"], field.home["a"]) < 0.6 and not field.said(CallOperator, "a")


# Time


@pytest.mark.parametrize("overrun_s", [0.5, 3.0, 8.0])
def test_a_loop_silent_for_longer_than_its_limit_holds_what_moves(overrun_s: float) -> None:
    for gap_s, late in ((overrun_s - 0.01, False), (overrun_s + 0.01, True)):
        safety = ready(
            replace(TWO, overrun_s=overrun_s, pose_timeout_s=60.0, stall_s=90.0), a=(5.0, 5.0), b=(9.0, 5.0)
        )
        safety.allow(goto(5.0, 15.0))
        assert tick(safety, 10) == [], "before the first tick nothing was silent"
        commands = tick(safety, 10 + gap_s)
        assert [c.robot for c in commands if isinstance(c, Hold)] == (["a"] if late else [])
        refused = safety.allow(goto(5.0, 15.0))
        assert isinstance(refused, Hold if late else GoTo)
        assert not late or f"silent for {gap_s:.1f} s" in refused.reason  # type: ignore[union-attr]
        assert tick(safety, 10 + gap_s + 0.4) == []
        assert isinstance(safety.allow(goto(5.0, 15.0)), GoTo)


def test_a_clock_that_goes_back_is_no_silence() -> None:
    safety = ready()
    safety.allow(goto(5.0, 15.0))
    tick(safety, 1)
    (hold,) = tick(safety, 0.25)
    assert isinstance(hold, Hold) and hold.reason == "the mission's clock went back by 0.8 s"


def test_what_lasted_while_nobody_looked_is_not_held_against_a_robot() -> None:
    safety = ready(replace(ALONE, pose_timeout_s=60.0))
    safety.allow(goto(5.0, 15.0))
    tick(safety, 0)
    (hold,) = tick(safety, 16)
    assert isinstance(hold, Hold) and "silent" in hold.reason, "and not stuck"
    safety.observe(VehicleState(0, "a", "hold", True, link_up=False))
    for t_s in range(17, 40):
        assert CallOperator not in kinds(tick(safety, t_s))
    assert CallOperator not in kinds(tick(safety, 60)), "twenty seconds unseen"
    calls = [t_s for t_s in range(61, 95) if CallOperator in kinds(tick(safety, t_s))]
    assert calls == [90]


@pytest.mark.parametrize("call_after_s", [30.0, 7.0])
def test_the_operator_is_called_once_for_a_trouble_that_lasts_and_again_for_the_next(
    call_after_s: float,
) -> None:
    safety = ready(replace(ALONE, call_after_s=call_after_s, pose_timeout_s=1000.0))

    def calls(link_up: bool, since_s: int, seconds: int) -> list[int]:
        safety.observe(VehicleState(0, "a", "hold", True, link_up, text="gone"))
        return [
            t - since_s for t in range(since_s, since_s + seconds) if CallOperator in kinds(tick(safety, t))
        ]

    assert calls(True, 0, 10) == []
    assert calls(False, 10, 90) == [call_after_s]
    assert calls(True, 100, 5) == []
    assert calls(False, 105, 90) == [call_after_s]


def test_the_operators_own_hold_needs_no_call_and_resuming_begins_anew() -> None:
    safety = ready(replace(ALONE, pose_timeout_s=1000.0))
    safety.observe(VehicleState(0, "a", "hold", True, link_up=False))
    for t_s in range(20):
        tick(safety, t_s)
    safety.observe(Operator(20 * S, "hold"))
    assert all(CallOperator not in kinds(tick(safety, t_s)) for t_s in range(20, 60))
    safety.observe(Operator(60 * S, "resume"))
    assert [t for t in range(60, 130) if CallOperator in kinds(tick(safety, t))] == [90]
    safety.observe(Operator(130 * S, "resume"))
    assert [t for t in range(130, 200) if CallOperator in kinds(tick(safety, t))] == [160]


def test_resuming_a_stuck_robot_gives_it_as_long_again() -> None:
    safety = ready(replace(ALONE, pose_timeout_s=1000.0))
    safety.allow(goto(5.0, 15.0))
    assert all(tick(safety, t) == [] for t in range(15))
    safety.observe(Operator(14 * S, "resume"))
    assert all(tick(safety, t) == [] for t in range(15, 29)), "14 s and the time for a stall"
    assert kinds(tick(safety, 29.1)) == [Hold, CallOperator]


def test_a_hold_is_repeated_every_three_seconds_until_the_vehicle_holds() -> None:
    safety = ready(replace(ALONE, call_after_s=1000.0))
    safety.allow(goto(5.0, 15.0))
    held = [k for k in range(200) if Hold in kinds(tick(safety, k / 10))]
    assert held == [21, 51, 81, 111, 141, 171]
    safety.observe(VehicleState(20 * S, "a", "hold", True))
    assert all(tick(safety, k / 10) == [] for k in range(200, 300))
    safety.robots["a"].target = safety.robots["a"].fading
    assert kinds(tick(safety, 30)) == [Hold], "it holds, but has been sent"


def test_a_robot_that_others_steer_is_told_nothing_in_its_trouble() -> None:
    safety = ready()
    safety.allow(goto(5.0, 15.0))
    safety.observe(VehicleState(0, "a", "other", True))
    assert tick(safety, 2.5) == [] and not safety.robots["a"].moving


def test_others_taking_a_robot_are_reported_if_it_was_ours() -> None:
    safety = ready()
    safety.observe(VehicleState(0, "a", "other", True))
    assert tick(safety, 1) == [], "we never sent it anywhere"
    see(safety, 1, a=(5.0, 5.0))
    safety.allow(goto(5.0, 15.0, t_s=1))
    assert kinds(tick(safety, 2)) == [CallOperator]
    assert tick(safety, 3) == [], "once"
    for order in ("hold", "release", "withdraw"):
        safety = ready()
        safety.allow(goto(5.0, 15.0))
        safety.observe(Operator(0, order, "a"))  # type: ignore[arg-type]
        safety.observe(VehicleState(0, "a", "other", True))
        assert tick(safety, 1) == [], "the operator has ordered it"


@pytest.mark.parametrize(("after_s", "called"), [(9.9, False), (10.1, True)])
def test_after_resume_a_vehicle_has_ten_seconds_to_show_that_it_is_ours(after_s: float, called: bool) -> None:
    safety = ready()
    safety.allow(goto(5.0, 15.0))
    safety.observe(Operator(5 * S, "resume"))
    safety.observe(VehicleState(5 * S, "a", "other", True))
    see(safety, 5 + after_s, a=(5.0, 5.0))
    assert bool(tick(safety, 5 + after_s)) == called


def test_one_out_of_use_is_sent_home_once_and_said_so() -> None:
    safety = ready(replace(ALONE, pose_timeout_s=1000.0))
    see(safety, 30, a=(5.0, 25.0))
    safety.observe(VehicleState(30 * S, "a", "guided", True, True, 10.0))
    commands = [c for t in range(30, 40) for c in tick(safety, t)]
    assert kinds(commands) == [Hold, CallOperator, GoTo]
    assert commands[1].reason.endswith("its reserve is 25 %: it is sent home")  # type: ignore[union-attr]
    assert safety.robots["a"].ordered == "return"


def test_one_that_does_not_get_on_on_its_way_home_is_the_sequences_to_judge() -> None:
    safety = ready(replace(ALONE, stall_s=15.0))
    see(safety, 30, a=(5.0, 25.0))
    safety.observe(Operator(30 * S, "return"))
    safety.robots["a"].progress_ns = -600 * S
    assert tick(safety, 31) == []
    safety.returning.forget("a")
    assert kinds(tick(safety, 31.5)) == [Hold, CallOperator]


@pytest.mark.parametrize(
    ("area_m", "refused"),
    [
        (((-1.0, -1.0), (11.0, -1.0), (11.0, 9.0), (-1.0, 9.0)), True),
        (
            ((0.0, 0.0), (10.0, 0.0), (10.0, 7.7), (0.0, 7.7)),
            True,
        ),  # what is left is within the fence's margin
        (((0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0)), False),
    ],
)
def test_an_area_that_would_leave_a_robot_nowhere_to_be_is_refused_aloud(
    area_m: tuple[tuple[float, float], ...], refused: bool
) -> None:
    settings = SafetySettings(("a",), 10.0, 8.0, fence_margin_m=0.2)
    said = settings.forbids_closing(area_m)
    assert ("nothing was closed" in said) == refused
    assert settings.closed_too(area_m).margins.leaves_room != refused
