"""Two computers say HOLD ALL at once: each is told that robots hold, and neither where they were let go."""

from pathlib import Path

import pytest

from fieldkit.engine.decentralised.logs import Logs
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import OPERATOR, Talk, code_of
from fieldkit.messages import Operator
from mission.core.agent import Agent
from mission.lab.synthetic import small_mission

START_NS = 1_800_000_000 * 10**9
KEY = session_key(bytes(32), "a mission")


@pytest.mark.parametrize("lets_go", ["resume", "return", "release"])
def test_who_asks_for_a_hold_is_told_that_it_stands_though_another_order_came_since(
    tmp_path: Path, lets_go: str
) -> None:
    settings = small_mission(tmp_path, robots=2).kernel
    robots = settings.engine.robots
    r1 = Agent(settings, Talk(Logs(robots[0], robots), Seal(KEY, 0)))
    laptop = Talk(Logs(robots[0], robots), Seal(KEY, OPERATOR))

    def say(action: str, at_s: int) -> int:
        """The code of an order that is said, and by which r1 acknowledges it."""
        order = quantised(Operator(START_NS + at_s * 10**9, action, None, "asked for"))  # type: ignore[arg-type]
        assert isinstance(order, Operator)
        r1.take(laptop.say_order(order, START_NS), START_NS)
        return code_of(order)

    first = say("hold", 1)
    assert say("hold", 2) == r1.talk.obeyed != first
    assert say("hold", 1) == r1.talk.obeyed == first, "the first one asks again"
    other = say(lets_go, 3)
    assert r1.talk.obeyed == other
    say("hold", 1)
    say("hold", 2)
    assert r1.talk.obeyed == other, "it holds no more"
