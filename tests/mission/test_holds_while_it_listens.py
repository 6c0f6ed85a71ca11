"""What an operator orders while an agent that is started again still listens stands when it has learnt its log."""

import asyncio
from pathlib import Path

import pytest
from test_agent_runner import KEY, Robot, two
from test_ended_and_started_again import FAR, drives, end, give, one_log, put_far, until

from mission.shell import journal as journals
from mission.shell.agent_flight import card_of
from mission.shell.hold_all import hold_all


@pytest.mark.parametrize("where", ["in its own terminal", "by a computer without a log"])
def test_a_hold_is_not_lifted_by_an_older_resume_in_the_log_that_it_takes_up(
    tmp_path: Path, where: str
) -> None:
    """r2's journal has a hold and a resume from before. r2 listens for r1, which is out of reach, and is to hold."""

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        flights = [asyncio.create_task(r1.fly()), asyncio.create_task(r2.fly())]
        await until(r1, lambda: drives(r1) and drives(r2))
        give(r2, "hold")
        await until(r1, lambda: not drives(r2))
        await r1.clock.sleep(1.0)
        give(r2, "resume")
        await until(r1, lambda: drives(r2))
        end(r2)
        await flights[1]
        back = put_far(team, "r2")
        flights[1] = asyncio.create_task(r2.fly(left=r2.log / journals.NAME))
        await r1.clock.sleep(20.0)
        assert r2.runner is not None and not r2.runner.crew.agent.logs.has_begun, "it still listens"
        if where == "in its own terminal":
            give(r2, "hold")
        else:
            laptop, mine = r1.network._ether.member("laptop"), card_of(r1.mission, "r1", r1.clock)
            places = r1.network._ether._places_m
            r1.network._ether._places_m = lambda: {**places(), "laptop": (1000.0, 1.0)}
            said = await hold_all(("r1", "r2"), laptop, mine, KEY, r1.clock, 5.0)
            assert said == {"r1": "is not heard", "r2": "holds"}
            r1.network._ether._places_m = places
        for _ in range(600):
            await r1.clock.sleep(0.1)
            assert not drives(r2)
        assert r2.runner.crew.agent.logs.has_begun
        back()
        await r1.clock.sleep(5.0)
        assert not drives(r1) and not drives(r2)
        give(r1, "resume")
        await until(r1, lambda: drives(r1) and drives(r2), 20.0)
        await asyncio.gather(*flights)

    team = two(tmp_path, act, duration_s=250.0, air=FAR)
    one_log(tmp_path, team)
