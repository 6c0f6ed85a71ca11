"""What stops a robot stops it on its way home as well: a lost position, a lost link, the fence."""

from dataclasses import replace

import pytest
from homeward import LIMITS, leaving
from small_field import Field, S

from fieldkit.messages import CallOperator, Command, GoTo, Hold, Operator
from mission.safety.return_sequence import ReturnSequence


def homeward() -> tuple[Field, int]:
    """A field in which a drives home, 10 m to go; and how many commands led to that."""
    field = Field()
    field.at["a"] = (2.0, 15.0)
    field.tick(5)
    field.carry_out(field.safety.observe(Operator(field.t_s * S, "return", "a")))
    field.tick(2)
    assert field.mode["a"] == "guided" and field.goal["a"] == (2.0, 2.0)
    return field, len(field.log)


def of_a(commands: list[Command]) -> list[type[Command]]:
    return [type(command) for command in commands if getattr(command, "robot", "") == "a"]


def test_one_whose_position_is_lost_holds_and_goes_on_when_it_is_back() -> None:
    field, told = homeward()
    field.dumb.add("a")
    field.tick(20)
    assert of_a(field.log[told:]) == [Hold], "nor is it left to its own return, of which nobody would know"
    place = field.at["a"]
    field.dumb.clear()
    field.tick(5)
    assert of_a(field.log[told:]) == [Hold, GoTo] and field.at["a"] != place
    field.tick(60)
    assert field.at["a"] == pytest.approx((2.0, 2.0), abs=1.0)


def test_the_operator_is_called_once_for_one_that_stays_without_a_position() -> None:
    field, told = homeward()
    field.dumb.add("a")
    field.tick(100)
    assert of_a(field.log[told:]) == [Hold, CallOperator]


def test_one_told_home_without_a_position_does_not_set_out() -> None:
    field = Field()
    field.dumb.add("a")
    field.tick(10)
    told = len(field.log)
    field.carry_out(field.safety.observe(Operator(field.t_s * S, "return", "a")))
    field.tick(5)
    assert of_a(field.log[told:]) == [Hold]
    assert field.safety.returning.waiting == {"a": "operator: return"}


def test_a_position_that_jumps_stops_it_until_it_has_settled() -> None:
    field, told = homeward()
    field.at["a"] = (18.0, 15.0)
    field.tick(1)
    assert of_a(field.log[told:]) == [Hold]
    field.tick(6)
    assert of_a(field.log[told:]) == [Hold, GoTo]


def test_one_that_is_not_heard_is_told_to_hold() -> None:
    team = leaving()
    team.says("a", "guided", link_up=False)
    (hold,) = team.step(1.0)
    assert isinstance(hold, Hold) and "link is down" in hold.reason
    assert team.step(10.0) == []
    team.says("a", "hold")
    assert team.step(1.0) == [team.goto("a", (5.0, 5.0))]


def test_one_that_leaves_the_field_holds_and_the_second_time_stays() -> None:
    """As far as a robot is told to go back in, and does not: the operator's business."""
    field, told = homeward()
    for _ in range(30):
        if (goal := field.goal["a"]) is not None:  # it drives west, wherever it is told to go
            field.goal["a"] = (-50.0, goal[1])
        field.tick()
    assert of_a(field.log[told:]) == [Hold, GoTo, Hold, CallOperator]
    assert field.at["a"][0] > -4.0
    assert "a" not in field.safety.returning


def test_asking_anew_forgets_what_has_been() -> None:
    sequence = ReturnSequence()
    sequence.ask("a", "low")
    sequence.strayed.add("a")
    sequence.not_before_ns["a"] = S
    sequence.forget("a")
    assert not sequence.strayed and not sequence.not_before_ns


def test_one_that_lands_is_not_stopped() -> None:
    limits = replace(LIMITS, altitude_m={"a": 10.0})
    team = leaving(settings=limits)
    team.sequence.under_way["a"].lands = True
    team.says("a", "land", link_up=False)
    assert team.step(1.0) == []


@pytest.mark.parametrize("pct", [None, 20.0])
def test_the_operator_is_called_for_one_that_its_own_failsafe_stops(pct: float | None) -> None:
    """Also where the operator was called before, because it went home."""
    field, _ = homeward()
    field.battery["a"] = pct
    field.tick(2)
    told = len(field.log)
    field.mode["a"] = "other"
    field.tick(10)
    assert of_a(field.log[told:]) == [CallOperator]
    assert "not ours to steer" in field.said(CallOperator, "a")[-1] and "a" not in field.safety.returning


def test_one_behind_another_that_has_lost_its_position_is_not_given_up_at_once() -> None:
    field = Field()
    field.at["a"], field.at["b"] = (2.0, 10.0), (2.0, 12.0)
    field.home["b"] = field.safety.robots["b"].home_m = (2.0, 4.0)  # type: ignore[assignment]
    field.tick(5)
    field.ask("return")
    field.tick(2)
    field.dumb.add("a")
    field.tick(8)
    assert not field.said(CallOperator, "b") and "b" in field.safety.returning.waiting
    field.dumb.clear()
    field.tick(60)
    assert not field.said(CallOperator, "b") and field.at["b"][1] < 5.5


def test_one_behind_another_that_stays_lost_is_given_up_when_the_operator_has_been_called() -> None:
    field = Field()
    field.at["a"], field.at["b"] = (2.0, 10.0), (2.0, 12.0)
    field.home["b"] = field.safety.robots["b"].home_m = (2.0, 4.0)  # type: ignore[assignment]
    field.tick(5)
    field.dumb.add("a")
    field.ask("return")
    field.tick(25)
    assert not field.said(CallOperator, "b")
    field.tick(15)
    assert len(field.said(CallOperator, "a")) == len(field.said(CallOperator, "b")) == 1


@pytest.mark.parametrize(("silent_s", "stops"), [(3, False), (4, True)])
def test_one_that_nobody_steered_for_a_while_holds_and_then_goes_on_home(silent_s: int, stops: bool) -> None:
    """The loop was late, and nothing else: where it is has been known all along."""
    field, told = homeward()
    place = field.at["a"]
    field.t_s += silent_s - 1
    field.tick()
    assert of_a(field.log[told:]) == ([Hold] if stops else [])
    field.tick(5)
    assert of_a(field.log[told:]) == ([Hold, GoTo] if stops else [])
    assert field.at["a"] != place


def test_one_that_ignores_our_speed_is_stopped_and_the_second_time_it_stays() -> None:
    """The limit is 0.5 m/s, it says 1.5."""
    field, told = homeward()

    field.says_m_s["a"] = 1.5
    field.tick(5)
    assert of_a(field.log[told:]) == [Hold]
    field.says_m_s.clear()
    field.tick(5)
    assert of_a(field.log[told:]) == [Hold, GoTo]
    field.says_m_s["a"] = 1.5
    field.tick(5)
    assert of_a(field.log[told:]) == [Hold, GoTo, Hold, CallOperator]
    field.says_m_s.clear()
    field.tick(10)
    assert of_a(field.log[told:]) == [Hold, GoTo, Hold, CallOperator]


def test_its_own_return_has_a_speed_of_its_own() -> None:
    field, told = homeward()
    field.safety.returning.under_way["a"].by_itself = True
    field.mode["a"] = "return"
    field.says_m_s["a"] = 1.5
    field.tick(8)
    assert of_a(field.log[told:]) == []
