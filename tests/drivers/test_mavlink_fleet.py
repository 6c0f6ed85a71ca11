"""What a safe MAVLink fleet driver must do, on emulated rovers over UDP, mission time 10 times as fast."""

import asyncio
import math
import socket
from contextlib import AsyncExitStack, asynccontextmanager

import pytest
from benches import FRAME, around, free_udp_port, rovers_on_udp, until

from drivers.emulators.rover import GUIDED, HOLD, MANUAL
from drivers.mavlink.codec import Packer, Parser, mavlink
from drivers.mavlink.fleet import MavlinkLink, open_link
from fieldkit.clock import ScaledClock
from fieldkit.errors import ConfigError, DeviceError, DeviceTimeout, VehicleRefused
from fieldkit.messages import Pose, VehicleState, Waypoint
from fieldkit.testing import nothing_left

RATE = 10.0


class Team:
    """An open link with emulated rovers on the other side; everything the link has said."""

    def __init__(self, link: MavlinkLink, rovers, clock: ScaledClock, port: int) -> None:
        self.link, self.rovers, self.clock, self.port = link, rovers, clock, port
        self.items: list[Pose | VehicleState] = []
        self.beating = True

    def poses(self, robot="ada"):
        return [item for item in self.items if isinstance(item, Pose) and item.robot == robot]

    def states(self, robot="ada"):
        return [item for item in self.items if isinstance(item, VehicleState) and item.robot == robot]

    def mode(self, robot="ada"):
        states = self.states(robot)
        return states[-1].mode if states else None

    def texts(self, robot="ada"):
        return [state.text for state in self.states(robot)]

    def sent_to(self, rover, kind=None):
        """What the driver has sent to one rover, decoded."""
        found = Parser().parse(b"".join(rover.got))
        return [message for message in found if kind is None or message.get_type() == kind]

    async def sleep(self, mission_s):
        await self.clock.sleep(mission_s)


@asynccontextmanager
async def team(count=1, **options):
    clock, port = ScaledClock(RATE), free_udp_port()
    names = ["ada", "bob", "cyd", "dan"][:count]
    starts_m = {number + 1: (2.0 * number, 0.0) for number in range(count)}
    robots = {name: {"system_id": number + 1} for number, name in enumerate(names)}
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(nothing_left())
        failsafe = {"gcs_failsafe_s": 40.0} | options
        rovers = await stack.enter_async_context(rovers_on_udp(starts_m, clock, port, **failsafe))
        link = await stack.enter_async_context(open_link(f"udpin:127.0.0.1:{port}", robots, around(clock)))
        made = Team(link, rovers, clock, port)

        async def collect():
            async for item in link.events():
                made.items.append(item)

        async def beat():
            while True:
                if made.beating:
                    link.beat()
                await clock.sleep(1.0)

        tasks = [asyncio.create_task(collect()), asyncio.create_task(beat())]
        try:
            await until(lambda: all(made.poses(name) for name in names))
            yield made
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)


def here(**change):
    return Waypoint(**({"east_m": 1.0, "north_m": 3.0, "speed_m_s": 1.0} | change))


# Identity and presence


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


# Commands


async def test_must_confirm_mode_and_arming_by_the_heartbeat():
    async with team(2) as t:
        await asyncio.gather(t.link.acquire_control("ada"), t.link.acquire_control("bob"))
        for name, rover in zip(("ada", "bob"), t.rovers, strict=True):
            await until(lambda name=name: t.mode(name) == "guided" and t.states(name)[-1].armed)
            assert rover.autopilot.mode == GUIDED and rover.autopilot.armed


async def test_must_treat_an_ack_as_accepted_and_not_as_done():
    async with team() as t:
        await t.link.acquire_control("ada")
        t.rovers[0].autopilot._change_mode = lambda mode: None  # says yes, does nothing
        with pytest.raises(DeviceTimeout, match="did not show mode hold"):
            await t.link.hold("ada")


async def test_must_repeat_a_command_until_it_is_answered():
    async with team() as t:
        await t.link.acquire_control("ada")
        lost = iter([True, True, False])
        t.rovers[0].drop_in = lambda data: (
            is_command(data, mavlink.MAV_CMD_DO_REPOSITION) and next(lost, False)
        )
        await t.link.goto("ada", here())
        assert len(t.sent_to(t.rovers[0], "COMMAND_INT")) == 3


async def test_must_number_its_attempts():
    async with team() as t:
        lost = iter([True, True, False])
        arm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        t.rovers[0].drop_in = lambda data: is_command(data, arm) and next(lost, False)
        await t.link.acquire_control("ada")
        asked = [m for m in t.sent_to(t.rovers[0], "COMMAND_LONG") if m.command == arm]
        assert [m.confirmation for m in asked] == [0, 1, 2]
        assert {m.param2 for m in asked} == {0.0}, "arming is never forced"


