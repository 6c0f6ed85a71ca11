"""At the end nothing hangs in the air, and nobody is ordered to hold while its motors are stopping."""

from dataclasses import replace
from pathlib import Path

from fieldkit.messages import Event, Operator, Tick, VehicleState
from mission.lab.synthetic import small_mission
from mission.safety.rules import Safety
from mission.shell.landing import DISARM_S, LANDING_S, Landing

S = 10**9


def scene(folder: Path) -> tuple[Safety, Landing, list[Event]]:
    """r1 flies, the others drive."""
    settings = replace(small_mission(folder, duration_s=5.0).safety, altitude_m={"r1": 10.0})
    safety, asked = Safety(settings), list[Event]()
    return safety, Landing(safety, asked.append, lambda level, text: None, {"r1"}), asked


def seen(safety: Safety, t_s: float, *, armed: bool, on_ground: bool | None) -> None:
    state = VehicleState(round(t_s * S), "r1", "land", armed, False, None, "", on_ground=on_ground)
    safety.observe(state)


def is_over(landing: Landing, t_s: float, event: Event | None = None) -> tuple[bool, list[str]]:
    return landing.is_over(round(t_s * S), event or Tick(round(t_s * S)))


def test_what_flies_goes_home_and_is_waited_for(tmp_path: Path) -> None:
    safety, landing, asked = scene(tmp_path)
    seen(safety, 1.0, armed=True, on_ground=False)
    landing.begin(1 * S, 1 * S, "found all")
    assert [(event.action, event.robot) for event in asked if isinstance(event, Operator)] == [
        ("return", "r1")
    ]
    assert is_over(landing, 2.0) == (False, ["r1"])
    assert is_over(landing, 2.0 + LANDING_S) == (True, ["r1"])


def test_one_that_is_down_is_left_alone_until_its_motors_stop(tmp_path: Path) -> None:
    safety, landing, _ = scene(tmp_path)
    seen(safety, 1.0, armed=True, on_ground=False)
    landing.begin(1 * S, 1 * S, "found all")
    seen(safety, 10.0, armed=True, on_ground=True)
    assert is_over(landing, 10.0) == (False, [])
    assert is_over(landing, 9.9 + DISARM_S) == (False, [])
    seen(safety, 12.0, armed=False, on_ground=True)
    assert is_over(landing, 12.0) == (True, [])


def test_motors_that_go_on_are_not_waited_for_for_ever(tmp_path: Path) -> None:
    safety, landing, _ = scene(tmp_path)
    seen(safety, 10.0, armed=True, on_ground=True)
    landing.begin(10 * S, 10 * S, "found all")
    assert is_over(landing, 10.0) == (False, [])
    assert is_over(landing, 10.1 + DISARM_S) == (True, [])


def test_the_operator_does_not_have_to_wait(tmp_path: Path) -> None:
    safety, landing, _ = scene(tmp_path)
    seen(safety, 10.0, armed=True, on_ground=True)
    landing.begin(10 * S, 10 * S, "found all")
    assert is_over(landing, 10.0) == (False, [])
    assert is_over(landing, 11.0, Operator(11 * S, "end", None, "now"))[0]


def test_one_that_is_not_ours_any_more_is_named_and_not_waited_for(tmp_path: Path) -> None:
    safety, landing, _ = scene(tmp_path)
    seen(safety, 1.0, armed=True, on_ground=False)
    landing.begin(1 * S, 1 * S, "found all")
    safety.observe(VehicleState(2 * S, "r1", "other", True, True, None, "", on_ground=False))
    assert is_over(landing, 2.0) == (True, []) and landing.not_ours() == ["r1"]


def test_a_robot_that_another_computer_steers_is_not_waited_for(tmp_path: Path) -> None:
    safety, _, asked = scene(tmp_path)
    seen(safety, 0.0, armed=True, on_ground=False)
    others = Landing(safety, asked.append, lambda level, text: None, {"r2"})
    others.begin(0, 0, "over")
    assert asked == [] and is_over(others, 1.0) == (True, [])
