"""Stop means stop, and it drives: orders give way to newer ones at once, and a hold to nothing at all."""

import asyncio

import pytest
from benches import until
from fleet_bench import here, is_command, team

from drivers.emulators.profiles import COPTER, PX4
from drivers.emulators.rover import GUIDED, HOLD
from drivers.mavlink.codec import Parser, mavlink
from drivers.mavlink.plans import FENCE
from fieldkit.errors import DeviceError, DeviceTimeout, VehicleRefused
from fieldkit.messages import Waypoint

SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
SQUARE_M = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


class Sent:
    """What leaves a link, in order, from when this is made."""

    def __init__(self, link):
        self.messages = []
        send = link._transport.send

        def note(data, peer):
            self.messages += Parser().parse(data)
            send(data, peer)

        link._transport.send = note

    def commands(self, number):
        return [message for message in self.messages if getattr(message, "command", None) == number]

    @property
    def holds(self):
        return [message for message in self.commands(SET_MODE) if message.param2 == HOLD]


@pytest.mark.parametrize("busy", ["goto", "speed", "take over", "upload", "parameters", "nothing"])
async def test_a_hold_is_on_the_wire_before_anything_is_awaited(busy):
    """Whatever else is being confirmed, with every answer lost."""
    async with team() as t:
        rover = t.rovers[0]
        if busy in ("goto", "speed"):
            await t.link.acquire_control("ada")
        rover.drop_in = lambda data: busy != "nothing" and not is_command(data, SET_MODE)
        if busy == "speed":
            rover.drop_in = lambda data: is_command(data, mavlink.MAV_CMD_DO_CHANGE_SPEED)
        work = {
            "goto": lambda: t.link.goto("ada", here()),
            "speed": lambda: t.link.goto("ada", here()),
            "take over": lambda: t.link.acquire_control("ada"),
            "upload": lambda: t.link.upload_fence("ada", SQUARE_M),
            "parameters": lambda: t.link.parameters("ada", ["FS_ACTION"]),
            "nothing": lambda: t.sleep(0.0),
        }[busy]
        task = asyncio.create_task(work())
        await t.sleep(1.0)
        sent = Sent(t.link)
        t.link.stop("ada")
        assert sent.holds, "the frame has left when the call returns"
        await until(lambda: rover.autopilot.mode == HOLD)
        task.cancel()
        await asyncio.wait({task})


async def test_a_hold_does_not_wait_for_a_take_over_whose_answers_are_lost():
    async with team() as t:
        rover = t.rovers[0]
        rover.drop_in = lambda data: not is_command(data, SET_MODE)
        taking = asyncio.create_task(t.link.acquire_control("ada"))
        await until(lambda: rover.autopilot.mode == GUIDED)
        await t.link.hold("ada")
        assert rover.autopilot.mode == HOLD
        with pytest.raises(VehicleRefused, match="newer command"):
            await taking


async def test_message_rates_are_no_reason_to_wait():
    """Six of them, each lost five times, used to take half a minute."""
    async with team() as t:
        rate = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        t.rovers[0].drop_in = lambda data: is_command(data, rate)
        sent = Sent(t.link)
        await t.link.acquire_control("ada")
        assert len(sent.commands(rate)) <= 2 * 7, "asked for, and waited for by nobody"


async def test_a_hold_is_repeated_until_the_vehicle_shows_it_and_then_no_more():
    async with team() as t:
        await t.link.acquire_control("ada")
        lost = iter([True] * 5)
        t.rovers[0].drop_in = lambda data: is_command(data, SET_MODE) and next(lost, False)
        sent = Sent(t.link)
        await t.link.hold("ada")
        assert len(sent.holds) >= 6
        await t.sleep(1.0)
        count = len(sent.holds)
        await t.sleep(3.0)
        assert len(sent.holds) == count


async def test_a_hold_whose_waiting_is_cancelled_is_repeated_all_the_same():
    """A second Ctrl-C cancels whoever waits, not the hold."""
    async with team() as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here(north_m=60.0))
        t.rovers[0].drop_in = lambda data: is_command(data, SET_MODE)
        holding = asyncio.create_task(t.link.hold("ada"))
        await t.sleep(0.5)
        holding.cancel()
        await asyncio.wait({holding})
        t.rovers[0].drop_in = lambda _: False
        await until(lambda: t.rovers[0].autopilot.mode == HOLD)


async def test_a_newer_way_point_replaces_one_that_is_not_confirmed():
    async with team() as t:
        await t.link.acquire_control("ada")
        first = round(t.link._frame.to_geodetic(9.0, 9.0)[0] * 1e7)
        t.rovers[0].drop_in = lambda data: any(getattr(m, "x", None) == first for m in Parser().parse(data))
        older = asyncio.create_task(t.link.goto("ada", here(east_m=9.0, north_m=9.0)))
        await t.sleep(0.2)
        await t.link.goto("ada", here(north_m=5.0))
        with pytest.raises(VehicleRefused, match="newer command"):
            await older


