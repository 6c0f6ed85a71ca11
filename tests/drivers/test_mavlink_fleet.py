"""Whom a safe MAVLink fleet driver takes for its vehicles, and what it takes for a sign of life."""

import math
import socket

import pytest
from benches import around, free_udp_port, rovers_on_udp, until
from fleet_bench import here, team

from drivers.emulators.rover import GUIDED, HOLD
from drivers.mavlink.codec import Packer, mavlink
from drivers.mavlink.fleet import open_link
from fieldkit.errors import ConfigError, DeviceError, DeviceTimeout, VehicleRefused


async def test_must_use_an_own_ground_station_id():
    async with team() as t:
        await until(lambda: t.sent_to(t.rovers[0], "HEARTBEAT"))
        heartbeat = t.sent_to(t.rovers[0], "HEARTBEAT")[0]
    assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (245, 190)
    assert heartbeat.type == mavlink.MAV_TYPE_GCS
    assert heartbeat.autopilot == mavlink.MAV_AUTOPILOT_INVALID


async def test_must_beat_only_when_the_steering_loop_does():
    async with team() as t:
        t.beating = False
        await t.sleep(1.5)
        before = len(t.sent_to(t.rovers[0], "HEARTBEAT"))
        await t.sleep(6.0)
        assert len(t.sent_to(t.rovers[0], "HEARTBEAT")) == before


async def test_must_let_vehicles_hold_when_steering_dies_and_not_resume_by_itself():
    async with team(gcs_failsafe_s=6.0) as t:
        await t.link.acquire_control("ada")
        t.beating = False
        await until(lambda: t.rovers[0].autopilot.mode == HOLD)
        t.beating = True
        await until(lambda: "GCS Failsafe Cleared" in t.texts())
        assert t.mode() == "other"
        with pytest.raises(VehicleRefused, match="not ours"):
            await t.link.goto("ada", here())
        assert t.rovers[0].autopilot.mode == HOLD
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here())
        assert t.rovers[0].autopilot.mode == GUIDED


async def test_must_reject_two_vehicles_with_one_id():
    async with team() as t, rovers_on_udp({1: (9.0, 9.0)}, t.clock, t.port) as twins:
        await until(lambda: any("two vehicles have system id 1" in text for text in t.texts()))
        with pytest.raises(VehicleRefused, match="system id 1"):
            await t.link.acquire_control("ada")
        with pytest.raises(VehicleRefused, match="system id 1"):
            await t.link.goto("ada", here())
        count = len(t.poses())
        await t.sleep(2.0)
        assert len(t.poses()) == count, "poses of two vehicles are mixed"
        (check,) = await t.link.inspect("ada", [(0.0, 0.0), (9.0, 0.0), (9.0, 9.0)])
        assert check.level == "red" and "two vehicles answer to id 1" in check.found
        twins[0].autopilot.mode = GUIDED
        await t.link.hold("ada")
        await until(lambda: twins[0].autopilot.mode == HOLD)


async def test_must_reject_two_vehicles_with_one_id_behind_one_address():
    async with team() as t, rovers_on_udp({1: (9.0, 9.0)}, t.clock, free_udp_port(), boot_s=-900.0) as twins:
        await t.link.acquire_control("ada")
        twins[0].send = t.rovers[0].send  # a router, or one radio for both
        await until(lambda: any("two vehicles have system id 1: both at" in text for text in t.texts()))
        for steer in (t.link.acquire_control("ada"), t.link.goto("ada", here())):
            with pytest.raises(VehicleRefused, match="two vehicles have system id 1"):
                await steer
        count = len(t.poses())
        await t.sleep(2.0)
        assert len(t.poses()) == count, "poses of two vehicles are mixed"
        await t.link.hold("ada")


async def test_a_vehicle_that_moves_to_another_address_is_followed():
    async with team() as t:
        t.rovers[0].silenced = True
        await t.sleep(4.0)
        async with rovers_on_udp({1: (0.0, 0.0)}, t.clock, t.port, gcs_failsafe_s=40.0) as moved:
            await until(
                lambda: t.link._steered[1].vehicle.peer == moved[0].transport.get_extra_info("sockname")
            )
            await t.link.acquire_control("ada")
            assert moved[0].autopilot.armed
            assert not any("two vehicles" in text for text in t.texts())


async def test_must_notice_a_reboot_and_drop_ownership():
    async with team() as t:
        await t.link.acquire_control("ada")
        t.rovers[0].autopilot.reboot(t.rovers[0].t_s())
        await until(lambda: "it has rebooted" in t.texts())
        assert t.mode() == "other"
        with pytest.raises(VehicleRefused):
            await t.link.goto("ada", here())
        await until(lambda: t.poses()[-1].t_ns > t.clock.now_ns() - 2e9)  # the new boot clock is understood
        await t.link.acquire_control("ada")


