"""A vehicle that refuses to hold, or says that it holds and rolls on: what its link says is what it shows."""

import pytest
from benches import FRAME, until
from fleet_bench import here, team
from test_mavlink_parts import PEER, heartbeat, position

from drivers.emulators.profiles import PX4
from drivers.emulators.rover import GUIDED, HOLD
from drivers.mavlink.vehicle import STATE_EVERY_S, Vehicle
from fieldkit.errors import DeviceTimeout
from fieldkit.messages import VehicleState
from fieldkit.settings import STANDS_M_S
from mission.core.holding import holds, rolls


async def drives(t, **place):
    await t.link.acquire_control("ada")
    await t.link.goto("ada", here(**place))
    await until(lambda: t.rovers[0].autopilot.body.speed_m_s > 2.0 * STANDS_M_S)


async def test_a_hold_that_is_refused_is_asked_for_again_and_shown_by_nothing():
    async with team() as t:
        await drives(t, north_m=60.0)
        autopilot = t.rovers[0].autopilot
        autopilot.trouble.refuses_hold = True
        with pytest.raises(DeviceTimeout, match="did not show mode hold"):
            await t.link.hold("ada")
        assert autopilot.mode == GUIDED and not holds(t.states()[-1])
        autopilot.trouble.refuses_hold = False
        await until(lambda: autopilot.mode == HOLD)
        await until(lambda: holds(t.states()[-1]))


async def test_px4_that_refuses_its_pause_and_drives_on_has_not_shown_that_it_holds():
    async with team(profile=PX4) as t:
        await drives(t, north_m=60.0)
        t.rovers[0].autopilot.trouble.refuses_hold = True
        with pytest.raises(DeviceTimeout, match="did not show mode hold"):
            await t.link.hold("ada")
        assert not holds(t.states()[-1])


async def test_one_that_rolls_on_in_its_hold_mode_is_known_by_its_speed():
    async with team() as t:
        await drives(t, north_m=60.0)
        t.rovers[0].autopilot.trouble.rolls_on = True
        await t.link.hold("ada")
        count = len(t.states())
        await until(lambda: len(t.states()) >= count + 3)
        assert rolls(t.states()[-1]) and not holds(t.states()[-1])
        t.rovers[0].autopilot.trouble.rolls_on = False
        await until(lambda: holds(t.states()[-1]))


@pytest.mark.parametrize(("mode", "is_news"), [(HOLD, True), (GUIDED, False)])
def test_that_it_has_come_to_stand_in_its_hold_mode_is_said_at_once(mode, is_news):
    vehicle = Vehicle("ada", 1, FRAME)

    def heard(message, at_s):
        happened = vehicle.heard(message, PEER, at_s, round(at_s * 1e9))
        return [item.speed_m_s for item in happened if isinstance(item, VehicleState)]

    def at(boot_ms, speed_m_s):
        message = position(boot_ms)
        message.vx = round(100 * speed_m_s)
        return message

    assert len(heard(heartbeat(mode), 0.0)) == 1
    heard(at(100, 0.6), 0.1)
    assert heard(at(150, 0.5), 0.15) == []
    assert STATE_EVERY_S > 0.2 and heard(at(200, STANDS_M_S), 0.2) == ([STANDS_M_S] if is_news else [])
    assert heard(at(250, 0.0), 0.25) == []
