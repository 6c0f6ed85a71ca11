"""A `Network` in process: agents in one event loop over the simulated air, in that loop's time."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from types import TracebackType
from typing import Self

import numpy as np

from fieldkit.clock import Clock
from fieldkit.world.network import Air, Network, Place


class Ether:
    """What the members of one network share. `places_m` says where everybody is now."""

    def __init__(
        self, air: Air, seed: int, clock: Clock, places_m: Callable[[], Mapping[str, Place]]
    ) -> None:
        self._network = Network(air, np.random.default_rng(seed))
        self._clock, self._places_m = clock, places_m
        self._members: dict[str, FakeNetwork] = {}

    @property
    def carried(self) -> Mapping[str, int]:
        """Bytes that each member has sent."""
        return self._network.carried

    def member(self, name: str) -> "FakeNetwork":
        """One robot's end."""
        self._members[name] = FakeNetwork(name, self)
        return self._members[name]

    def send(self, name: str, data: bytes) -> None:
        """To all in reach, with the delays of the air."""
        now_s = self._clock.elapsed_s()
        air = self._network.air
        self._network.send(
            now_s, name, data, {n: p for n, p in self._places_m().items() if n in self._members}
        )
        for wait_s in {
            air.delay_s,
            air.delay_s + air.jitter_s,
            air.delay_s + 2.0 if air.repeated else air.delay_s,
        }:
            asyncio.get_running_loop().call_later((wait_s + 1e-6) / self._clock.rate, self._deliver)

    def _deliver(self) -> None:
        for name, data in self._network.arrived(self._clock.elapsed_s()):
            self._members[name].hear(data)


class FakeNetwork:
    """One robot's `Network` over an `Ether`."""

    def __init__(self, name: str, ether: Ether) -> None:
        self.where = "in this process"
        self.unresolved: Mapping[str, str] = {}
        self._name, self._ether = name, ether
        self._waiting: asyncio.Queue[bytes | None] = asyncio.Queue()
        self._open = False

    async def __aenter__(self) -> Self:
        self._waiting, self._open = asyncio.Queue(), True
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open = False
        self._waiting.put_nowait(None)

    def publish(self, data: bytes, *, urgent: bool = False) -> None:
        """See `Network`."""
        if self._open:
            self._ether.send(self._name, data)

    def greet(self, data: bytes) -> None:
        """See `Network`. All of one ether hear all."""
        self.publish(data)

    async def messages(self) -> AsyncIterator[bytes]:
        """See `Network`."""
        while (data := await self._waiting.get()) is not None:
            yield data

    def hear(self, data: bytes) -> None:
        """A message arrives."""
        if self._open:
            self._waiting.put_nowait(data)
