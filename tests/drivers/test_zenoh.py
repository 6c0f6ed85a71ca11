"""Real Zenoh on loopback: what one peer publishes the others hear, once; wrong addresses are said in words."""

import asyncio
import contextlib
import socket

import pytest

from drivers.zenoh.network import ZenohNetwork, open_network
from fieldkit.clock import RealClock
from fieldkit.errors import ConfigError, DeviceError
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext, Network

pytest.importorskip("zenoh")

AROUND = DriverContext(RealClock(), FieldFrame(47.0, 8.0))


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def peer(topic: str, *, listen: int = 0, connect: int = 0) -> ZenohNetwork:
    options = {
        "listen": [f"tcp/127.0.0.1:{listen}"] if listen else ["tcp/127.0.0.1:0"],
        "connect": [f"tcp/127.0.0.1:{connect}"] if connect else [],
        "scouting": False,
    }
    return open_network(topic, options, AROUND)


async def first(network: ZenohNetwork) -> bytes:
    async for data in network.messages():
        return data
    return b""


async def test_what_one_publishes_the_others_hear_once_and_no_other_topic() -> None:
    port = free_port()
    one, two, stranger = peer("here", listen=port), peer("here", connect=port), peer("there", connect=port)
    assert isinstance(one, Network) and f"tcp/127.0.0.1:{port}" in two.where
    async with one, two, stranger:
        hears, never = asyncio.create_task(first(two)), asyncio.create_task(first(stranger))
        number = 0
        while not hears.done():
            one.publish(number.to_bytes(2, "big"), urgent=number % 2 == 0)
            number += 1
            await asyncio.wait({hears}, timeout=0.1)
        assert int.from_bytes(await hears, "big") < number and not never.done()
        own = asyncio.create_task(first(one))
        done, _ = await asyncio.wait({own}, timeout=0.3)
        assert not done, "nobody hears itself"
        for task in (never, own):
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


async def test_greetings_are_heard_by_those_of_another_topic_too() -> None:
    port = free_port()
    async with peer("here", listen=port) as one, peer("there", connect=port) as stranger:
        hears = asyncio.create_task(first(stranger))
        while not hears.done():
            one.publish(b"for its own")
            one.greet(b"who I am")
            await asyncio.wait({hears}, timeout=0.1)
        assert await hears == b"who I am"


async def test_a_peer_that_comes_later_is_found() -> None:
    port = free_port()
    async with peer("here", connect=port) as early:
        hears = asyncio.create_task(first(early))
        async with peer("here", listen=port) as late:
            while not hears.done():
                late.publish(b"here I am")
                await asyncio.wait({hears}, timeout=0.1)
            assert await hears == b"here I am"


async def test_messages_end_when_the_network_is_closed() -> None:
    async with peer("here") as network:
        hears = asyncio.create_task(first(network))
        await asyncio.sleep(0)
    assert await hears == b""
    network.publish(b"into the void")


async def test_an_address_that_is_none_is_said_in_words() -> None:
    for options in ({"listen": ["tcp/256.0.0.1:1"]}, {"listen": ["nonsense"]}, {"connect": ["nonsense"]}):
        wrong = open_network("here", {**options, "scouting": False}, AROUND)
        with pytest.raises(DeviceError, match="is an address wrong"):
            await wrong.__aenter__()


def test_an_unknown_option_is_named() -> None:
    with pytest.raises(ConfigError, match="no option broker"):
        open_network("here", {"broker": "x"}, AROUND)
