"""The wires emulated devices sit on: a pseudo-terminal, or TCP where there is none; inside an event loop."""

import asyncio
import errno
import os
import random
import time
from collections.abc import Callable
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from drivers.emulators.faults import Rewrite

REPLY_S = (0.003, 0.005)
"""How long a device takes to answer, wall time. Faster replies break stock digi-xbee: it misses them."""


class Device(Protocol):
    """A state machine behind a wire."""

    serial_number: int
    busy_until_s: float
    """Steady wall time until which it answers nothing and hears nothing: an energy scan."""

    def reboot(self) -> bytes:
        """Power off and on: what it says on its port as it starts."""
        ...

    def receive(self, data: bytes, now_s: float) -> list[bytes]:
        """Bytes from the host; the answers, in order."""
        ...

    def hear(
        self, rss_dbm: float, sender: int, payload: bytes, *, short_address: bool = False
    ) -> bytes | None:
        """A packet on the air; what the device writes to its host, None if it does not hear it."""
        ...


DeviceType = TypeVar("DeviceType", bound=Device)


class Wire(Protocol):
    """The device's end of a wire. `port` is what the host opens."""

    port: str

    async def open(self, on_bytes: Callable[[bytes], None]) -> None: ...

    def write(self, data: bytes) -> bool:
        """Send at once; False if the other side does not take it: a UART would have lost it."""
        ...

    def close(self) -> None:
        """Unplug: the host's end fails."""
        ...


class PtyWire:
    """A pseudo-terminal; `link` gives the host a name that stays when the pty is another one."""

    def __init__(self, link: Path | None = None) -> None:
        self._link = link
        self.port = ""

    async def open(self, on_bytes: Callable[[bytes], None]) -> None:
        import tty

        self._on_bytes = on_bytes
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        name = os.ttyname(self._slave)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(name)
        self.port = str(self._link or name)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._master, self._readable)

    def _readable(self) -> None:
        try:
            data = os.read(self._master, 4096)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise
            return
        self._on_bytes(data)

    def write(self, data: bytes) -> bool:
        if self._master < 0:
            return False
        try:
            sent = os.write(self._master, data)
        except BlockingIOError:
            return False
        return sent == len(data)

    def close(self) -> None:
        if self._master >= 0:
            self._loop.remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)
            self._master = -1
            if self._link is not None:
                self._link.unlink(missing_ok=True)


class TcpWire:
    """A TCP port with one client at a time, as serial servers do it; keeps its number when opened again."""

    def __init__(self, host: str = "127.0.0.1", number: int = 0) -> None:
        self._host, self._number = host, number
        self.port = ""
        self._server: asyncio.Server | None = None
        self._client: asyncio.StreamWriter | None = None

    async def open(self, on_bytes: Callable[[bytes], None]) -> None:
        self._on_bytes = on_bytes
        self._server = await asyncio.start_server(self._serve, self._host, self._number)
        self._number = self._server.sockets[0].getsockname()[1]
        self.port = f"socket://{self._host}:{self._number}"

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._client is not None:
            self._client.close()
        self._client = writer
        try:
            while data := await reader.read(4096):
                self._on_bytes(data)
        except (ConnectionError, asyncio.CancelledError):
            pass
        finally:
            writer.close()
            if self._client is writer:
                self._client = None

    def write(self, data: bytes) -> bool:
        if self._client is None or self._client.transport.get_write_buffer_size() > 65536:
            return False
        self._client.write(data)
        return True

    def close(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        if self._client is not None:
            self._client.transport.abort()
            self._client = None


def make_wire(link: Path | None = None) -> Wire:
    """A pty where the system has them, else TCP on the loopback."""
    return PtyWire(link) if hasattr(os, "openpty") else TcpWire()


class PluggedModule(Generic[DeviceType]):
    """A device on a wire: answers after the time a real one takes, and suffers faults on request."""

    def __init__(self, module: DeviceType, wire: Wire) -> None:
        self.module = module
        self.wire = wire
        self.rewrite: Rewrite | None = None
        """Applied to the next bytes the device writes, once."""
        self.always: Rewrite | None = None
        """Applied to all bytes, in both directions."""
        self.lost_writes = 0
        self._held: list[bytes] | None = None
        self._delay = random.Random(module.serial_number)
        self._free_at_s = 0.0

    async def plug(self) -> None:
        await self.wire.open(self._from_host)

    def unplug(self) -> None:
        self.wire.close()

    async def move(self, wire: Wire) -> None:
        """Plug it in elsewhere, under another name."""
        self.unplug()
        self.wire = wire
        await self.plug()

    def reboot(self) -> None:
        """The device starts anew; its port stays, as behind a USB adapter."""
        banner = self.module.reboot()
        if banner:
            self.write(banner)

    def pause(self) -> None:
        """Nothing arrives until `resume`."""
        self._held = []

    def resume(self) -> None:
        """Everything held back arrives at once."""
        held, self._held = self._held or [], None
        for data in held:
            self.write(data)

    def _from_host(self, data: bytes) -> None:
        now_s = time.monotonic()
        if self.always is not None:
            data = self.always(data)
        for reply in self.module.receive(data, now_s):
            free_s = max(now_s, self._free_at_s, self.module.busy_until_s)
            self._free_at_s = free_s + self._delay.uniform(*REPLY_S)
            asyncio.get_running_loop().call_later(self._free_at_s - now_s, self.write, reply)

    def hear(self, rss_dbm: float, sender: int, payload: bytes, *, short_address: bool = False) -> bool:
        """A packet on the air; True if it went out to the host."""
        if time.monotonic() < self.module.busy_until_s:
            return False
        data = self.module.hear(rss_dbm, sender, payload, short_address=short_address)
        return data is not None and self.write(data)

    def write(self, data: bytes) -> bool:
        """Put bytes on the wire, through the pending fault if there is one."""
        if self._held is not None:
            self._held.append(data)
            return True
        if self.always is not None:
            data = self.always(data)
        if self.rewrite is not None:
            data, self.rewrite = self.rewrite(data), None
        sent = self.wire.write(data)
        self.lost_writes += not sent
        return sent
