"""A vehicle's own failsafes, fence and clock are read, not assumed, before it is steered."""

import asyncio

import pytest
from benches import FRAME, around, free_udp_port, rovers_on_udp, until
from hypothesis import given
from hypothesis import strategies as st
from test_mavlink_plans import SQUARE_M, link_and_rover

from drivers.mavlink import inspect
from drivers.mavlink.codec import mavlink
from drivers.mavlink.fleet import open_link
from drivers.mavlink.plans import FENCE
from drivers.mavlink.timesync import best
from drivers.mavlink.vehicle import Vehicle
from fieldkit.clock import ScaledClock
from fieldkit.messages import VehicleState, Waypoint
from fieldkit.ports import Demands

DEMANDS = Demands(1.0, tuple(SQUARE_M), True, ((2.0, 2.0), (8.0, 8.0)))


async def test_a_fit_vehicle_has_its_fence_and_is_green_all_over():
    async with link_and_rover() as (link, rover):
        rover.autopilot.parameters["FS_GCS_ENABLE"] = 1.0
        await link.put_fence("ada", SQUARE_M)
        checks = await link.inspect("ada", DEMANDS)
        assert {check.level for check in checks} == {"green"}, checks
        assert {check.name for check in checks} >= {
            "failsafe",
            "battery failsafe",
            "fence",
            "fence action",
            "speed",
            "clock",
            "position",
            "EKF",
            "battery",
        }
        assert len(rover.autopilot.plans.items[FENCE]) == 4
        assert rover.autopilot.parameters["FENCE_ENABLE"] == 1.0
        assert not rover.autopilot.armed


async def test_looking_changes_nothing_in_the_vehicle():
    async with link_and_rover() as (link, rover):
        await link.upload_fence("ada", [(-30.0, -30.0), (30.0, -30.0), (0.0, 40.0)])
        held, before = list(rover.autopilot.plans.items[FENCE]), dict(rover.autopilot.parameters)
        await link.inspect("ada", Demands(1.0, tuple(SQUARE_M), False, tuple(SQUARE_M)))
        assert rover.autopilot.plans.items[FENCE] == held
        assert rover.autopilot.parameters == before


async def test_a_fence_that_a_team_had_is_back_after_a_mission():
    async with link_and_rover() as (link, rover):
        await link.upload_fence("ada", [(-30.0, -30.0), (30.0, -30.0), (0.0, 40.0)])
        own = await link.download("ada", FENCE)
        stored = await link.stored_fence("ada")
        await link.put_fence("ada", SQUARE_M)
        assert len(rover.autopilot.plans.items[FENCE]) == 4
        assert rover.autopilot.parameters["FENCE_ENABLE"] == 1.0
        await link.restore_fence(stored)
        assert await link.download("ada", FENCE) == own
        assert rover.autopilot.parameters["FENCE_ENABLE"] == 0.0


async def test_what_it_says_when_asked_counts_for_more_than_its_bit():
    """A simulated ArduCopter called itself ready, and refused to arm: "Need Position Estimate"."""
    async with link_and_rover() as (link, rover):
        asked = rover.autopilot._run_prearm_checks

        def complains(t_s):
            rover.autopilot.say("PreArm: Need Position Estimate", mavlink.MAV_SEVERITY_CRITICAL)
            return asked(t_s)

        rover.autopilot._run_prearm_checks = complains
        checks = {check.name: check for check in await link.inspect("ada")}
        assert checks["arming"].level == "red"
        assert checks["arming"].found == "PreArm: Need Position Estimate"


async def test_a_fence_is_put_into_a_vehicle_that_has_not_been_heard_yet():
    """A mission does so right after the link is opened."""
    clock, port = ScaledClock(20.0), free_udp_port()
    async with (
        open_link(f"udpin:127.0.0.1:{port}", {"ada": {"system_id": 1}}, around(clock)) as link,
        rovers_on_udp({1: (0.0, 0.0)}, clock, port) as rovers,
    ):
        await link.put_fence("ada", SQUARE_M)
        assert len(rovers[0].autopilot.plans.items[FENCE]) == 4


async def test_a_fence_of_its_own_inside_the_field_is_red():
    """It would stop there, in guided, without a word."""
    async with link_and_rover() as (link, _):
        await link.put_fence("ada", SQUARE_M)
        field = ((-5.0, -5.0), (20.0, 20.0))
        checks = {check.name: check for check in await link.inspect("ada", Demands(1.0, (), False, field))}
        assert checks["fence"].level == "red" and "inside the mission's field" in checks["fence"].found
        little = ((2.0, 2.0), (8.0, 8.0))
        checks = {check.name: check for check in await link.inspect("ada", Demands(1.0, (), False, little))}
        assert checks["fence"].level == "amber" and "stops up to 3.5 m" in checks["fence"].remedy
        room = ((4.0, 4.0), (6.0, 6.0))
        checks = {check.name: check for check in await link.inspect("ada", Demands(1.0, (), False, room))}
        assert checks["fence"].level == "green"


async def test_the_fence_that_mends_it_is_there_before_arming_is_judged():
    """A vehicle set up by docs/hardware.md: a fence enabled, none loaded yet. It says why once in 30 s."""
    async with link_and_rover() as (link, rover):
        rover.autopilot.parameters |= {"FS_GCS_ENABLE": 1.0, "FENCE_ENABLE": 1.0}
        await rover.clock.sleep(5.0)  # what it said by itself is over
        checks = {check.name: check for check in await link.inspect("ada")}
        assert checks["arming"].level == "red"
        assert checks["arming"].found == "PreArm: Fences enabled, but none selected"
        await link.put_fence("ada", SQUARE_M)
        checks = {check.name: check for check in await link.inspect("ada", DEMANDS)}
        assert checks["arming"].level == "green"


