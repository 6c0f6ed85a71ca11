"""MAVLink's bytes over UDP, TCP or serial: no blocking, no busy loop at the end of a stream, losses counted.

Addresses: `udpin:host:port` (vehicles send to us; one socket, many vehicles), `udpout:host:port`,
`tcp:host:port`, `serial:/dev/ttyUSB0:57600` or a plain device path.
"""

import asyncio
import contextlib
import logging
import socket
import threading
from collections.abc import Callable
from typing import Any, Protocol

from drivers.links import ByteLink, device_and_baud, host_and_port, open_link
from fieldkit.errors import ConfigError, DeviceError

logger = logging.getLogger(__name__)

Peer = Any
"""The other end of a link: hashable; a socket address, a port's name."""
OnData = Callable[[bytes, Peer], None]
MAX_PEERS = 64
"""Addresses remembered per link; forged ones must not fill the memory."""
RECONNECT_EVERY_S = 1.0
"""Wall time between attempts to take a lost TCP or serial link back."""
TCP_CONNECT_S = 5.0
SEND_BUFFER = 65536
"""Bytes waiting to be sent beyond which a frame is dropped: late commands are worse than lost ones."""


class Transport(Protocol):
    """Carries bytes. `send` never blocks and never raises: what cannot leave is counted in `dropped`."""

    dropped: int
    default_peer: Peer | None
    """The peer to greet before any was heard; None where vehicles must speak first."""

    async def open(self, on_data: OnData) -> None: ...

    def send(self, data: bytes, peer: Peer) -> None: ...

    async def close(self) -> None: ...


def make_transport(address: str) -> Transport:
    """The transport an address asks for. Raises `ConfigError`."""
    kind, _, rest = address.partition(":")
    try:
        if kind in ("udpin", "udp"):
            return Udp(host_and_port(rest), listen=True)
        if kind == "udpout":
            return Udp(host_and_port(rest), listen=False)
        if kind == "tcp":
            return Tcp(*host_and_port(rest))
    except ValueError as error:
        raise ConfigError(f"vehicle address {address!r}: {error}") from None
    device = rest if kind == "serial" else address
    path, baud = device_and_baud(device)
    if baud is not None:
        return Serial(path, baud)
    if kind == "serial" or device.startswith(("/dev/", "COM")):
        return Serial(device, 57600)
    raise ConfigError(
        f"vehicle address {address!r}: expected udpin:host:port, udpout:host:port, tcp:host:port "
        "or serial:/dev/ttyUSB0:57600"
    )


class Udp:
    """One datagram socket. Reads all that waits at each wake-up: a backlog would look like a lost vehicle."""

    def __init__(self, address: tuple[str, int], *, listen: bool) -> None:
        self._address, self._listen = address, listen
        self.dropped = 0
        self.default_peer: Peer | None = None if listen else address
        self._socket: socket.socket | None = None
        self._endpoint: asyncio.DatagramTransport | None = None

    async def open(self, on_data: OnData) -> None:
        self._on_data = on_data
        self._loop = asyncio.get_running_loop()
        made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.setblocking(False)
        with contextlib.suppress(OSError):
            made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        try:
            made.bind(self._address if self._listen else ("", 0))
            if not self._listen:
                self.default_peer = (socket.gethostbyname(self._address[0]), self._address[1])
        except OSError as error:
            made.close()
            host, port = self._address
            raise DeviceError(
                f"vehicle link udp {host}:{port}: {error.strerror or error}; "
                "is QGroundControl, MAVProxy or another fieldkit using that port?"
            ) from error
        try:
            self._loop.add_reader(made.fileno(), self._drain)
        except NotImplementedError:  # Windows: the proactor loop watches no sockets
            self._endpoint, _ = await self._loop.create_datagram_endpoint(
                lambda: _Datagrams(on_data), sock=made
            )
        self._socket = made

    def _drain(self) -> None:
        while self._socket is not None:
            try:
                data, peer = self._socket.recvfrom(65535)
            except BlockingIOError:
                return
            except OSError:  # an earlier datagram bounced; there may be more to read
                continue
            self._on_data(data, peer)

    def send(self, data: bytes, peer: Peer) -> None:
        try:
            if self._endpoint is not None:
                self._endpoint.sendto(data, peer)
            elif self._socket is not None:
                self._socket.sendto(data, peer)
        except OSError:
            self.dropped += 1

    async def close(self) -> None:
        if self._socket is not None:
            if self._endpoint is not None:
                self._endpoint.close()
            else:
                self._loop.remove_reader(self._socket.fileno())
                self._socket.close()
            self._socket = None


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, on_data: OnData) -> None:
        self.datagram_received = on_data  # type: ignore[method-assign,assignment]


