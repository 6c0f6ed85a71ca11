"""Sniffer dongles as their serial ports show them: Nordic's text firmware and TI's binary one.

They hear only while asked to capture, and only their channel. `now_us` is the dongle's own clock.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.sniffers.ieee802154 import fcs
from drivers.sniffers.ti import (
    CHECK_GOOD,
    DATA,
    END,
    PING,
    SET_FREQUENCY,
    START,
    START_CAPTURE,
    STOP_CAPTURE,
)
from fieldkit import settings as given

PAN = 0x1AAA
PROMPT = b"\x1b[1;32muart:~$ \x1b[m"


def data_frame(sender: int, payload: bytes, number: int, *, short_address: bool = False) -> bytes:
    """A broadcast data frame without check bytes: PAN compressed, source short or long."""
    control = 0x8841 if short_address else 0xC841
    source = sender.to_bytes(2 if short_address else 8, "little")
    head = control.to_bytes(2, "little") + bytes([number & 0xFF]) + PAN.to_bytes(2, "little") + b"\xff\xff"
    return head + source + payload


@dataclass
class NrfDongle:
    """Nordic's firmware: a shell with a prompt and an echo, frames as lines of text."""

    now_us: Callable[[], int]
    channel: int = given.CHANNEL
    """The channel on which transmissions are made; what it listens on is set by command."""
    signed_time: bool = True
    serial_number: int = 1
    busy_until_s: float = 0.0
    capturing: bool = field(default=False, init=False)
    listening_on: int = field(default=11, init=False)

    def reboot(self) -> bytes:
        """Hears nothing until it is asked again to capture; the shell says its prompt."""
        self.capturing, self.listening_on, self._line, self._echo = False, 11, b"", True
        return b"*** Booting Zephyr OS ***\r\n" + PROMPT

    def __post_init__(self) -> None:
        self._line = b""
        self._echo = True
        self._number = 0

    def receive(self, data: bytes, now_s: float) -> list[bytes]:
        self._line += data
        replies = [data] if self._echo else []
        while b"\r\n" in self._line:
            line, self._line = self._line.split(b"\r\n", 1)
            words = line.decode("ascii", "replace").split()
            if words == ["receive"]:
                self.capturing = True
            elif words == ["sleep"]:
                self.capturing = False
            elif words[:2] == ["shell", "echo"]:
                self._echo = words[2:] == ["on"]
            elif words[:1] == ["channel"] and len(words) == 2 and words[1].isdigit():
                self.listening_on = int(words[1])
            replies.append(b"\r\n" + PROMPT)
        return replies

    def hear(
        self, rss_dbm: float, sender: int, payload: bytes, *, short_address: bool = False
    ) -> bytes | None:
        if not self.capturing or self.listening_on != self.channel:
            return None
        self._number += 1
        psdu = data_frame(sender, payload, self._number, short_address=short_address)
        time = self.now_us() & 0xFFFFFFFF
        if self.signed_time and time >= 1 << 31:
            time -= 1 << 32
        text = (psdu + fcs(psdu)).hex()
        return f"received: {text} power: {round(rss_dbm)} lqi: 120 time: {time}\r\n".encode()


@dataclass
class TiDongle:
    """TI's firmware: binary packets, found by length. Payloads may contain the end marker."""

    now_us: Callable[[], int]
    channel: int = given.CHANNEL
    with_checksum: bool = False
    serial_number: int = 2
    busy_until_s: float = 0.0
    capturing: bool = field(default=False, init=False)
    listening_on: int = field(default=0, init=False)

    def reboot(self) -> bytes:
        """Hears nothing until it is asked again to capture, and silent about it."""
        self.capturing, self.listening_on, self._buffer = False, 0, b""
        return b""

    def __post_init__(self) -> None:
        self._buffer = b""
        self._number = 0

    def receive(self, data: bytes, now_s: float) -> list[bytes]:
        self._buffer += data
        replies: list[bytes] = []
        while (begin := self._buffer.find(START)) >= 0:
            self._buffer = self._buffer[begin:]
            if len(self._buffer) < 8:
                break
            length = int.from_bytes(self._buffer[3:5], "little")
            if len(self._buffer) < 8 + length:
                break
            number, body = self._buffer[2], self._buffer[5 : 5 + length]
            self._buffer = self._buffer[8 + length :]
            self._obey(number, body)
            replies.append(self._packet(0x80, bytes([0] if number != PING else [0, 0x50, 0x10, 0x01, 0x00])))
        return replies

    def _obey(self, number: int, body: bytes) -> None:
        if number == START_CAPTURE:
            self.capturing = True
        elif number == STOP_CAPTURE:
            self.capturing = False
        elif number == SET_FREQUENCY:
            self.listening_on = (int.from_bytes(body[:2], "little") - 2405) // 5 + 11

    def hear(
        self, rss_dbm: float, sender: int, payload: bytes, *, short_address: bool = False
    ) -> bytes | None:
        if not self.capturing or self.listening_on != self.channel:
            return None
        self._number += 1
        psdu = data_frame(sender, payload, self._number, short_address=short_address)
        strength = round(rss_dbm).to_bytes(1, "big", signed=True)
        time = (self.now_us() & (1 << 48) - 1).to_bytes(6, "little")
        return self._packet(DATA, time + psdu + strength + bytes([CHECK_GOOD]))

    def _packet(self, info: int, payload: bytes) -> bytes:
        body = bytes([info]) + len(payload).to_bytes(2, "little") + payload
        check = bytes([sum(body) & 0xFF]) if self.with_checksum or info != DATA else b""
        return START + body + check + END
