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


async def why(**options: list[str]) -> str:
    """What is said of a network that cannot be opened, on one line."""
    with pytest.raises(DeviceError) as caught:
        await open_network("here", {**options, "scouting": False}, AROUND).__aenter__()
    return str(caught.value)


async def test_what_cannot_be_opened_is_said_in_words_and_with_nothing_of_zenohs_code() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        in_use = await why(listen=[f"tcp/127.0.0.1:{port}"])
    elsewhere = await why(listen=["tcp/192.0.2.1:7447"])
    no_number, unknown = await why(listen=["tcp/256.0.0.1:1"]), await why(connect=["carrier/pigeon"])
    assert f"127.0.0.1:{port}" in in_use and "give --listen another port" in in_use
    assert "this computer has no such address: --listen tcp/0.0.0.0:7447" in elsewhere
    assert "is an address wrong" in no_number and "no such protocol; there are: tcp, udp" in unknown
    for said in (in_use, elsewhere, no_number, unknown):
        assert ".rs" not in said and ".cargo" not in said, said


NONE = ["nonsense", "", "192.168.1.11:7447", "tcp/192.168.1.11", "tcp/:7447", "tcp://192.168.1.11:7447",
        "tcp/192.168.1.11:port", "tcp/192.168.1.11:65536", "udp/::1:7447", "/7447", "tcp/"]  # fmt: skip


@pytest.mark.parametrize("option", ["listen", "connect"])
@pytest.mark.parametrize("address", NONE)
def test_an_address_that_would_never_be_reached_is_refused_before_anything_is_opened(
    option: str, address: str
) -> None:
    with pytest.raises(ConfigError, match=f"--{option}: expected PROTOCOL/HOST:PORT, such as tcp/.* got"):
        open_network("here", {option: [address]}, AROUND)


def test_any_free_port_is_for_those_who_listen() -> None:
    open_network("here", {"listen": ["tcp/0.0.0.0:0"]}, AROUND)
    with pytest.raises(ConfigError, match="--connect: expected"):
        open_network("here", {"connect": ["tcp/192.168.1.11:0"]}, AROUND)


async def test_an_address_that_is_given_twice_is_listened_on_once() -> None:
    address = f"tcp/127.0.0.1:{free_port()}"
    async with open_network("here", {"listen": [address, address], "scouting": False}, AROUND):
        pass


def test_addresses_that_zenoh_takes_are_taken() -> None:
    taken = ["tcp/[::1]:7447", "tcp/r1.local:65535", "udp/10.0.0.1:1#iface=wlan0", "unixsock-stream//tmp/r1"]
    assert all(address in open_network("here", {"connect": taken}, AROUND).where for address in taken)


def test_an_unknown_option_is_named() -> None:
    with pytest.raises(ConfigError, match="no option broker"):
        open_network("here", {"broker": "x"}, AROUND)
