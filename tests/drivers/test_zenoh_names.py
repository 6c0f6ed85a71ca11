"""Names in addresses that cannot be resolved: which, why, and that it is asked again."""

import socket
import threading
from typing import Any

import pytest
from benches import until

from drivers.zenoh import names
from drivers.zenoh.names import Names, host_of
from drivers.zenoh.network import open_network
from fieldkit.clock import RealClock
from fieldkit.geo import FieldFrame
from fieldkit.ports import DriverContext


@pytest.mark.parametrize(
    ("address", "host"),
    [
        ("tcp/r1.local:7447", "r1.local"),
        ("quic/rover:7447?x=1:2", "rover"),
        ("udp/r1:1#iface=wlan0", "r1"),
        ("tcp/192.168.1.11:7447", ""),
        ("tcp/[fe80::1%wlan0]:7447", ""),
        ("unixsock-stream//tmp/r1", ""),
    ],
)
def test_only_names_have_to_be_resolved(address: str, host: str) -> None:
    assert host_of(address) == host


def test_a_name_that_is_resolved_later_is_known_to_be(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, known = threading.Semaphore(0), threading.Event()

    def resolve(host: str, *_: Any, **__: Any) -> list[object]:
        asked.release()
        if host == "r1.local" and not known.is_set():
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return []

    monkeypatch.setattr(names.socket, "getaddrinfo", resolve)
    monkeypatch.setattr(names, "ASK_EVERY_S", 0.01)
    asks = Names(["tcp/r1.local:7447", "tcp/r2.local:7447", "tcp/10.0.0.1:7447"])
    asks.begin()
    try:
        for _ in range(3):  # the first round is over
            asked.acquire()
        assert asks.unresolved == {"tcp/r1.local:7447": "Name or service not known"}
        known.set()
        while asks.unresolved:
            asked.acquire()
    finally:
        asks.end()
    for thread in [each for each in threading.enumerate() if each.name == "names"]:
        thread.join()


def test_what_could_be_no_name_is_said_to_be_none() -> None:
    assert names._why_not("r1." + 70 * "x") and names._why_not("r..1") and names._why_not("localhost") == ""


async def test_a_network_with_such_an_address_opens_and_says_which(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("zenoh")
    asked = threading.Event()

    def resolve(*_: Any, **__: Any) -> list[object]:
        asked.set()
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

    monkeypatch.setattr(names.socket, "getaddrinfo", resolve)
    address = "tcp/no-such-robot.invalid:7447"
    options = {"connect": [address], "listen": ["tcp/127.0.0.1:0"], "scouting": False}
    network = open_network("here", options, DriverContext(RealClock(), FieldFrame(47.0, 8.0)))
    assert not network.unresolved
    async with network:
        await until(lambda: bool(network.unresolved))
        assert dict(network.unresolved) == {address: "Temporary failure in name resolution"}
    for thread in [each for each in threading.enumerate() if each.name == "names"]:
        thread.join()