async def test_an_abandoned_take_over_does_not_undo_the_hold():
    async with team() as t:
        t.rovers[0].drop_in = lambda data: is_command(data, mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
        taking = asyncio.create_task(t.link.acquire_control("ada"))
        await until(lambda: t.rovers[0].autopilot.mode == GUIDED)
        await t.link.hold("ada")
        with pytest.raises(DeviceError):
            await taking
        await t.sleep(3.0)
        assert t.rovers[0].autopilot.mode == HOLD


# It drives


async def test_a_way_point_carries_no_speed_which_comes_behind_it():
    """ArduRover answers a speed in Guided's stop submode with FAILED and does not set out."""
    async with team() as t:
        await t.link.acquire_control("ada")
        sent = Sent(t.link)
        await t.link.goto("ada", here(north_m=20.0, speed_m_s=0.5))
        (place,) = sent.commands(mavlink.MAV_CMD_DO_REPOSITION)
        assert place.param1 == -1.0
        speeds = [
            m.param2 for m in sent.commands(mavlink.MAV_CMD_DO_CHANGE_SPEED)
        ]  # more than one on a slow machine
        assert speeds and speeds == pytest.approx([0.4] * len(speeds)), "a rover overshoots by a quarter"
        assert t.rovers[0].autopilot._speed_m_s == pytest.approx(0.4)
        await until(lambda: t.rovers[0].autopilot.body.north_m > 2.0)


async def test_a_speed_that_was_lost_is_asked_again():
    async with team() as t:
        await t.link.acquire_control("ada")
        lost = iter([True, True])
        speed = mavlink.MAV_CMD_DO_CHANGE_SPEED
        t.rovers[0].drop_in = lambda data: is_command(data, speed) and next(lost, False)
        await t.link.goto("ada", here(north_m=20.0, speed_m_s=0.5))
        assert t.rovers[0].autopilot._speed_m_s == pytest.approx(0.4)


async def test_a_speed_that_is_refused_is_told():
    async with team() as t:
        await t.link.acquire_control("ada")
        t.rovers[0].autopilot._change_speed = lambda _: 4
        with pytest.raises(VehicleRefused, match=r"drive at 0\.4 m/s: FAILED"):
            await t.link.goto("ada", here(speed_m_s=0.5))


async def test_a_refusal_is_told_without_the_vehicles_chatter():
    async with team() as t:
        autopilot = t.rovers[0].autopilot
        autopilot.say("EKF failsafe, long ago")
        await t.sleep(2.0)
        autopilot.say("GPS 1: detected u-blox", mavlink.MAV_SEVERITY_INFO)
        autopilot.trouble.prearm = "Compass not calibrated"
        await t.sleep(0.2)
        with pytest.raises(VehicleRefused, match=r"arm: FAILED.*Compass not calibrated") as caught:
            await t.link.acquire_control("ada")
        assert "u-blox" not in str(caught.value) and "long ago" not in str(caught.value)


async def test_why_it_is_not_ours_is_told_and_not_what_it_said_last():
    """A rebooted autopilot talks of its sensors."""
    async with team() as t:
        await t.link.acquire_control("ada")
        rover = t.rovers[0]
        rover.autopilot.reboot(rover.t_s())
        await until(lambda: "it has rebooted" in t.texts())
        rover.autopilot.say("GPS 1: detected u-blox")
        await until(lambda: "GPS 1: detected u-blox" in t.texts())
        with pytest.raises(VehicleRefused, match="not ours to steer: it has rebooted"):
            await t.link.goto("ada", here())
        assert t.states()[-1].reason == "it has rebooted"


async def test_a_vehicle_that_froze_and_goes_on_is_not_old_for_good():
    """Its boot clock stood still with it; the offset is learnt anew by a round trip."""
    async with team() as t:
        rover = t.rovers[0]
        rover.silenced = True
        await t.sleep(14.0)
        rover.autopilot.boot_s += 14.0
        rover.silenced = False
        await until(lambda: t.poses()[-1].t_ns > t.clock.now_ns() - 2e9)


async def test_a_link_that_has_become_slow_is_not_taken_for_a_clock_that_stood_still():
    """Else old positions would look fresh: the round trip tells."""
    async with team() as t:
        rover, send = t.rovers[0], t.rovers[0].send

        def late(data):
            asyncio.get_running_loop().call_later(0.3, send, data)  # 3 s of mission time

        rover.send = late
        await t.sleep(15.0)
        assert t.clock.now_ns() - t.poses()[-1].t_ns > 2.5e9
        assert len(t.sent_to(rover, "TIMESYNC")) <= 4, "a slow link is not burdened"


async def test_what_drives_is_on_the_ground_whatever_it_calls_its_altitude():
    """A simulated ArduRover 400 m above the sea is "400 m above its home"."""
    async with team() as t:
        await until(lambda: t.link._steered[1].vehicle.firmware is not None)
        count = len(t.poses())
        await until(lambda: len(t.poses()) > count + 2)
        assert t.poses()[-1].up_m == 0.0


# One that flies


async def test_a_copter_is_sent_nowhere_without_an_altitude():
    async with team(profile=COPTER) as t:
        await t.link.acquire_control("ada")
        sent = Sent(t.link)
        for up_m in (0.0, 0.5, float("nan")):
            with pytest.raises(VehicleRefused):
                await t.link.goto("ada", Waypoint(1.0, 3.0, 1.0, up_m))
        with pytest.raises(VehicleRefused, match="no height"):
            await t.link.take_off("ada", 0.0)
        assert not sent.commands(mavlink.MAV_CMD_DO_REPOSITION)


async def test_a_copter_does_not_arm_while_its_ground_station_is_silent():
    """Measured: between two runs of a preflight it lost us, and said "GCS failsafe on"."""
    async with team(profile=COPTER, gcs_failsafe_s=6.0) as t:
        await until(lambda: t.sent_to(t.rovers[0], "HEARTBEAT"))
        t.beating = False
        await until(lambda: t.rovers[0].autopilot._why_not_to_arm() == "GCS failsafe on")
        with pytest.raises(VehicleRefused, match="GCS failsafe on"):
            t.rovers[0].drop_in = lambda data: any(m.get_type() == "HEARTBEAT" for m in Parser().parse(data))
            await t.link.acquire_control("ada")
        t.rovers[0].drop_in = lambda _: False
        t.beating = True
        await until(lambda: not t.rovers[0].autopilot._why_not_to_arm())
        await t.link.acquire_control("ada")


async def test_a_copter_takes_off_and_a_hold_stops_its_climb():
    async with team(profile=COPTER) as t:
        await t.link.acquire_control("ada")
        climbing = asyncio.create_task(t.link.take_off("ada", 40.0))
        body = t.rovers[0].autopilot.body
        await until(lambda: body.up_m > 2.0)
        await t.link.hold("ada")
        with pytest.raises(VehicleRefused, match="newer command"):
            await climbing
        up_m = body.up_m
        await t.sleep(4.0)
        assert body.up_m == pytest.approx(up_m, abs=0.1) and up_m < 39.0
        assert t.states()[-1].flies and t.states()[-1].on_ground is False


async def test_a_copter_that_was_held_goes_on_without_a_second_take_off():
    async with team(profile=COPTER) as t:
        await t.link.acquire_control("ada")
        await t.link.take_off("ada", 5.0)
        await t.link.hold("ada")
        await t.link.acquire_control("ada")
        await t.link.take_off("ada", 8.0)
        assert t.rovers[0].autopilot.body.up_m > 7.0
        await t.link.goto("ada", Waypoint(0.0, 4.0, 1.0, 8.0))
        await until(lambda: t.rovers[0].autopilot.body.north_m > 3.5)


async def test_what_drives_does_not_take_off():
    async with team() as t:
        await t.link.acquire_control("ada")
        for order in (t.link.take_off("ada", 5.0), t.link.land("ada")):
            with pytest.raises(VehicleRefused, match="does not fly"):
                await order


async def test_px4_is_stopped_and_not_only_told_that_it_holds():
    """It goes to way-points inside its hold mode: asked for that mode alone it drives on."""
    async with team(profile=PX4) as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here(north_m=60.0))
        body = t.rovers[0].autopilot.body
        await until(lambda: body.speed_m_s > 0.5)
        await t.link.hold("ada")
        await until(lambda: body.speed_m_s == 0.0)


