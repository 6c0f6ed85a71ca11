"""A vehicle that refuses to hold, or rolls on though it says that it holds: its agent's word is not that it holds."""

import asyncio
from pathlib import Path

import pytest
from test_agent_runner import KEY, Robot, both, two
from test_watching import Laptop, until

from fieldkit.errors import VehicleRefused
from fieldkit.messages import Operator, VehicleState
from fieldkit.settings import STANDS_M_S
from fieldkit.world.fakes import FakeFleet
from mission.core.holding import holds, rolls
from mission.shell.agent_flight import card_of
from mission.shell.alarms import LATE_STOP_S
from mission.shell.hold_all import hold_all


class Unruly(FakeFleet):
    """Vehicles that do what `does` says when they are told to hold."""

    does = "obeys"

    def stop(self, robot: str) -> None:
        if self.does == "obeys":
            super().stop(robot)
        elif self.does == "rolls on":
            self._set(robot, "hold")
        elif self.does == "is not ours":
            self.rovers[robot].stop()

    async def hold(self, robot: str) -> None:
        if self.does == "refuses":
            raise VehicleRefused(f"{robot}: change mode to hold: FAILED")
        self.stop(robot)

    def _state(self, robot: str) -> None:
        speed_m_s = self.rovers[robot].speed_m_s
        self._stream.put(
            VehicleState(
                self._clock.now_ns(), robot, self._mode[robot], self._armed[robot], speed_m_s=speed_m_s
            )
        )


@pytest.mark.parametrize("does", ["refuses", "rolls on"])
def test_a_robot_that_does_not_hold_is_named_by_all(tmp_path: Path, does: str) -> None:
    said: list[dict[str, str]] = []

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        r2.fleet = fleet = Unruly(r2.fleet.rovers, r2.clock)
        hand = r1.network._ether.member("hand")
        laptop = Laptop(team)
        places = r1.network._ether._places_m
        r1.network._ether._places_m = lambda: {**places(), "hand": (5.0, 5.0)}
        watching, flights = asyncio.create_task(laptop.watch()), asyncio.create_task(both(team))
        await until(
            r1, lambda: all(abs(robot.fleet.rovers[name].speed_m_s) > 0.3 for name, robot in team.items())
        )
        fleet.does, body = does, fleet.rovers["r2"]
        body.go_to(9.0, 9.0, 0.5)

        async def holds_all() -> None:
            mine = card_of(r1.mission, "r1", r1.clock)
            said.append(await hold_all(("r1", "r2"), hand, mine, KEY, r1.clock, 3.0))

        await holds_all()
        assert body.speed_m_s > STANDS_M_S
        assert r2.runner is not None and r1.runner is not None
        assert set(laptop.at.watcher.unheld()) == {"r2"}
        assert any("r2 has not shown for" in alarm for alarm in laptop.at.alarms())
        wanted = "has not shown for" if does == "refuses" else "r2 says that it holds, and moves at"
        await until(r1, lambda: any(wanted in alarm for alarm in r2.runner.alarms()), 4.0)  # type: ignore[union-attr]
        assert not r1.runner.alarms()
        assert r2.runner.crew.agent.talk.obeyed >= 0, "it has got the order"
        fleet.does = "obeys"
        fleet.stop("r2")
        await until(r1, lambda: not laptop.at.watcher.unheld(), LATE_STOP_S + 2.0)
        await holds_all()
        fleet.does = "rolls on"
        fleet.rovers["r2"].go_to(2.0, 2.0, 0.5)  # a slope
        await until(r1, lambda: set(laptop.at.watcher.unheld()) == {"r2"}, 4.0)
        fleet.does = "obeys"
        fleet.stop("r2")
        await until(r1, lambda: not laptop.at.watcher.unheld(), 4.0)
        for robot in team.values():
            assert robot.runner is not None
            robot.runner.put(Operator(r1.clock.now_ns(), "end", None, "enough"))
        laptop.order("end")
        await asyncio.gather(watching, flights)

    two(tmp_path, act, duration_s=300.0)
    assert said == [{"r1": "holds", "r2": "has not shown it"}, {"r1": "holds", "r2": "holds"}]


def test_one_that_says_nothing_of_its_speed_is_believed_by_its_mode() -> None:
    def state(mode: str, speed_m_s: float | None, flies: bool = False, link_up: bool = True) -> VehicleState:
        return VehicleState(0, "r1", mode, True, link_up, speed_m_s=speed_m_s, flies=flies)  # type: ignore[arg-type]

    assert holds(state("hold", None)) and holds(state("hold", STANDS_M_S)) and not holds(state("guided", 0.0))
    assert not holds(state("hold", 0.21)) and rolls(state("hold", 0.21)) and not rolls(state("guided", 1.0))
    assert holds(state("hold", 0.5, flies=True)) and rolls(state("hold", 0.51, flies=True))
    assert not holds(state("hold", 0.0, link_up=False))


def test_one_that_confirms_the_hold_and_shows_another_mode_is_named_by_its_own_agent(tmp_path: Path) -> None:
    """As one whose link was lost meanwhile: it is not ours until it is resumed."""

    async def act(team: dict[str, Robot]) -> None:
        r1, r2 = team["r1"], team["r2"]
        r2.fleet = fleet = Unruly(r2.fleet.rovers, r2.clock)
        flights = asyncio.create_task(both(team))
        await until(r1, lambda: abs(fleet.rovers["r2"].speed_m_s) > 0.3)
        fleet.does = "is not ours"
        assert r1.runner is not None and r2.runner is not None
        r1.runner.put(Operator(r1.clock.now_ns(), "hold", None, "stop"))
        fleet._set("r2", "other")
        wanted, why = "r2 has not shown for", "(its vehicle's mode is other)"
        await until(r1, lambda: any(wanted in each and why in each for each in r2.runner.alarms()), 8.0)  # type: ignore[union-attr]
        assert not r2.runner.dispatcher.unconfirmed()
        fleet.does = "obeys"
        fleet.stop("r2")
        await until(r1, lambda: not r2.runner.alarms(), 4.0)  # type: ignore[union-attr]
        for robot in team.values():
            assert robot.runner is not None
            robot.runner.put(Operator(r1.clock.now_ns(), "end", None, "enough"))
        await flights

    two(tmp_path, act, duration_s=300.0)