async def answering(t, *answers):
    """Answer a way-point with (mission seconds to wait, result) for each time it is sent; how often that was."""
    await t.link.acquire_control("ada")
    rover, command, told = t.rovers[0], mavlink.MAV_CMD_DO_REPOSITION, iter(answers)

    def answer(data):
        if not is_command(data, command):
            return False
        for after_s, result in next(told, ()):
            ack = Packer(1, 1).pack(mavlink.MAVLink_command_ack_message(command, result, 0, 0, 245, 190))
            asyncio.get_running_loop().call_later(after_s / RATE, rover.send, ack)
        return True

    rover.drop_in = answer
    rover.autopilot._change_speed = lambda _: 0  # it has taken no place, for these answers are ours
    await t.link.goto("ada", here())
    return len(t.sent_to(rover, "COMMAND_INT"))


async def test_must_wait_long_for_a_vehicle_that_is_at_it():
    async with team() as t:
        busy, done = (0.0, mavlink.MAV_RESULT_IN_PROGRESS), (4.0, mavlink.MAV_RESULT_ACCEPTED)
        assert await answering(t, (busy, done)) == 1, "asked again while the vehicle was at it"


async def test_must_ask_again_later_what_is_rejected_for_now():
    async with team() as t:
        not_now, done = (0.0, mavlink.MAV_RESULT_TEMPORARILY_REJECTED), (0.0, mavlink.MAV_RESULT_ACCEPTED)
        assert await answering(t, (not_now,), (done,)) == 2


async def test_must_report_a_command_never_answered():
    async with team() as t:
        await t.link.acquire_control("ada")
        t.rovers[0].drop_in = lambda data: is_command(data, mavlink.MAV_CMD_DO_REPOSITION)
        with pytest.raises(DeviceTimeout, match="no answer to 10 attempts"):
            await t.link.goto("ada", here())


async def test_must_not_take_another_stations_ack_for_ours():
    async with team() as t:
        await t.link.acquire_control("ada")
        rover = t.rovers[0]
        command = mavlink.MAV_CMD_DO_REPOSITION
        rover.drop_in = lambda data: is_command(data, command)
        foreign = mavlink.MAVLink_command_ack_message(command, 0, 0, 0, 255, 190)
        stranger = mavlink.MAVLink_command_ack_message(command, 0, 0, 0, 245, 190)

        async def mislead():
            while True:
                rover.send(Packer(1, 1).pack(foreign))
                rover.send(Packer(9, 1).pack(stranger))
                await t.sleep(0.2)

        task = asyncio.create_task(mislead())
        with pytest.raises(DeviceTimeout):
            await t.link.goto("ada", here())
        task.cancel()
        await asyncio.wait({task})


async def test_must_pass_on_a_refusal_in_the_vehicles_own_words():
    async with team() as t:
        words = "PreArm: Hardware safety switch, and a reason beyond fifty characters"
        t.rovers[0].autopilot.trouble.prearm = words
        with pytest.raises(VehicleRefused, match=r"arm: FAILED.*reason beyond fifty characters"):
            await t.link.acquire_control("ada")
        assert not t.rovers[0].autopilot.armed


async def test_must_not_broadcast():
    async with team(2) as t:
        await asyncio.gather(t.link.acquire_control("ada"), t.link.acquire_control("bob"))
        await t.link.goto("ada", here())
        await asyncio.gather(
            t.link.hold("ada"), t.link.hold("bob"), t.link.return_home("bob"), return_exceptions=True
        )
        for number, rover in enumerate(t.rovers, start=1):
            targets = {m.target_system for m in t.sent_to(rover) if hasattr(m, "target_system")}
            assert targets == {number}


async def test_must_set_message_rates_again_after_a_reboot():
    async with team() as t:
        rover = t.rovers[0]
        await t.link.acquire_control("ada")
        rover.autopilot.reboot(rover.t_s())
        rover.autopilot._interval_s[mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT] = 0.0
        await t.sleep(4.0)
        count = len(t.poses())
        await until(lambda: len(t.poses()) > count + 3)


# Steering


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
        with pytest.raises(VehicleRefused, match="not taken over"):
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


# Bad input


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


async def test_a_vehicle_that_is_not_there_is_named():
    async with team() as t:
        t.rovers[0].silenced = True
        await until(lambda: not t.states()[-1].link_up)
        with pytest.raises(DeviceTimeout, match="no heartbeat from system 1"):
            await t.link.acquire_control("ada")


def is_command(data: bytes, command: int) -> bool:
    return any(getattr(message, "command", None) == command for message in Parser().parse(data))


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
