"""A `Network` over Eclipse Zenoh (https://zenoh.io): every agent is a peer, found by multicast or at given addresses.

Messages are put with the most urgent or an ordinary priority, and dropped where a link is congested: what is lost the
agents notice and send again, which they do anyway for those out of reach. Zenoh's own threads read; they hand over to
the event loop and wait for nothing.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Mapping
from types import TracebackType
from typing import Any, Self

from fieldkit.errors import ConfigError, DeviceError
from fieldkit.extras import need
from fieldkit.ports import DriverContext

GREETINGS = "fieldkit/who-is-here"
"""Where all missions say who they are: those of two keys, which hear nothing else of each other, learn of it."""
MOST_WAITING = 1_000
"""Messages that wait for the event loop; the oldest go first."""


def open_network(topic: str, options: Mapping[str, Any], around: DriverContext) -> "ZenohNetwork":
    """Options: `listen` and `connect`, addresses such as tcp/192.168.1.10:7447; `scouting`, a switch, on by default."""
    unknown = options.keys() - {"listen", "connect", "scouting"}
    if unknown:
        raise ConfigError(
            f"network zenoh: no option {', '.join(sorted(unknown))}; there are: listen, connect, scouting"
        )
    return ZenohNetwork(
        topic,
        tuple(options.get("listen", ())),
        tuple(options.get("connect", ())),
        bool(options.get("scouting", True)),
    )


class ZenohNetwork:
    """One peer. To be opened with `async with`."""

    def __init__(self, topic: str, listen: tuple[str, ...], connect: tuple[str, ...], scouting: bool) -> None:
        self._key = f"fieldkit/{topic}"
        self._listen, self._connect, self._scouting = listen, connect, scouting
        looks = [f"at {address}" for address in connect]
        looks += ["by multicast on 224.0.0.224:7446"] if scouting else []
        self.where = ", ".join(looks) or "nowhere: others must come by themselves"
        self._session: Any = None
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue()

    async def __aenter__(self) -> Self:
        zenoh = need("zenoh", "agents")
        self._waiting = asyncio.Queue()
        loop = asyncio.get_running_loop()
        try:
            self._session = await loop.run_in_executor(None, zenoh.open, self._config(zenoh))
        except zenoh.ZError as error:
            raise DeviceError(
                f"network zenoh: cannot be opened ({error}); is an address wrong, or in use?"
            ) from error
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
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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