async def test_must_declare_the_link_lost_by_the_autopilots_heartbeat():
    async with team(2) as t:
        await t.link.acquire_control("ada")
        t.rovers[0].silenced = True
        silent_s = t.clock.elapsed_s()
        await until(lambda: not t.states()[-1].link_up)
        assert t.clock.elapsed_s() - silent_s > 4.0
        assert t.states("bob")[-1].link_up
        with pytest.raises(DeviceTimeout, match="link is lost"):
            await t.link.goto("ada", here())
        t.rovers[0].silenced = False
        await until(lambda: t.states()[-1].link_up)
        with pytest.raises(VehicleRefused, match="not ours"):
            await t.link.goto("ada", here())


async def test_other_heartbeats_are_no_sign_of_life():
    """Another ground station's, and a gimbal's with the vehicle's own system id."""
    async with team() as t:
        t.rovers[0].silenced = True
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with sock:
            for system_id, component in ((255, 190), (1, mavlink.MAV_COMP_ID_GIMBAL)) * 8:
                beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GIMBAL, 8, 0, 0, 4, 3)
                sock.sendto(Packer(system_id, component).pack(beat), ("127.0.0.1", t.port))
                await t.sleep(0.5)
        assert not t.states()[-1].link_up


async def test_positions_without_a_fix_are_not_passed_on():
    """Without GPS the autopilot goes on sending fresh-looking dead-reckoned positions."""
    async with team() as t:
        await t.link.acquire_control("ada")
        t.rovers[0].autopilot.lose_gps(True)
        await until(lambda: "EKF failsafe" in t.texts())
        await t.sleep(2.0)
        count = len(t.poses())
        await t.sleep(3.0)
        assert len(t.poses()) == count
        assert t.mode() == "other"


async def test_a_pose_is_where_the_vehicle_is():
    async with team(2) as t:
        await t.sleep(1.0)
        pose = t.poses("bob")[-1]
        assert math.dist((pose.east_m, pose.north_m), (2.0, 0.0)) < 0.03
        assert pose.origin == "mavlink" and pose.heading_deg == 0.0


async def test_a_second_runner_on_the_same_link_is_refused():
    async with team() as t:
        second = open_link(f"udpin:127.0.0.1:{t.port}", {"ada": {"system_id": 1}}, around(t.clock))
        with pytest.raises(DeviceError, match="another fieldkit"):
            async with second:
                pass


async def test_a_second_runner_elsewhere_is_heard_and_refused():
    """Autopilots forward heartbeats between their links: one with our own id is not ours."""
    async with team() as t:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
            sock.sendto(Packer(245, 190).pack(beat), ("127.0.0.1", t.port))
        await t.sleep(1.0)
        with pytest.raises(VehicleRefused, match="a second mission"):
            await t.link.acquire_control("ada")
        assert not t.rovers[0].autopilot.armed
        assert any(check.level == "red" and check.name == "identity" for check in await t.link.inspect("ada"))


async def test_a_vehicle_that_is_not_there_is_named():
    async with team() as t:
        t.rovers[0].silenced = True
        await until(lambda: not t.states()[-1].link_up)
        with pytest.raises(DeviceTimeout, match="no heartbeat from system 1"):
            await t.link.acquire_control("ada")


def test_two_robots_with_one_system_id_are_refused():
    with pytest.raises(ConfigError, match="ada and bob have the same system_id 3"):
        open_link("udpin:127.0.0.1:14550", {"ada": {"system_id": 3}, "bob": {"system_id": 3}}, around())


@pytest.mark.parametrize(
    ("address", "options", "words"),
    [
        ("udpin:127.0.0.1", {"system_id": 1}, "host:port"),
        ("carrier-pigeon", {"system_id": 1}, "expected udpin:"),
        ("udpin:127.0.0.1:14550", {}, "'system_id' is missing"),
        ("udpin:127.0.0.1:14550", {"system_id": 0}, "1 to 254"),
        ("udpin:127.0.0.1:14550", {"system_id": 245}, "not our own"),
        ("udpin:127.0.0.1:14550", {"system_id": "1"}, "expected an integer"),
        ("udpin:127.0.0.1:14550", {"system_id": 1, "colour": 1}, "unknown option 'colour'"),
    ],
)
def test_impossible_options_are_named(address, options, words):
    with pytest.raises(ConfigError) as caught:
        open_link(address, {"ada": options}, around())
    assert words in str(caught.value)


async def test_a_port_in_use_is_named_with_a_remedy():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        with pytest.raises(DeviceError, match="QGroundControl"):
            async with open_link(f"udpin:127.0.0.1:{port}", {"ada": {"system_id": 1}}, around()):
                pass
