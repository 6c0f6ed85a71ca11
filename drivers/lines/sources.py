"""Where lines come from: a serial device, a network, standard input, a pipe, a growing file, a broker, Kismet.

Each is a `ByteLink`: `read` waits a moment and gives what has come, and raises `OSError` when its device is gone.
"""

import contextlib
import os
import select
import selectors
import socket
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path

import serial

from drivers.links import (
    READ_TIMEOUT_S,
    ByteLink,
    TappedLink,
    absent,
    device_and_baud,
    host_and_port,
    open_link,
)
from fieldkit.errors import DeviceError

POLL_S = 0.05
ENDED_S = 0.01
"""Between two looks at a pipe that nobody writes into."""
LARGEST_DATAGRAM = 65_536
MOST_CLIENTS = 16
ALONE_S = 5.0
"""Wall time without anybody at the far end after which that is said: a program may open and close for each line."""

PORTS = (
    "a serial device (/dev/ttyUSB0, or with its rate /dev/ttyUSB0:4800), socket://HOST:PORT, "
    "tcp://HOST:PORT (waits for connections), udp://HOST:PORT, "
    "- (standard input), a file or pipe, mqtt://HOST/TOPIC, kismet://HOST:PORT, kismetdb:FILE"
)

SCHEMES = ("udp", "tcp", "mqtt", "kismet", "kismets")
"""Before :// in addresses of our own; pyserial knows the others."""


def refused_scheme(port: str) -> str:
    """What to say of an address that begins with a scheme there is not; empty for any other port."""
    scheme, separator, _ = port.partition("://")
    if not separator or scheme in SCHEMES:
        return ""
    try:
        serial.serial_for_url(port, do_not_open=True)
    except (ValueError, OSError) as error:
        return f"there are no {scheme}:// addresses" if "protocol" in str(error) else ""
    return ""


def open_source(
    port: str, baud: int, device: str, *, from_start: bool, tap: Callable[[bytes], None] | None = None
) -> ByteLink:
    """Open what `port` names. Raises `DeviceError` with the remedy."""
    if refused := refused_scheme(port):
        raise DeviceError(f"{device}: {port}: {refused}; a port may be {PORTS}")
    try:
        link = _open(port, baud, device, from_start)
    except DeviceError:
        raise
    except (OSError, ValueError) as error:
        raise DeviceError(f"{device}: {port}: {error}; a port may be {PORTS}") from error
    return link if tap is None else TappedLink(link, tap)


def _open(port: str, baud: int, device: str, from_start: bool) -> ByteLink:
    scheme, _, rest = port.partition("://")
    if port == "-":
        return StdinLink()
    if scheme == "udp":
        return UdpLink(*host_and_port(rest))
    if scheme == "tcp":
        return TcpServerLink(*host_and_port(rest))
    if scheme == "mqtt":
        from drivers.lines.broker import MqttLink

        return MqttLink(rest, device)
    if scheme in ("kismet", "kismets"):
        from drivers.lines.kismet import KismetLink

        return KismetLink(port, device)
    if port.startswith("kismetdb:"):
        from drivers.lines.kismet import KismetDbLink

        return KismetDbLink(Path(port.removeprefix("kismetdb:")), from_start)
    name, own_baud = device_and_baud(port)
    path = Path(name.removeprefix("file:"))
    if "://" not in port and path.exists() and not stat.S_ISCHR(path.stat().st_mode):
        return PipeLink(path) if stat.S_ISFIFO(path.stat().st_mode) else FileLink(path, from_start)
    return JoinedLink(open_link(name, own_baud or baud, device))


class JoinedLink:
    """A device that was printing before anybody listened: a first line that has lost its beginning is left out.

    "-107" without its first two characters is a far too strong 07. Where nothing comes while it is opened, the device
    is between two lines, and the next one is whole.
    """

    def __init__(self, link: ByteLink) -> None:
        """Waits a moment for what it prints. Raises `OSError`."""
        self._link = link
        self.write, self.close = link.write, link.close
        self._held = link.read()
        self._is_cut = bool(self._held)
        self.arrived_s = link.arrived_s

    @property
    def absent(self) -> str:
        """As the link itself says it."""
        return absent(self._link)

    def read(self) -> bytes:
        data, self._held = self._held or self._link.read(), b""
        self.arrived_s = self._link.arrived_s
        if not self._is_cut:
            return data
        ends = [at for at in (data.find(b"\n"), data.find(b"\r")) if at >= 0]
        self._is_cut = not ends
        return data[min(ends) :] if ends else b""


class _Listening:
    """What sources that only listen have in common."""

    nobody = ""
    """What is to be said when there is nobody at the far end."""

    def __init__(self) -> None:
        self.arrived_s = self._joined_s = time.monotonic()

    def _see(self, somebody: bool) -> None:
        """Whether there is somebody at the far end now."""
        if somebody:
            self._joined_s = time.monotonic()

    @property
    def absent(self) -> str:
        """Why nothing can be heard though the port is open; empty where somebody may print."""
        return self.nobody if self.nobody and time.monotonic() - self._joined_s > ALONE_S else ""

    def write(self, data: bytes) -> None:
        """Nothing is ever sent."""
        raise OSError("this source cannot be written to")


