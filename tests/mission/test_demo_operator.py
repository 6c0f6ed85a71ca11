"""The demo's operator: it resumes what stands for a machine that was busy, and nobody else."""

from types import SimpleNamespace
from typing import Any

import pytest

from fieldkit.clock import VirtualClock
from fieldkit.messages import Operator
from mission.lab.demo import RESUMES_S, PlayedOperator


def desk(*, called: bool, ordered: str, link_up: bool) -> tuple[PlayedOperator, VirtualClock, list[Operator]]:
    clock, orders = VirtualClock(), []
    robot = SimpleNamespace(called=called, ordered=ordered, vehicle=SimpleNamespace(link_up=link_up))
    runner: Any = SimpleNamespace(
        setup=SimpleNamespace(clock=clock), safety=SimpleNamespace(robots={"r1": robot}), put=orders.append
    )
    operator = PlayedOperator()
    operator.attach(runner)
    return operator, clock, orders


@pytest.mark.parametrize(
    ("called", "ordered", "link_up", "resumed"),
    [
        (True, "", True, True),
        (False, "withdraw", True, True),
        (False, "", True, False),
        (True, "hold", True, False),
        (True, "", False, False),
    ],
)
def test_it_resumes_who_waits_and_is_heard_for_a_while(
    called: bool, ordered: str, link_up: bool, resumed: bool
) -> None:
    operator, clock, orders = desk(called=called, ordered=ordered, link_up=link_up)
    operator.look()
    assert not orders, "not at once"
    clock.advance_to(round((RESUMES_S + 0.1) * 1e9))
    operator.look()
    assert [(each.action, each.robot) for each in orders] == ([("resume", "r1")] if resumed else [])
