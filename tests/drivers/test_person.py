"""A person behind the vehicle port: advice in place of way-points, and nothing to arm, fence or fly."""

import asyncio

import pytest

from drivers.person.link import open_people
from fieldkit.clock import ScaledClock
from fieldkit.errors import ConfigError, VehicleRefused
from fieldkit.geo import FieldFrame
from fieldkit.messages import VehicleState, Waypoint
from fieldkit.ports import DriverContext, VehicleLink


def context() -> DriverContext:
    return DriverContext(ScaledClock(50.0), FieldFrame(0.0, 0.0))


async def test_way_points_are_advice_and_a_hold_takes_it_back() -> None:
    async with open_people("page", {"ada": {}, "bob": {}}, context()) as link:
        assert isinstance(link, VehicleLink)
        await link.acquire_control("ada")
        await link.goto("ada", Waypoint(3.0, 4.0, 1.2))
        assert link.advice == {"ada": Waypoint(3.0, 4.0, 1.2), "bob": None}
        await link.hold("ada")
        assert link.advice["ada"] is None
        await link.return_home("bob")
        link.release("bob")
        states: list[VehicleState] = []
        async with asyncio.timeout(10.0):
            async for event in link.events():
                assert isinstance(event, VehicleState)
                states.append(event)
                if len(states) > 12:
                    break
    modes = {name: [s.mode for s in states if s.robot == name] for name in ("ada", "bob")}
    assert modes["ada"][:3] == ["guided", "guided", "hold"] and modes["ada"][-1] == "hold"
    assert modes["bob"][:2] == ["return", "other"]
    assert not any(state.flies for state in states)


async def test_what_makes_no_sense_for_a_person_is_refused() -> None:
    async with open_people("page", {"ada": {}}, context()) as link:
        for asked in (
            link.take_off("ada", 5.0),
            link.land("ada"),
            link.goto("ada", Waypoint(float("nan"), 0.0, 1.0)),
            link.goto("eve", Waypoint(1.0, 1.0, 1.0)),
        ):
            with pytest.raises(VehicleRefused):
                await asked
        assert (await link.stored_fence("ada")).items == ()
        assert [check.level for check in await link.inspect("ada")] == ["green"]
    with pytest.raises(ConfigError, match="unknown option 'system_id'"):
        open_people("page", {"ada": {"system_id": 1}}, context())


async def test_closing_ends_the_events_and_leaves_nothing() -> None:
    link = open_people("page", {"ada": {}}, context())
    async with link:
        consumer = asyncio.create_task(_all(link))
        await asyncio.sleep(0.05)
    await asyncio.wait_for(consumer, 5.0)


async def _all(link: VehicleLink) -> int:
    return len([event async for event in link.events()])
