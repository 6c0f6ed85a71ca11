"""Byte links: blocking read and write over a serial device, `socket://`, `rfc2217://` or any pyserial URL.

What is read here has no meaning yet; framing belongs to the drivers. Times are wall times: a wire does not
know how fast mission time runs.
"""

import contextlib
import errno
import math
import os
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import serial

from drivers.arrival import Attention, wait_readable
from fieldkit.clock import Clock
from fieldkit.errors import ConfigError, DeviceError

READ_TIMEOUT_S = 0.1
"""A read gives up after this long, so that whoever reads can see that it should stop."""
CONNECT_TIMEOUT_S = 3.0
REOPEN_AFTER_S = 5.0
"""A connection that nobody has read for so long is opened anew: its far end sends what waits there any time later."""


class ByteLink(Protocol):
    """Bytes in, bytes out. Any method raises `OSError` when the device is gone."""

    arrived_s: float
    """When the first byte of what was read last came in, by `time.monotonic()`."""

    def read(self) -> bytes:
        """What has arrived, waiting up to `READ_TIMEOUT_S` for the first byte; empty if nothing came."""
        ...

    def write(self, data: bytes) -> None:
        """Send all of `data`."""
        ...

    def close(self) -> None:
        """Let go of the device. Closing twice is harmless."""
        ...


class SerialLink:
    """A device path or a pyserial URL, opened for one user only."""

    def __init__(self, url: str, baud: int) -> None:
        self._port: Any = serial.serial_for_url(url, do_not_open=True, baudrate=baud)
        self._port.timeout = READ_TIMEOUT_S
        if "://" not in url:
            self._port.write_timeout = 2.0  # pyserial's rfc2217:// refuses to open with one
            if os.name == "posix":
                self._port.exclusive = True
        self._port.open()
        self.arrived_s = time.monotonic()
        try:
            self._descriptor = int(self._port.fileno())
        except (AttributeError, OSError, TypeError, ValueError):  # Windows, rfc2217://
            self._descriptor = -1

    def read(self) -> bytes:
        arrived_s: float | None = None
        if self._descriptor >= 0:
            arrived_s = wait_readable(self._port.fileno(), READ_TIMEOUT_S)
            if arrived_s is None:
                return b""
        first: bytes = self._port.read(1)
        if not first:
            return b""
        self.arrived_s = time.monotonic() if arrived_s is None else arrived_s
        waiting = self._port.in_waiting
        return first + self._port.read(waiting) if waiting else first

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._port.close()


