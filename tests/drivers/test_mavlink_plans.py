"""Fences and missions: uploaded item by item over a poor link, and read back before they are believed."""

import asyncio
from contextlib import asynccontextmanager

import pytest
from benches import FRAME, around, free_udp_port, rovers_on_udp, until

from drivers.emulators.plans import PlanStore
from drivers.mavlink.codec import Packer, Parser, mavlink
from drivers.mavlink.fleet import open_link
from drivers.mavlink.plans import FENCE, MISSION, PlanItem, polygon_fence
from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceTimeout, VehicleRefused

SQUARE_M = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


@asynccontextmanager
async def link_and_rover(rate=20.0):
    clock, port = ScaledClock(rate), free_udp_port()
    async with (
        rovers_on_udp({1: (0.0, 0.0)}, clock, port, gcs_failsafe_s=0.0) as rovers,
        open_link(f"udpin:127.0.0.1:{port}", {"ada": {"system_id": 1}}, around(clock)) as link,
    ):
        await until(lambda: link._steered[1].vehicle.link_up)
        yield link, rovers[0]


def items(count, lat=473977000):
    command = mavlink.MAV_CMD_NAV_WAYPOINT
    return [
        PlanItem(command, lat + 100 * n, 85456000 + n, 1.5, (0.5 * n, 0.0, 0.0, 0.0)) for n in range(count)
    ]


async def test_a_fence_is_uploaded_and_read_back():
    async with link_and_rover() as (link, rover):
        await link.upload_fence("ada", SQUARE_M)
        held = rover.autopilot.plans.items[FENCE]
        assert [message.command for message in held] == [
            mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
        ] * 4
        assert {message.param1 for message in held} == {4.0}
        east_m, north_m, _ = FRAME.to_local(held[2].x / 1e7, held[2].y / 1e7)
        assert (east_m, north_m) == pytest.approx((10.0, 10.0), abs=0.02)


async def test_must_answer_the_newer_request_as_well():
    async with link_and_rover() as (link, rover):
        asked, send, packer = [], rover.send, Packer(1, 1)

        def in_newer_words(data):
            """As PX4 asks: MISSION_REQUEST_INT in place of MISSION_REQUEST."""
            for message in Parser().parse(data):
                if message.get_type() == "MISSION_REQUEST":
                    to = (message.target_system, message.target_component)
                    message = mavlink.MAVLink_mission_request_int_message(
                        *to, message.seq, message.mission_type
                    )
                    asked.append(message.seq)
                send(packer.pack(message))

        rover.send = in_newer_words
        await link.upload("ada", MISSION, items(6))
        assert asked == list(range(6))
        assert await link.download("ada", MISSION) == items(6)


async def test_an_empty_plan_clears_the_vehicles():
    async with link_and_rover() as (link, _):
        await link.upload("ada", MISSION, items(3))
        await link.upload("ada", MISSION, [])
        assert await link.download("ada", MISSION) == []


async def test_an_upload_gets_through_a_link_that_loses_a_third():
    async with link_and_rover() as (link, rover):
        count = iter(range(10**6))
        rover.drop_in = lambda _: next(count) % 3 == 2
        await link.upload("ada", MISSION, items(9))
        assert len(rover.autopilot.plans.items[MISSION]) == 9


async def test_a_plan_that_reads_back_differently_is_not_believed():
    async with link_and_rover() as (link, rover):
        real = rover.autopilot.plans._item

        def spoiled(message, station, t_s):
            message.x += 500
            return real(message, station, t_s)

        rover.autopilot.plans._item = spoiled
        with pytest.raises(VehicleRefused, match="not the one sent"):
            await link.upload("ada", FENCE, polygon_fence([(1, 1), (1, 2), (2, 2)]))


async def test_an_upload_that_breaks_off_is_reported():
    async with link_and_rover() as (link, rover):
        await link.upload("ada", MISSION, items(6))
        got = iter([False, False, False])
        rover.drop_in = lambda data: is_item(data) and next(got, True)
        with pytest.raises(DeviceTimeout, match="mixture"):
            await link.upload("ada", MISSION, items(9, lat=480000000))


