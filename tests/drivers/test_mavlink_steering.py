"""How a safe MAVLink fleet driver steers, and whom not: emulated rovers over UDP."""

import asyncio
import math

import pytest
from benches import FRAME, until
from fleet_bench import RATE, here, is_command, team

from drivers.emulators.rover import GUIDED, HOLD, MANUAL
from drivers.mavlink.codec import mavlink
from drivers.mavlink.fleet import open_link
from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceTimeout, VehicleRefused


async def test_must_steer_in_a_global_frame_with_integer_degrees():
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here(east_m=3.0, north_m=4.0))
        message = t.sent_to(t.rovers[0], "COMMAND_INT")[-1]
        lat_deg, lon_deg, _ = FRAME.to_geodetic(3.0, 4.0)
        assert message.command == mavlink.MAV_CMD_DO_REPOSITION
        assert message.frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
        assert (message.x, message.y) == (round(lat_deg * 1e7), round(lon_deg * 1e7))
        assert math.isnan(message.param4)
        assert not [m for m in t.sent_to(t.rovers[0]) if m.get_type().startswith("SET_POSITION_TARGET")]
        await until(lambda: math.dist((t.poses()[-1].east_m, t.poses()[-1].north_m), (3.0, 4.0)) < 0.15)


@pytest.mark.parametrize(
    "change",
    [
        {"east_m": math.nan},
        {"north_m": math.inf},
        {"speed_m_s": math.nan},
        {"speed_m_s": 0.0},
        {"up_m": math.nan},
    ],
)
async def test_must_refuse_a_place_that_is_none(change):
    async with team() as t:
        await t.link.acquire_control("ada")
        with pytest.raises(VehicleRefused):
            await t.link.goto("ada", here(**change))
        assert not t.sent_to(t.rovers[0], "COMMAND_INT")


async def test_must_never_send_latitude_0_longitude_0():
    clock = ScaledClock(RATE)
    from fieldkit.geo import FieldFrame
    from fieldkit.ports import DriverContext

    link = open_link(
        "udpin:127.0.0.1:1", {"ada": {"system_id": 1}}, DriverContext(clock, FieldFrame(0.0, 0.0))
    )
    with pytest.raises(VehicleRefused, match="latitude 0"):
        await link.goto("ada", here(east_m=0.0, north_m=0.0))


async def test_must_not_steer_what_was_not_taken_over():
    async with team() as t:
        with pytest.raises(VehicleRefused, match="control was not acquired"):
            await t.link.goto("ada", here())
        assert t.rovers[0].autopilot.mode == HOLD


async def test_must_lose_ownership_when_someone_else_changes_the_mode():
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here())
        t.rovers[0].autopilot.operator_sets(MANUAL)
        await until(lambda: t.mode() == "other")
        with pytest.raises(VehicleRefused, match="someone else"):
            await t.link.goto("ada", here())
        assert t.rovers[0].autopilot.mode == MANUAL


async def test_its_failsafe_is_named_where_this_computer_was_silent():
    async with team(gcs_failsafe_s=5.0) as t:
        await t.link.acquire_control("ada")
        t.beating = False
        await until(lambda: t.rovers[0].autopilot.mode == HOLD)
        t.beating = True
        await until(lambda: t.link._steered[1].vehicle.owner == "lost")
        with pytest.raises(
            VehicleRefused, match=r"its failsafe, or someone else; no heartbeat of ours for \d+ s"
        ):
            await t.link.goto("ada", here())


async def test_must_confirm_the_target_and_send_it_again():
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here(east_m=5.0, north_m=5.0))
        t.rovers[0].autopilot._aim(473977100, 85456100)  # as if the way-point had been overwritten
        wanted = t.link._steered[1].target
        await until(lambda: t.rovers[0].autopilot._target == wanted)


async def test_a_hold_overtakes_a_way_point_that_is_being_repeated():
    async with team() as t:
        await t.link.acquire_control("ada")
        t.rovers[0].drop_in = lambda data: is_command(data, mavlink.MAV_CMD_DO_REPOSITION)
        going = asyncio.create_task(t.link.goto("ada", here()))
        await t.sleep(0.5)
        await t.link.hold("ada")
        t.rovers[0].drop_in = lambda _: False
        with pytest.raises(VehicleRefused, match="newer command"):
            await going
        assert t.rovers[0].autopilot.mode == HOLD


async def test_hold_needs_no_ownership_and_is_repeated_until_seen():
    async with team() as t:
        t.rovers[0].autopilot.operator_sets(MANUAL)
        await until(lambda: t.mode() == "other")
        lost = iter([True, True])
        t.rovers[0].drop_in = lambda data: is_command(data, mavlink.MAV_CMD_DO_SET_MODE) and next(lost, False)
        await t.link.hold("ada")
        assert t.rovers[0].autopilot.mode == HOLD


async def test_after_a_hold_of_ours_steering_goes_on():
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.hold("ada")
        await until(lambda: t.mode() == "hold")
        await t.link.goto("ada", here())
        await until(lambda: t.mode() == "guided")


async def test_the_speed_asked_for_is_a_limit():
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here(north_m=30.0, speed_m_s=0.5))
        await until(lambda: t.rovers[0].autopilot.body.speed_m_s > 0.36)
        await t.sleep(2.0)
        assert t.rovers[0].autopilot.body.speed_m_s <= 0.5 + 1e-9


async def test_four_robots_hold_at_once():
    async with team(4) as t:
        names = t.link.robots
        await asyncio.gather(*(t.link.acquire_control(name) for name in names))
        await asyncio.gather(*(t.link.goto(name, here()) for name in names))
        began_s = t.clock.elapsed_s()
        await asyncio.gather(*(t.link.hold(name) for name in names))
        assert t.clock.elapsed_s() - began_s < 3.0
        assert {rover.autopilot.mode for rover in t.rovers} == {HOLD}


async def test_a_hold_that_was_lost_is_sent_again_when_the_link_is_back():
    """Nobody else has it: it still drives to our last way-point, though we have given up on it."""
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here(north_m=60.0))
        t.rovers[0].silenced = True
        with pytest.raises(DeviceTimeout):
            await t.link.hold("ada")
        assert t.rovers[0].autopilot.mode == GUIDED
        await until(lambda: not t.states()[-1].link_up)
        t.rovers[0].silenced = False
        await until(lambda: t.rovers[0].autopilot.mode == HOLD)
        assert t.mode() == "other", "stopped, but not resumed by itself"


async def test_a_standing_hold_is_no_reason_to_stop_somebody_elses_robot():
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.hold("ada")
        t.rovers[0].autopilot.operator_sets(MANUAL)
        await t.sleep(5.0)
        assert t.rovers[0].autopilot.mode == MANUAL