class TcpLink:
    """`socket://host:port`, read in chunks: pyserial's own handler reads one byte per call."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S)
        self.arrived_s = time.monotonic()
        self._attention = Attention()
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        # The radio end may vanish without a word; ask after 5 s of silence, where the system can.
        for name, value in (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 1), ("TCP_KEEPCNT", 3)):
            if hasattr(socket, name):
                self._socket.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    def read(self) -> bytes:
        away_s = self._attention.look()
        arrived_s = wait_readable(self._socket.fileno(), READ_TIMEOUT_S)
        if (away_s := max(away_s, self._attention.look())) > REOPEN_AFTER_S:
            raise ConnectionResetError(f"nobody read it for {away_s:.1f} s: it is opened anew")
        if arrived_s is None:
            return b""
        self.arrived_s = arrived_s
        data = self._socket.recv(4096)
        if not data:
            raise ConnectionResetError("the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        self._socket.sendall(data)

    def close(self) -> None:
        self._socket.close()


def absent(link: ByteLink) -> str:
    """Why nobody can be heard though the port is open; empty where that is not known of the link."""
    return str(getattr(link, "absent", ""))


def arrival_ns(link: ByteLink, clock: Clock) -> int:
    """Mission time at which the first byte of what was read last came in."""
    for _ in range(3):
        before_s = time.monotonic()
        now_ns = clock.now_ns()
        if time.monotonic() - before_s < 0.0005:
            break  # else another thread came in between, and the two readings do not belong together
    late_s = before_s - link.arrived_s
    return now_ns - round(late_s * clock.rate * 1e9) if math.isfinite(clock.rate) else now_ns


class TappedLink:
    """A link whose incoming bytes are shown to somebody else too."""

    def __init__(self, link: ByteLink, tap: Callable[[bytes], None]) -> None:
        self._link, self._tap = link, tap
        self.write, self.close, self.arrived_s = link.write, link.close, link.arrived_s

    @property
    def absent(self) -> str:
        """As the link itself says it."""
        return absent(self._link)

    def read(self) -> bytes:
        if data := self._link.read():
            self.arrived_s = self._link.arrived_s
            self._tap(data)
        return data


class WatchedLink:
    """A link whose reader notices when it did not run: what waited meanwhile came nobody knows when."""

    def __init__(self, link: ByteLink, on_away: Callable[[float], None]) -> None:
        """`on_away` gets the seconds for which nobody looked, before what waited is handed over."""
        self._link, self._on_away = link, on_away
        self._attention = Attention()
        self.write, self.close, self.arrived_s = link.write, link.close, link.arrived_s

    @property
    def settled(self) -> bool:
        """What was read last came while somebody looked."""
        return self._attention.settled

    @property
    def absent(self) -> str:
        """As the link itself says it."""
        return absent(self._link)

    def read(self) -> bytes:
        away_s = self._attention.look()
        try:
            data = self._link.read()
            self.arrived_s = self._link.arrived_s
        finally:
            if (away_s := max(away_s, self._attention.look())) > 0.0:
                self._on_away(away_s)
        return data


def open_link(url: str, baud: int, device: str, tap: Callable[[bytes], None] | None = None) -> ByteLink:
    """Open a link. `device` names it in errors; `tap` is shown what comes in. Raises `DeviceError` with the remedy."""
    try:
        if url.startswith("socket://"):
            host, port = host_and_port(url.removeprefix("socket://"))
            link: ByteLink = TcpLink(host, port)
        else:
            link = SerialLink(url, baud)
    except (OSError, ValueError) as error:
        raise DeviceError(f"{device}: {_why(url, error)}") from error
    return link if tap is None else TappedLink(link, tap)


@dataclass(frozen=True, slots=True)
class UsbIdentity:
    """What distinguishes one USB device from another, wherever it is plugged in."""

    vendor: int
    product: int
    serial: str


def usb_identity(port: str) -> UsbIdentity | None:
    """The USB device behind a port; None for anything else, and for one without a serial number."""
    from serial.tools import list_ports

    for there in list_ports.comports():
        if os.path.realpath(there.device) == os.path.realpath(port) and there.vid and there.serial_number:
            return UsbIdentity(there.vid, there.pid, there.serial_number)
    return None


def port_of(identity: UsbIdentity) -> str | None:
    """Where a USB device is plugged in now; None if it is not."""
    from serial.tools import list_ports

    for there in list_ports.comports():
        if (there.vid, there.pid, there.serial_number) == (
            identity.vendor,
            identity.product,
            identity.serial,
        ):
            return str(there.device)
    return None


def host_and_port(text: str) -> tuple[str, int]:
    """`host:port`, split. Raises `ConfigError` that says what was expected."""
    host, separator, port = text.rpartition(":")
    if not separator or not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ConfigError(f"expected host:port, got {text!r}")
    return host.strip("[]"), int(port)


def device_and_baud(text: str) -> tuple[str, int | None]:
    """A serial device and the rate behind its name, as in /dev/ttyUSB0:4800; None where it names none."""
    device, separator, baud = text.rpartition(":")
    named = separator and baud.isdigit() and "://" not in text and not device.endswith(("/", ":"))
    if not named or Path(text).exists():  # names under /dev/serial/by-path have colons of their own
        return text, None
    return device, int(baud)


def _why(url: str, error: Exception) -> str:
    """What kept a link from opening, and what to try."""
    words = str(error).lower()
    if isinstance(error, ConnectionRefusedError):
        return f"{url}: connection refused; is the serial server (ser2net, emulator) running on that port?"
    if isinstance(error, TimeoutError):
        return f"{url}: no connection within {CONNECT_TIMEOUT_S:g} s; check the address and the network"
    if "://" in url:
        return f"{url}: {error}"
    number = getattr(error, "errno", None)
    if "lock" in words or number in (11, 16) or "busy" in words:
        return (
            f"{url} is in use by another program; close it (XCTU, a terminal, another fieldkit) and try again"
        )
    if number == 13 or "permission" in words or "access is denied" in words:
        return f"no permission to open {url}; on Linux add yourself to the group 'dialout' and log in again"
    if number in (2, 6) or "could not open port" in words or "no such file" in words:
        return f"no device at {url}; {_ports_there_are()}"
    if number == errno.ENOTTY or "inappropriate ioctl" in words:
        return f"{url} is no serial device; {_ports_there_are()}"
    return f"{url}: {error}"


def _ports_there_are() -> str:
    from serial.tools import list_ports

    found = sorted(
        port.device for port in list_ports.comports() if "ttyS" not in port.device or port.hwid != "n/a"
    )
    by_id = Path("/dev/serial/by-id")
    if by_id.is_dir():
        found += sorted(str(entry) for entry in by_id.iterdir())
    return (
        f"ports there are: {', '.join(found)}"
        if found
        else "no serial port is there: is the radio plugged in?"
    )
