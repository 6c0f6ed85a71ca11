"""Fixtures for drivers on emulated wires."""

import asyncio
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from drivers.emulators.wires import PluggedModule, PtyWire
from drivers.emulators.xbee import PROFILES, Module
from drivers.xbee.receiver import XBeeReceiver, open_receiver
from fieldkit.clock import RealClock
from fieldkit.messages import ReceiverState, RssReading
from fieldkit.ports import DriverContext

sys.path.insert(0, str(Path(__file__).parents[1] / "contract"))
from benches import FRAME, until


class Listening:
    """A receiver that is open, and everything it has given so far."""

    def __init__(self, receiver: XBeeReceiver) -> None:
        self.receiver = receiver
        self.items: list[RssReading | ReceiverState] = []

    @property
    def readings(self) -> list[RssReading]:
        return [item for item in self.items if isinstance(item, RssReading)]

    @property
    def states(self) -> list[ReceiverState]:
        return [item for item in self.items if isinstance(item, ReceiverState)]

    async def until(self, condition: Callable[[], bool], timeout_s: float = 10.0) -> None:
        await until(condition, timeout_s)


@pytest.fixture
async def plug(tmp_path: Path) -> AsyncIterator[Callable[..., Any]]:
    """Make an emulated module on a pty: `await plug("s2c", AP=1)`."""
    radios: list[PluggedModule] = []

    async def make(profile: str = "s2c", serial_number: int = 0x0013A200400A0B0C, **settings: int) -> Any:
        module = Module(PROFILES[profile], serial_number, settings)
        radio = PluggedModule(module, PtyWire(tmp_path / f"radio{len(radios)}"))
        await radio.plug()
        radios.append(radio)
        return radio

    yield make
    for radio in radios:
        radio.unplug()


@asynccontextmanager
async def listening(port: str, **options: Any) -> AsyncIterator[Listening]:
    """Open a receiver and collect what it gives."""
    receiver = open_receiver("ada", {"port": port, **options}, DriverContext(RealClock(), FRAME))
    async with receiver:
        heard = Listening(receiver)

        async def collect() -> None:
            async for item in receiver.readings():
                heard.items.append(item)

        task = asyncio.create_task(collect())
        yield heard
    await asyncio.wait({task}, timeout=5.0)
    assert task.done(), "readings() outlived the receiver"


@pytest.fixture(name="listening")
def _listening() -> Callable[..., Any]:
    return listening
