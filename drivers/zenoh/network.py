"""A `Network` over Eclipse Zenoh (https://zenoh.io): every agent is a peer, found by multicast or at given addresses.

Messages are put with the most urgent or an ordinary priority, and dropped where a link is congested: what is lost the
agents notice and send again, which they do anyway for those out of reach. Zenoh's own threads read; they hand over to
the event loop and wait for nothing.
"""

import asyncio
import json
import re
from collections.abc import AsyncIterator, Iterable, Mapping
from types import TracebackType
from typing import Any, Self

from drivers.zenoh.names import WITH_PORT, Names
from fieldkit.errors import ConfigError, DeviceError
from fieldkit.extras import need
from fieldkit.ports import DriverContext

GREETINGS = "fieldkit/who-is-here"
"""Where all missions say who they are: those of two keys, which hear nothing else of each other, learn of it."""
ENTRY_POINTS = {"listen": "tcp/0.0.0.0:7447", "connect": "tcp/192.168.1.11:7447"}
"""Options that are addresses, and an example of each."""
MOST_WAITING = 1_000
"""Messages that wait for the event loop; the oldest go first."""


def open_network(topic: str, options: Mapping[str, Any], around: DriverContext) -> "ZenohNetwork":
    """Options: `listen` and `connect`, addresses such as tcp/192.168.1.10:7447; `scouting`, a switch, on by default."""
    unknown = options.keys() - {"listen", "connect", "scouting"}
    if unknown:
        raise ConfigError(
            f"network zenoh: no option {', '.join(sorted(unknown))}; there are: listen, connect, scouting"
        )
    listen, connect = (_addresses(options.get(name, ()), name) for name in ENTRY_POINTS)
    return ZenohNetwork(topic, listen, connect, bool(options.get("scouting", True)))


def _addresses(given: Iterable[str], option: str) -> tuple[str, ...]:
    """Each once. Raises `ConfigError` for one that Zenoh would not take, or would take and never reach."""
    for address in given:
        if not _may_be_one(address, least_port=0 if option == "listen" else 1):
            raise ConfigError(
                f"--{option}: expected PROTOCOL/HOST:PORT, such as {ENTRY_POINTS[option]}, got {address!r}"
            )
    return tuple(dict.fromkeys(given))


def _may_be_one(address: str, least_port: int) -> bool:
    protocol, separator, place = address.partition("/")
    if protocol not in WITH_PORT:
        return bool(re.fullmatch("[a-z0-9-]+", protocol) and separator and place)
    host, _, port = re.split("[?#]", place)[0].rpartition(":")
    is_named = bool(host) and "/" not in host and (":" not in host or host.endswith("]"))
    return is_named and port.isascii() and port.isdecimal() and least_port <= int(port) <= 65535


def _why(error: Exception) -> str:
    """What kept Zenoh from opening, without where in its own code that was, and what to do."""
    text = re.sub(r" at \S+\.rs:\d+\.?", "", str(error))
    lower = text.lower()
    if "in use" in lower:
        what = "another agent, or another program, listens there: give --listen another port, or end that one"
    elif "assign requested address" in lower:
        what = f"this computer has no such address: --listen {ENTRY_POINTS['listen']} takes all that it has"
    elif "not supported for" in lower:
        what = f"fieldkit's Zenoh has no such protocol; there are: {', '.join(WITH_PORT)}, unixsock-stream"
    else:
        what = "is an address wrong?"
    return f"network zenoh: cannot be opened ({text}); {what}"


class ZenohNetwork:
    """One peer. To be opened with `async with`."""

    def __init__(self, topic: str, listen: tuple[str, ...], connect: tuple[str, ...], scouting: bool) -> None:
        self._key = f"fieldkit/{topic}"
        self._listen, self._connect, self._scouting = listen, connect, scouting
        looks = [f"at {address}" for address in connect]
        looks += ["by multicast on 224.0.0.224:7446"] if scouting else []
        self.where = ", ".join(looks) or "nowhere: others must come by themselves"
        self._session: Any = None
        self._names = Names(connect)
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue()

    @property
    def unresolved(self) -> Mapping[str, str]:
        """See `Network`."""
        return self._names.unresolved

    async def __aenter__(self) -> Self:
        zenoh = need("zenoh", "agents")
        self._waiting = asyncio.Queue()
        loop = asyncio.get_running_loop()
        try:
            self._session = await loop.run_in_executor(None, zenoh.open, self._config(zenoh))
        except zenoh.ZError as error:
            raise DeviceError(_why(error)) from error
        self._urgent = self._publisher(zenoh, self._key, zenoh.Priority.REAL_TIME, express=True)
        self._ordinary = self._publisher(zenoh, self._key, zenoh.Priority.DATA, express=False)
        self._greetings = self._publisher(zenoh, GREETINGS, zenoh.Priority.DATA, express=False)

        def heard(sample: Any) -> None:
            data = sample.payload.to_bytes()
            try:
                loop.call_soon_threadsafe(self._put, data)
            except RuntimeError:  # the loop has been closed
                return

        self._subscribers = [
            self._session.declare_subscriber(key, heard, allowed_origin=zenoh.Locality.REMOTE)
            for key in (self._key, GREETINGS)
        ]
        self._names.begin()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._names.end()
        session, self._session = self._session, None
        if session is not None:
            await asyncio.get_running_loop().run_in_executor(None, session.close)
        self._waiting.put_nowait(None)

    def publish(self, data: bytes, *, urgent: bool = False) -> None:
        """See `Network`."""
        if self._session is not None:
            (self._urgent if urgent else self._ordinary).put(data)

    def greet(self, data: bytes) -> None:
        """See `Network`."""
        if self._session is not None:
            self._greetings.put(data)

    async def messages(self) -> AsyncIterator[bytes]:
        """See `Network`."""
        while (data := await self._waiting.get()) is not None:
            yield data

    def _put(self, data: bytes) -> None:
        if self._waiting.qsize() >= MOST_WAITING:
            self._waiting.get_nowait()
        self._waiting.put_nowait(data)

    def _publisher(self, zenoh: Any, key: str, priority: Any, *, express: bool) -> Any:
        drop = zenoh.CongestionControl.DROP
        return self._session.declare_publisher(
            key, congestion_control=drop, priority=priority, express=express
        )

    def _config(self, zenoh: Any) -> Any:
        config = zenoh.Config()
        config.insert_json5("mode", json.dumps("peer"))
        config.insert_json5("scouting/multicast/enabled", json.dumps(self._scouting))
        if self._listen:
            config.insert_json5("listen/endpoints", json.dumps(self._listen))
        if self._connect:
            config.insert_json5("connect/endpoints", json.dumps(self._connect))
        # Others may come, and go, at any time: one that is not there is tried again, and not waited for.
        config.insert_json5("connect/timeout_ms", json.dumps(-1))
        config.insert_json5("connect/exit_on_failure", json.dumps(False))
        return config