async def test_px4_whose_stop_is_lost_does_not_count_as_held():
    async with team(profile=PX4) as t:
        await t.link.acquire_control("ada")
        await t.link.goto("ada", here(north_m=60.0))
        body, pause = t.rovers[0].autopilot.body, mavlink.MAV_CMD_DO_REPOSITION
        await until(lambda: body.speed_m_s > 0.5)
        t.rovers[0].drop_in = lambda data: is_command(data, pause)
        with pytest.raises(DeviceTimeout, match="did not show mode hold"):
            await t.link.hold("ada")
        assert body.speed_m_s > 0.5
        t.rovers[0].drop_in = lambda _: False
        await until(lambda: body.speed_m_s == 0.0)


async def test_a_team_holds_while_every_answer_is_lost():
    async with team(4) as t:
        names = t.link.robots
        await asyncio.gather(*(t.link.acquire_control(name) for name in names))
        for rover in t.rovers:
            rover.drop_in = lambda data: not is_command(data, SET_MODE)
        busy = [asyncio.create_task(t.link.goto(name, here())) for name in names[:2]]
        busy += [asyncio.create_task(t.link.upload(name, FENCE, [])) for name in names[2:]]
        await t.sleep(0.3)
        sent = Sent(t.link)
        for name in names:
            t.link.stop(name)
        assert {message.target_system for message in sent.holds} == {1, 2, 3, 4}
        await until(lambda: {rover.autopilot.mode for rover in t.rovers} == {HOLD})
        for task in busy:
            task.cancel()
        await asyncio.wait(busy)