class Copy:
    """Sends a copy of what comes in to somebody on UDP; nothing that goes wrong with it concerns the link."""

    def __init__(self, address: str) -> None:
        try:
            self._address = host_and_port(address)
        except ValueError as error:
            raise ConfigError(f"vehicle option 'forward' {address!r}: {error}") from None
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """From now on."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def send(self, data: bytes) -> None:
        """Dropped where it cannot leave."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._address)

    def close(self) -> None:
        """Closing twice is harmless."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class Tcp:
    """One stream; reconnected by a task of its own when it ends."""

    def __init__(self, host: str, port: int) -> None:
        self._host, self._port = host, port
        self.dropped = 0
        self.default_peer: Peer | None = (host, port)
        self._writer: asyncio.StreamWriter | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self, on_data: OnData) -> None:
        try:
            async with asyncio.timeout(TCP_CONNECT_S):
                reader, self._writer = await asyncio.open_connection(self._host, self._port)
        except (OSError, TimeoutError) as error:
            raise DeviceError(
                f"vehicle link tcp {self._host}:{self._port}: {error or 'no answer'}; "
                "is the autopilot or router up?"
            ) from error
        self._task = asyncio.create_task(self._run(reader, on_data), name="mavlink-tcp")

    async def _run(self, reader: asyncio.StreamReader, on_data: OnData) -> None:
        while True:
            with contextlib.suppress(OSError):
                while data := await reader.read(65536):
                    on_data(data, self.default_peer)
            logger.warning("vehicle link tcp %s:%d ended; reconnecting", self._host, self._port)
            self._hang_up()
            while self._writer is None:
                await asyncio.sleep(RECONNECT_EVERY_S)
                with contextlib.suppress(OSError, TimeoutError):
                    async with asyncio.timeout(TCP_CONNECT_S):
                        reader, self._writer = await asyncio.open_connection(self._host, self._port)

    def send(self, data: bytes, peer: Peer) -> None:
        if self._writer is None or self._writer.transport.get_write_buffer_size() > SEND_BUFFER:
            self.dropped += 1
        else:
            self._writer.write(data)

    def _hang_up(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
            self._task = None
        self._hang_up()


class Serial:
    """A serial port: one thread reads, one writes, both reconnect."""

    def __init__(self, path: str, baud: int) -> None:
        self._path, self._baud = path, baud
        self.dropped = 0
        self.default_peer: Peer | None = path
        self._link: ByteLink | None = None
        self._closing = threading.Event()
        self._outbox: list[bytes] = []
        self._more = threading.Condition()
        self._threads: list[threading.Thread] = []

    async def open(self, on_data: OnData) -> None:
        self._link = open_link(self._path, self._baud, "vehicle link")
        self._loop = asyncio.get_running_loop()
        work: list[tuple[Any, tuple[Any, ...]]] = [(self._read, (on_data,)), (self._write, ())]
        self._threads = [threading.Thread(target=target, args=args, daemon=True) for target, args in work]
        for thread in self._threads:
            thread.start()

    def _read(self, on_data: OnData) -> None:
        while not self._closing.is_set():
            try:
                if self._link is None:
                    self._link = open_link(self._path, self._baud, "vehicle link")
                if data := self._link.read():
                    self._loop.call_soon_threadsafe(on_data, data, self._path)
            except OSError as error:
                if self._link is not None:
                    logger.warning("vehicle link %s lost (%s); reconnecting", self._path, error)
                    self._link.close()
                    self._link = None
                self._closing.wait(RECONNECT_EVERY_S)

    def _write(self) -> None:
        while True:
            with self._more:
                self._more.wait_for(lambda: self._outbox or self._closing.is_set())
                if self._closing.is_set():
                    return
                data, self._outbox = b"".join(self._outbox), []
            try:
                if self._link is not None:
                    self._link.write(data)
            except OSError:
                self.dropped += 1

    def send(self, data: bytes, peer: Peer) -> None:
        with self._more:
            if self._link is None or sum(map(len, self._outbox)) > SEND_BUFFER:
                self.dropped += 1
                return
            self._outbox.append(data)
            self._more.notify()

    async def close(self) -> None:
        self._closing.set()
        with self._more:
            self._more.notify()
        for thread in self._threads:
            await asyncio.to_thread(thread.join) if thread.is_alive() else None
        if self._link is not None:
            self._link.close()
            self._link = None