async def test_what_is_wrong_is_red_with_the_vehicles_own_words():
    async with link_and_rover() as (link, rover):
        rover.autopilot.parameters["FS_GCS_ENABLE"] = 0.0
        rover.autopilot.say("GPS 1: detected u-blox, armless", mavlink.MAV_SEVERITY_INFO)
        rover.autopilot.trouble.prearm = "PreArm: Compass not calibrated"
        rover.autopilot.lose_gps(True)
        rover.autopilot.battery_pct = 30.0
        checks = {check.name: check for check in await link.inspect("ada")}
        assert checks["failsafe"].level == "red"
        assert checks["position"].level == "red"
        assert checks["EKF"].level == "red"
        assert checks["battery"].level == "amber"
        assert checks["arming"].level == "red"
        assert checks["arming"].found == "PreArm: Compass not calibrated"


def test_a_vehicle_never_heard_is_nowhere_green():
    checks = inspect.condition(Vehicle("eve", 9, FRAME), 10.0)
    assert "green" not in {check.level for check in checks}, checks


async def test_one_that_answers_nothing_is_told_from_one_without_failsafes():
    """As a vehicle that wants signed frames is, from a station without the key."""
    async with link_and_rover() as (link, rover):
        rover.drop_in = lambda _: True
        checks = {check.name: check for check in await link.inspect("ada")}
        assert checks["failsafe"].level == "red"
        assert "answers nothing" in checks["failsafe"].found and "signing_key" in checks["failsafe"].remedy


async def test_voltage_and_measured_speed_are_in_the_state():
    async with link_and_rover() as (link, rover):
        rover.autopilot.trouble.battery_v, rover.autopilot.battery_pct = 9.0, 98.0
        seen = []

        async def listen():
            async for item in link.events():
                if isinstance(item, VehicleState):
                    seen.append(item)

        task = asyncio.create_task(listen())
        await link.acquire_control("ada")
        await link.goto("ada", Waypoint(30.0, 0.0, 0.7))
        await until(lambda: seen and seen[-1].speed_m_s and seen[-1].speed_m_s > 0.5)
        assert seen[-1].battery_v == pytest.approx(9.0) and seen[-1].battery_pct == 98.0
        assert not seen[-1].flies
        task.cancel()
        await asyncio.wait({task})


async def test_lost_frames_show_in_the_link():
    async with link_and_rover() as (link, rover):
        count = iter(range(10**6))
        send = rover.send
        rover.send = lambda data: send(data) if next(count) % 2 else None
        await rover.clock.sleep(60.0)
        checks = {check.name: check for check in await link.inspect("ada")}
        assert checks["link"].level in ("amber", "red")


@given(
    offset=st.integers(-(10**15), 10**15),
    ways=st.lists(st.tuples(st.integers(0, 10**9), st.integers(0, 10**9)), min_size=1, max_size=20),
)
def test_the_true_offset_lies_within_the_bound_whatever_the_asymmetry(offset, ways):
    exchanges = [
        (k * 10**10, k * 10**10 + up + offset, k * 10**10 + up + down) for k, (up, down) in enumerate(ways)
    ]
    found = best(exchanges)
    assert abs(found.offset_ns - offset) <= found.bound_ns + 1
    assert found.bound_ns <= min(up + down for up, down in ways) // 2 + 1


async def test_timesync_measures_the_vehicles_boot_clock():
    async with link_and_rover() as (link, rover):
        found = await link.synchronise("ada")
        sent_ns = link._clock.now_ns()
        theirs_ns = round((rover.t_s() - rover.autopilot.boot_s) * 1e9)
        assert abs(found.offset_ns - (theirs_ns - sent_ns)) <= found.bound_ns + 50_000_000
        assert found.exchanges == 10


async def test_a_vehicle_that_does_not_answer_timesync_is_amber():
    async with link_and_rover() as (link, rover):
        from drivers.mavlink.codec import Parser

        rover.drop_in = lambda data: any(m.get_type() == "TIMESYNC" for m in Parser().parse(data))
        checks = {check.name: check for check in await link.inspect("ada")}
        assert checks["clock"].level == "amber"


@pytest.mark.parametrize(
    ("ahead_s", "signs", "level"),
    [(0.8, True, "green"), (3600.0, False, "amber"), (3600.0, True, "red"), (-3600.0, True, "red")],
)
async def test_a_clock_that_would_lock_others_out_is_found(ahead_s, signs, level):
    async with link_and_rover() as (link, rover):
        rover.autopilot.utc_s = rover.clock.start_ns * 1e-9 - ahead_s
        vehicle = link._steered[1].vehicle
        await until(lambda: vehicle.utc_ahead_s is not None)
        (check,) = inspect.time_of_day(vehicle, signs)
        assert check.level == level
        if level != "green":
            assert "3,600 s" in check.found and check.remedy
        assert "time of day" in {check.name for check in await link.inspect("ada")}


def test_a_vehicle_without_gps_time_says_nothing_of_our_clock():
    assert inspect.time_of_day(Vehicle("ada", 1, FRAME), True) == []
