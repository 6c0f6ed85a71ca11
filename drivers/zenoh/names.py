"""Whether the names in addresses can be resolved: Zenoh tries them for ever and says nothing.

A name server that does not answer keeps whoever asks waiting for long, so a thread asks, which nobody waits for.
"""

import ipaddress
import re
import socket
import threading
from collections.abc import Iterable, Mapping

WITH_PORT = ("tcp", "udp", "tls", "quic", "ws")
"""Protocols whose addresses are HOST:PORT."""
ASK_EVERY_S = 10.0
"""A network may come later, and a name with it."""


def host_of(address: str) -> str:
    """The name in an address that has to be resolved; empty where there is none."""
    protocol, _, place = address.partition("/")
    host = re.split("[?#]", place)[0].rpartition(":")[0].strip("[]")
    if protocol not in WITH_PORT:
        return ""
    try:
        ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    return ""


class Names:
    """Asks for the names in some addresses again and again, from `begin` to `end`."""

    def __init__(self, addresses: Iterable[str]) -> None:
        self._hosts = {address: host for address in addresses if (host := host_of(address))}
        self.unresolved: Mapping[str, str] = {}
        """Address to why its name cannot be resolved, as it was when that was last asked."""
        self._ended = threading.Event()

    def begin(self) -> None:
        """Does nothing where there is no name."""
        self._ended = threading.Event()
        if self._hosts:
            threading.Thread(target=self._ask, args=(self._ended,), name="names", daemon=True).start()

    def end(self) -> None:
        """What is under way is not waited for."""
        self._ended.set()

    def _ask(self, ended: threading.Event) -> None:
        while not ended.is_set():
            answers = {address: _why_not(host) for address, host in self._hosts.items()}
            self.unresolved = {address: why for address, why in answers.items() if why}
            ended.wait(ASK_EVERY_S)


def _why_not(host: str) -> str:
    """Why a name cannot be resolved; empty where it can."""
    try:
        socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError as error:
        return error.strerror or str(error)
    except UnicodeError:  # what could be no name anywhere
        return "it is no name of a computer"
    return ""