class UdpLink(_Listening):
    """Datagrams to a port of ours; each ends its last line, whether a newline does or not."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.bind((host, port))
        self._socket.settimeout(READ_TIMEOUT_S)

    def read(self) -> bytes:
        """All datagrams that wait."""
        try:
            came = [self._socket.recv(LARGEST_DATAGRAM)]
        except TimeoutError:
            return b""
        self.arrived_s = time.monotonic()
        self._socket.setblocking(False)
        try:
            while len(came) < 256:
                came.append(self._socket.recv(LARGEST_DATAGRAM))
        except BlockingIOError:
            pass
        finally:
            self._socket.settimeout(READ_TIMEOUT_S)
        return b"".join(data if data.endswith(b"\n") else data + b"\n" for data in came)

    def close(self) -> None:
        """Twice is harmless."""
        self._socket.close()


class TcpServerLink(_Listening):
    """A port that radios connect to. Lines of several are not mixed within a line."""

    nobody = "no radio is connected to the port"

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._server = socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
        self._server.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._server, selectors.EVENT_READ)
        self._rest: dict[socket.socket, bytes] = {}

    def read(self) -> bytes:
        """Whole lines only."""
        lines = b""
        for key, _ in self._selector.select(READ_TIMEOUT_S):
            if key.fileobj is self._server:
                self._accept()
            elif isinstance(key.fileobj, socket.socket):
                lines += self._take(key.fileobj)
        if lines:
            self.arrived_s = time.monotonic()
        self._see(bool(self._rest))
        return lines

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError):
            client, _ = self._server.accept()
            if len(self._rest) >= MOST_CLIENTS:
                client.close()
                return
            client.setblocking(False)
            self._rest[client] = b""
            self._selector.register(client, selectors.EVENT_READ)

    def _take(self, client: socket.socket) -> bytes:
        try:
            data = client.recv(LARGEST_DATAGRAM)
        except OSError:
            data = b""
        if not data:
            rest = self._rest.pop(client)
            self._selector.unregister(client)
            client.close()
            return rest + b"\n" if rest else b""
        whole, newline, rest = (self._rest[client] + data).rpartition(b"\n")
        self._rest[client] = rest[-LARGEST_DATAGRAM:]
        return whole + newline

    def close(self) -> None:
        """Twice is harmless."""
        for client in self._rest:
            client.close()
        self._rest.clear()
        self._selector.close()
        self._server.close()


class StdinLink(_Listening):
    """What another program prints into ours. Its end is the end: it cannot be opened again."""

    def __init__(self) -> None:
        super().__init__()
        self._descriptor = sys.stdin.fileno()

    def read(self) -> bytes:
        """Raises `OSError` at its end."""
        if not select.select([self._descriptor], [], [], READ_TIMEOUT_S)[0]:
            return b""
        data = os.read(self._descriptor, LARGEST_DATAGRAM)
        if not data:
            raise OSError("the program that prints has ended")
        self.arrived_s = time.monotonic()
        return data

    def close(self) -> None:
        """Standard input stays open: it is not ours to close."""


class PipeLink(_Listening):
    """A named pipe; whoever writes may come and go."""

    nobody = "no program writes into the pipe"

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path
        self._descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)

    def read(self) -> bytes:
        """Raises `OSError` when the pipe is removed."""
        if not self._path.exists():
            raise FileNotFoundError(f"{self._path} was removed")
        select.select([self._descriptor], [], [], READ_TIMEOUT_S)
        try:
            data = os.read(self._descriptor, LARGEST_DATAGRAM)
        except BlockingIOError:  # somebody has it open, and writes nothing now
            self._see(True)
            return b""
        if not data:  # nobody has: the pipe is at its end, and goes on with the next writer
            time.sleep(ENDED_S)
            return b""
        self._see(True)
        self.arrived_s = time.monotonic()
        return data

    def close(self) -> None:
        """Twice is harmless."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


class FileLink(_Listening):
    """A file that grows; one that was cut or replaced is read anew from its beginning.

    Whole lines only: half a line of the old file and the beginning of the new one are not a line.
    """

    def __init__(self, path: Path, from_start: bool) -> None:
        super().__init__()
        self._path = path
        self._open()
        if not from_start and self._file.seek(0, os.SEEK_END):
            self._file.seek(-1, os.SEEK_END)
            self._in_a_line = self._file.read(1) != b"\n"

    def _open(self) -> None:
        self._file = self._path.open("rb")
        self._inode = os.fstat(self._file.fileno()).st_ino
        self._rest = b""
        self._in_a_line = False
        """What comes next is the end of a line whose beginning was not read."""

    def read(self) -> bytes:
        """Raises `OSError` when the file is removed."""
        data = self._file.read(LARGEST_DATAGRAM)
        if data:
            self.arrived_s = time.monotonic()
            return self._whole(data)
        now = self._path.stat()
        if now.st_ino != self._inode or now.st_size < self._file.tell():
            self._file.close()
            self._open()
        time.sleep(POLL_S)
        return b""

    def _whole(self, data: bytes) -> bytes:
        whole, newline, rest = (self._rest + data).rpartition(b"\n")
        self._rest = rest
        if len(rest) > LARGEST_DATAGRAM:  # whoever splits it drops it as too long
            whole, newline, self._rest = whole + newline + rest, b"", b""
        if newline and self._in_a_line:
            self._in_a_line = False
            whole = whole.partition(b"\n")[2]
        return whole + newline

    def close(self) -> None:
        """Twice is harmless."""
        self._file.close()