async def test_an_upload_that_the_vehicle_gave_up_is_sent_again():
    """It cancels after 8 s without an item: a link that was gone for that long, not a refusal."""
    async with link_and_rover() as (link, rover):
        cancelled, real = [], rover.autopilot.plans.update

        def update(t_s):
            answers = real(t_s)
            cancelled.extend(a for a in answers if a.get_type() == "MISSION_ACK")
            return answers

        rover.autopilot.plans.update = update
        rover.drop_in = lambda data: is_item(data) and not cancelled
        await link.upload("ada", MISSION, items(6))
        assert [a.type for a in cancelled] == [mavlink.MAV_MISSION_OPERATION_CANCELLED]
        assert len(rover.autopilot.plans.items[MISSION]) == 6


async def test_parameters_are_read_and_unknown_ones_are_none():
    async with link_and_rover() as (link, _):
        found = await link.parameters("ada", ["FS_ACTION", "NO_SUCH_THING", "MAV_GCS_SYSID"])
    assert found == {"FS_ACTION": 2.0, "NO_SUCH_THING": None, "MAV_GCS_SYSID": 245.0}


async def test_a_hold_works_while_an_upload_is_under_way():
    async with link_and_rover() as (link, rover):
        rover.drop_in = is_item
        uploading = asyncio.create_task(link.upload("ada", MISSION, items(5)))
        await asyncio.sleep(0.05)
        await link.hold("ada")
        uploading.cancel()
        await asyncio.wait({uploading})


def test_a_fence_needs_three_corners():
    with pytest.raises(ValueError, match="three corners"):
        polygon_fence([(1, 1), (2, 2)])


def is_item(data: bytes) -> bool:
    return any(message.get_type() == "MISSION_ITEM_INT" for message in Parser().parse(data))


# The emulated store, against what was measured


def sent(message, system_id=245):
    return Parser().parse(Packer(system_id, 190).pack(message))[0]


def item(number):
    return sent(
        mavlink.MAVLink_mission_item_int_message(1, 1, number, 6, 16, 0, 1, 0, 0, 0, 0, 7, 7, 0, MISSION)
    )


def filled(count):
    store = PlanStore()
    store.hear(sent(mavlink.MAVLink_mission_count_message(1, 1, count, MISSION)), 0.0)
    for number in range(count):
        answers = store.hear(item(number), 0.0)
    assert answers[0].type == mavlink.MAV_MISSION_ACCEPTED
    return store


def test_it_asks_with_the_old_request():
    answers = PlanStore().hear(sent(mavlink.MAVLink_mission_count_message(1, 1, 2, MISSION)), 0.0)
    assert [message.get_type() for message in answers] == ["MISSION_REQUEST"]


def test_a_silent_station_is_asked_again_and_then_given_up():
    store = PlanStore()
    store.hear(sent(mavlink.MAVLink_mission_count_message(1, 1, 2, MISSION)), 0.0)
    assert [m.get_type() for m in store.update(1.1)] == ["MISSION_REQUEST"]
    assert [m.type for m in store.update(8.1)] == [mavlink.MAV_MISSION_OPERATION_CANCELLED]


def test_an_upload_broken_off_leaves_a_mixture():
    store = filled(6)
    store.hear(sent(mavlink.MAVLink_mission_count_message(1, 1, 9, MISSION)), 0.0)
    fresh = [item(0), item(1)]
    for message in fresh:
        store.hear(message, 0.0)
    store.update(9.0)
    assert len(store.items[MISSION]) == 6
    assert store.items[MISSION][:2] == fresh


def test_a_duplicate_item_is_an_invalid_sequence_and_the_upload_goes_on():
    store = PlanStore()
    store.hear(sent(mavlink.MAVLink_mission_count_message(1, 1, 2, MISSION)), 0.0)
    store.hear(item(0), 0.0)
    assert store.hear(item(0), 0.0)[0].type == mavlink.MAV_MISSION_INVALID_SEQUENCE
    assert store.hear(item(1), 0.0)[0].type == mavlink.MAV_MISSION_ACCEPTED
    assert store.hear(item(1), 0.0)[0].type == mavlink.MAV_MISSION_ERROR


def test_another_station_is_denied_during_an_upload():
    store = PlanStore()
    store.hear(sent(mavlink.MAVLink_mission_count_message(1, 1, 2, MISSION)), 0.0)
    answers = store.hear(sent(mavlink.MAVLink_mission_count_message(1, 1, 3, MISSION), system_id=255), 0.0)
    assert answers[0].type == mavlink.MAV_MISSION_DENIED
