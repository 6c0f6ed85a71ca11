"""An operator's order at an agent that is just ending is said at once, and goes on from robot to robot all the same."""

import asyncio
from pathlib import Path

from test_agent_runner import Robot, both, two

from fieldkit.engine.decentralised.logs import Logs, Stream
from fieldkit.messages import Operator
from mission.shell import journal as journals


def actions(logs: Logs) -> list[str]:
    """Orders in r1's log."""
    return [e.event.action for e in logs.entries["r1", Stream.ORDERS] if isinstance(e.event, Operator)]


def test_a_hold_at_an_agent_that_ends_is_in_its_log(tmp_path: Path) -> None:
    async def act(team: dict[str, Robot]) -> None:
        flights = asyncio.create_task(both(team))
        r1, r2 = team["r1"], team["r2"]
        await r1.clock.sleep(12.0)
        assert r1.runner is not None and r2.runner is not None
        r1.runner.put(Operator(r1.clock.now_ns(), "end", None, "End on its page"))
        while not r1.runner.end_reason:
            await r1.clock.sleep(0.01)
        r1.runner.put(Operator(r1.clock.now_ns(), "hold", None, "HOLD ALL on its page"))
        await r1.clock.sleep(5.0)
        assert r2.fleet.rovers["r2"].target_m is None
        assert actions(r2.runner.crew.agent.logs) == ["withdraw", "hold"], "whom it meets learns of it"
        r2.runner.put(Operator(r1.clock.now_ns(), "end", None, "enough"))
        await flights

    team = two(tmp_path, act, duration_s=60.0)
    path, logs = team["r1"].log / journals.NAME, Logs("r1", ("r1", "r2"))
    journals.load(path, logs)
    assert actions(logs) == ["withdraw", "hold"] and journals.is_ended(path)
