"""A vehicle's own failsafes, fence and clock are read, not assumed, before it is steered."""

import pytest
from benches import FRAME, until
from hypothesis import given
from hypothesis import strategies as st
from test_mavlink_plans import SQUARE_M, link_and_rover

from drivers.mavlink import inspect
from drivers.mavlink.modes import COPTER, PX4, ROVER
from drivers.mavlink.plans import FENCE
from drivers.mavlink.timesync import best
from drivers.mavlink.vehicle import Vehicle

GOOD = {
    "FS_GCS_ENABLE": 1.0,
    "FS_ACTION": 2.0,
    "FS_GCS_TIMEOUT": 5.0,
    "BATT_FS_LOW_ACT": 2.0,
    "MAV_GCS_SYSID": 245.0,
}


def levels(checks, name="failsafe"):
    return [check.level for check in checks if check.name == name]


def test_a_rover_that_stops_by_itself_is_green():
    assert levels(inspect.failsafes("ada", ROVER, GOOD, 245)) == ["green"]


@pytest.mark.parametrize(
    ("change", "level"),
    [
        ({"FS_GCS_ENABLE": 0.0}, "red"),
        ({"FS_ACTION": 0.0}, "red"),
        ({"FS_GCS_ENABLE": None}, "red"),
        ({"MAV_GCS_SYSID": 255.0}, "red"),
        ({"BATT_FS_LOW_ACT": 0.0}, "amber"),
        ({"FS_GCS_TIMEOUT": 30.0}, "amber"),
    ],
)
def test_what_keeps_a_rover_driving_when_we_are_dead_is_found(change, level):
    (check,) = inspect.failsafes("ada", ROVER, GOOD | change, 245)
    assert check.level == level and check.remedy


def test_a_range_of_ground_stations_and_the_older_parameters_name_are_understood():
    assert levels(
        inspect.failsafes("ada", ROVER, GOOD | {"MAV_GCS_SYSID": 240.0, "MAV_GCS_SYSID_HI": 250.0}, 245)
    ) == ["green"]
    old = GOOD | {"MAV_GCS_SYSID": None, "SYSID_MYGCS": 255.0}
    assert levels(inspect.failsafes("ada", ROVER, old, 245)) == ["red"]


def test_other_firmwares_have_their_own_parameters():
    assert levels(inspect.failsafes("cop", COPTER, GOOD, 245)) == ["green"]
    px4 = {"NAV_DLL_ACT": 0.0, "COM_DL_LOSS_T": 10.0, "COM_LOW_BAT_ACT": 2.0}
    assert levels(inspect.failsafes("pix", PX4, px4, 245)) == ["red"]
    assert levels(inspect.failsafes("pix", PX4, px4 | {"NAV_DLL_ACT": 1.0}, 245)) == ["green"]


async def test_a_fit_vehicle_has_its_fence_and_is_green_all_over():
    async with link_and_rover() as (link, rover):
        rover.autopilot.parameters["FS_GCS_ENABLE"] = 1.0
        checks = await link.inspect("ada", SQUARE_M)
        assert {check.level for check in checks} == {"green"}, checks
        assert {check.name for check in checks} >= {
            "failsafe",
            "fence",
            "clock",
            "position",
            "EKF",
            "battery",
        }
        assert len(rover.autopilot.plans.items[FENCE]) == 4
        assert rover.autopilot.parameters["FENCE_ENABLE"] == 1.0
        assert not rover.autopilot.armed


async def test_what_is_wrong_is_red_with_the_vehicles_own_words():
    async with link_and_rover() as (link, rover):
        rover.autopilot.parameters["FS_GCS_ENABLE"] = 0.0
        rover.autopilot.trouble.prearm = "PreArm: Compass not calibrated"
        rover.autopilot.say("PreArm: Compass not calibrated")
        rover.autopilot.lose_gps(True)
        rover.autopilot.battery_pct = 30.0
        checks = {check.name: check for check in await link.inspect("ada")}
        assert checks["failsafe"].level == "red"
        assert checks["position"].level == "red"
        assert checks["EKF"].level == "red"
        assert checks["battery"].level == "amber"
        assert "Compass not calibrated" in checks["arming"].found


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
