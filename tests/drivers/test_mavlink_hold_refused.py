"""A vehicle that refuses to hold, or says that it holds and rolls on: what its link says is what it shows."""

import pytest
from benches import until
from fleet_bench import here, team

from drivers.emulators.profiles import PX4
from drivers.emulators.rover import GUIDED, HOLD
from fieldkit.errors import DeviceTimeout
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
