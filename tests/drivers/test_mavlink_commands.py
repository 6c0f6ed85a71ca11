"""How a safe MAVLink fleet driver asks: repeated, numbered, confirmed by what the vehicle shows, never broadcast."""

import asyncio

import pytest
from benches import until
from fleet_bench import RATE, here, is_command, team

from drivers.emulators.rover import GUIDED
from drivers.mavlink.codec import Packer, mavlink
from fieldkit.errors import DeviceTimeout, VehicleRefused


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
