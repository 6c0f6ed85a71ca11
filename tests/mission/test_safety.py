"""Safety: no command passes it that should not, and it acts by itself when a robot must stop."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldkit.messages import CallOperator, GoTo, Hold, Operator, Pose, Return, Tick, VehicleState, Waypoint
from mission.safety.limits import BatteryLimits, SafetySettings
from mission.safety.rules import Safety

S = 1_000_000_000
LIMITS = SafetySettings(
    ("a", "b"), 10.0, 8.0, fence_margin_m=0.5, max_speed_m_s=0.4, max_leg_m=6.0, pose_timeout_s=2.0
)


def ready(t_ns: int = 0) -> Safety:
    safety = Safety(LIMITS)
    for robot, east in (("a", 2.0), ("b", 6.0)):
        safety.observe(VehicleState(t_ns, robot, "guided", True))
        safety.observe(Pose(t_ns, robot, east, 2.0))
    return safety


def goto(east: float, north: float, speed: float = 0.3, robot: str = "a", t_ns: int = 0) -> GoTo:
    return GoTo(t_ns, robot, Waypoint(east, north, speed))


def test_a_good_command_passes_unchanged() -> None:
    assert ready().allow(goto(3.0, 4.0)) == goto(3.0, 4.0)


@given(
    east=st.floats(allow_nan=True, allow_infinity=True),
    north=st.floats(allow_nan=True, allow_infinity=True),
    speed=st.floats(allow_nan=True, allow_infinity=True),
)
def test_nothing_leaves_the_fence_or_exceeds_speed_and_leg(east: float, north: float, speed: float) -> None:
    allowed = ready().allow(goto(east, north, speed))
    if isinstance(allowed, Hold):
        assert not all(map(math.isfinite, (east, north, speed))) or "comes within" in allowed.reason
        return
    assert isinstance(allowed, GoTo)
    target = allowed.waypoint
    assert 0.5 <= target.east_m <= 9.5 and 0.5 <= target.north_m <= 7.5
    assert 0.0 <= target.speed_m_s <= 0.4
    assert math.hypot(target.east_m - 2.0, target.north_m - 2.0) <= 6.0 + 1e-9


def test_a_stale_pose_holds_a_moving_robot_once_and_again_until_it_holds() -> None:
    safety = ready()
    safety.allow(goto(3.0, 4.0))
    assert safety.observe(Tick(1 * S)) == []
    holds = safety.observe(Tick(3 * S))
    assert {h.robot for h in holds} == {"a", "b"}, "one that is free to move is held too"
    assert all("old" in h.reason for h in holds)
    assert safety.observe(Tick(4 * S)) == []
    repeated = [c for c in safety.observe(Tick(7 * S)) if c.robot == "a"]
    assert repeated, "a hold that the vehicle has not confirmed is repeated"
    safety.observe(VehicleState(7 * S, "a", "hold", True))
    assert [c for c in safety.observe(Tick(12 * S)) if c.robot == "a"] == []


def test_a_lost_link_holds_and_refuses_new_targets() -> None:
    safety = ready()
    safety.allow(goto(3.0, 4.0))
    safety.observe(VehicleState(S, "a", "guided", True, link_up=False, text="no heartbeat for 5 s"))
    holds = safety.observe(Tick(S))
    assert [h.robot for h in holds] == ["a"] and "link" in holds[0].reason
    assert isinstance(safety.allow(goto(3.0, 4.0)), Hold)
    assert isinstance(safety.allow(goto(7.0, 3.0, robot="b", t_ns=S)), GoTo), "the other goes on"


def test_an_unknown_position_or_robot_gets_no_target() -> None:
    assert isinstance(Safety(LIMITS).allow(goto(3.0, 4.0)), Hold)
    assert isinstance(ready().allow(goto(3.0, 4.0, robot="stranger")), Hold)


def test_a_moving_robot_outside_the_fence_is_held() -> None:
    safety = ready()
    safety.allow(goto(3.0, 4.0))
    safety.observe(Pose(4 * S, "a", 2.0, 4.5))
    safety.observe(Pose(8 * S, "a", 2.0, 8.2))
    for robot in ("a", "b"):
        safety.observe(Pose(8 * S, robot, 2.0 if robot == "a" else 6.0, 8.2 if robot == "a" else 2.0))
    assert safety.observe(Tick(8 * S)) == [], "one position may be wrong"
    safety.observe(Pose(10 * S, "a", 2.0, 8.2))
    safety.observe(Pose(10 * S, "b", 6.0, 2.0))
    (hold,) = safety.observe(Tick(10 * S))
    assert isinstance(hold, Hold) and "outside the fence" in hold.reason


def test_a_robot_deep_outside_is_held_at_once() -> None:
    safety = ready()
    safety.allow(goto(3.0, 7.0))
    safety.observe(Pose(4 * S, "a", 2.0, 5.0))
    safety.observe(Pose(8 * S, "a", 2.0, 8.7))
    safety.observe(Pose(8 * S, "b", 6.0, 2.0))
    (hold,) = safety.observe(Tick(8 * S))
    assert isinstance(hold, Hold) and "outside the fence" in hold.reason


def test_noise_across_the_fence_holds_nobody() -> None:
    safety = ready()
    safety.allow(goto(2.0, 7.5))
    for step in range(60):
        north = 7.95 + 0.3 * (-1) ** step
        safety.observe(Pose(step * S, "a", 2.0, north, sigma_m=0.3))
        safety.observe(Pose(step * S, "b", 6.0, 2.0))
        assert not [c for c in safety.observe(Tick(step * S)) if isinstance(c, Hold) and "fence" in c.reason]


@pytest.mark.parametrize("north", [8.05, 8.5, 11.0])
def test_a_way_back_in_is_always_allowed(north: float) -> None:
    safety = ready()
    safety.observe(Pose(60 * S, "a", 2.0, north))
    safety.observe(Pose(70 * S, "a", 2.0, north))
    back = safety.allow(goto(2.0, 6.0, t_ns=70 * S))
    assert isinstance(back, GoTo)
    for second in range(71, 80):  # it drives in, and nobody stops it
        north -= 0.3
        safety.observe(Pose(second * S, "a", 2.0, north))
        safety.observe(Pose(second * S, "b", 6.0, 2.0))
        assert safety.observe(Tick(second * S)) == []


def test_a_way_back_that_leads_deeper_is_none() -> None:
    safety = ready()
    safety.observe(Pose(60 * S, "a", 2.0, 8.6))
    safety.observe(Pose(70 * S, "a", 2.0, 8.6))
    assert isinstance(safety.allow(goto(2.0, 6.0, t_ns=70 * S)), GoTo)
    assert safety.settings.margins.permits((2.0, 8.6), (2.0, 6.0))
    assert not safety.settings.margins.permits((2.0, 8.6), (4.0, 9.5))


def test_a_robot_faster_than_told_is_held_with_its_speed() -> None:
    safety = ready()
    safety.allow(goto(9.0, 7.0))
    said: list[str] = []
    for second in range(1, 12):
        safety.observe(Pose(second * S, "a", 2.0 + 0.9 * second, 2.0))
        safety.observe(Pose(second * S, "b", 6.0, 7.0))
        said += [c.reason for c in safety.observe(Tick(second * S)) if isinstance(c, Hold)]
    assert any("m/s where the limit is 0.4" in reason for reason in said)


def test_a_sinking_voltage_sends_home_where_per_cent_say_nothing() -> None:
    safety = Safety(SafetySettings(("a",), 10.0, 8.0, battery=BatteryLimits(low_v=10.5)))
    safety.observe(Pose(0, "a", 2.0, 2.0))
    safety.observe(Pose(60 * S, "a", 5.0, 5.0))
    safety.observe(VehicleState(60 * S, "a", "guided", True, True, 98.0, battery_v=10.4))
    commands = safety.observe(Tick(60 * S))
    assert any(isinstance(c, CallOperator) and "10.4 V" in c.reason for c in commands)
    assert any(isinstance(c, GoTo) for c in commands)


def test_a_robot_that_is_being_acquired_anew_is_not_thrown_out_for_its_old_mode() -> None:
    safety = ready()
    safety.allow(goto(3.0, 4.0))
    safety.observe(VehicleState(S, "a", "other", True, reason="its mode is MANUAL"))
    (call,) = safety.observe(Tick(S))
    assert isinstance(call, CallOperator) and call.reason.endswith("its mode is MANUAL")
    safety.observe(Operator(2 * S, "resume"))
    for robot, east in (("a", 2.0), ("b", 6.0)):
        safety.observe(Pose(3 * S, robot, east, 2.0))
    assert safety.observe(Tick(3 * S)) == [], "its acquisition takes round trips"
    for robot, east in (("a", 2.0), ("b", 6.0)):
        safety.observe(Pose(14 * S, robot, east, 2.0))
    assert [c.robot for c in safety.observe(Tick(14 * S)) if isinstance(c, CallOperator)] == ["a"]


def test_of_two_robots_too_near_the_later_named_one_holds() -> None:
    safety = ready()
    for robot in ("a", "b"):
        safety.allow(goto(3.0, 4.0, robot=robot))
    safety.observe(Pose(S, "a", 3.0, 3.0))
    safety.observe(Pose(S, "b", 3.1, 3.0))
    holds = safety.observe(Tick(S))
    assert [h.robot for h in holds] == ["b"]


def test_the_operators_hold_stands_until_resumed() -> None:
    safety = ready()
    assert {c.robot for c in safety.observe(Operator(S, "hold"))} == {"a", "b"}
    assert isinstance(safety.allow(goto(3.0, 4.0)), Hold)
    safety.observe(Operator(S, "resume", "a"))
    assert isinstance(safety.allow(goto(3.0, 4.0)), GoTo)
    assert isinstance(safety.allow(goto(3.0, 4.0, robot="b")), Hold)


def test_return_is_ordered_once_and_not_undone_by_holds() -> None:
    safety = ready()
    for robot, east in (("a", 2.0), ("b", 6.0)):
        safety.observe(Pose(60 * S, robot, east, 6.0))
    commands = safety.observe(Operator(60 * S, "return"))
    assert {c.robot for c in commands if isinstance(c, Hold)} == {"a", "b"}, "all stop first"
    assert {c.robot for c in commands if isinstance(c, GoTo)} == {"a", "b"}, "their paths are far apart"
    assert not any(isinstance(c, Return) for c in commands), "by our own way-points, at the mission's speed"
    assert all(c.waypoint.speed_m_s == 0.4 for c in commands if isinstance(c, GoTo))
    safety.observe(VehicleState(60 * S, "a", "guided", True))
    assert [c for c in safety.observe(Tick(62 * S)) if c.robot == "a"] == []


@pytest.mark.parametrize("action", ["hold", "end"])
def test_end_holds_everything(action: str) -> None:
    safety = ready()
    assert len(safety.observe(Operator(S, action))) == 2  # type: ignore[arg-type]
