"""An XBee module as its serial port shows it: a state machine without a clock or a wire of its own.

Written against Digi 90000982 (S1), 90001500 (S2C) and 90002273 (XBee 3); the golden bytes in the tests are
the manuals'. Local AT commands (0x08, 0x09), text command mode (`+++`) and reception are answered as the
module does; anything it would transmit is only counted. During an energy scan (ED) it hears nothing and answers late.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field

from drivers.xbee.frames import ESCAPE, START, Deframer, frame

NOISE_DBM = -95.0
OK, ERROR, INVALID_COMMAND, INVALID_PARAMETER = 0, 1, 2, 3


@dataclass(frozen=True, slots=True)
class Profile:
    """What one hardware and firmware answers."""

    name: str
    hardware_version: bytes
    firmware_version: bytes
    saturation_dbm: float
    sensitivity_dbm: float
    legacy_only: bool = False
    """No AO parameter: every reception comes as 0x80 or 0x81."""
    mesh: bool = False
    """Receptions carry no RSSI whatever AO says."""


PROFILES = {
    profile.name: profile
    for profile in (
        Profile("s1", b"\x17\x44", b"\x10\xef", -40.0, -92.0, legacy_only=True),
        Profile("s1pro", b"\x18\x44", b"\x10\xef", -36.0, -100.0, legacy_only=True),
        Profile("s2c", b"\x2e\x41", b"\x20\x03", -40.0, -102.0),
        Profile("xb3", b"\x42\x41", b"\x20\x0d", -40.0, -103.0),
        Profile("900hp", b"\x23\x41", b"\x80\x75", -40.0, -101.0, mesh=True),
        Profile("zigbee", b"\x2e\x41", b"\x40\x60", -40.0, -102.0, mesh=True),
    )
}


@dataclass
class Module:
    """One module. Times are wall seconds on any steady scale."""

    profile: Profile = field(default_factory=lambda: PROFILES["s2c"])
    serial_number: int = 0x0013A200400A0B0C
    settings: dict[str, int] = field(default_factory=dict)
    """Overrides of the settings below, by AT name."""
    dead: bool = False
    """Answers nothing, as without power."""
    energy_dbm: dict[int, float] = field(default_factory=dict)
    """Channel to the energy a scan finds there; elsewhere `NOISE_DBM`."""
    busy_until_s: float = 0.0

    def __post_init__(self) -> None:
        listening = {
            "AP": 2,
            "AO": 2,
            "MM": 1,
            "MY": 0xFFFE,
            "ID": 0x3332,
            "CH": 0x0C,
            "CE": 0,
            "BD": 7,
            "DB": 0,
        }
        self.values = listening | self.settings
        self.transmitted = 0
        """Frames the host asked to send over the air: a listening driver's must stay 0."""
        self.asked: list[str] = []
        """AT commands from the host, in order."""
        self.bytes_in = 0
        """Bytes the host has written."""
        self._deframer = Deframer()
        self._text = b""
        self._text_until_s = -1.0
        self._last_byte_s = -1e9

    def reboot(self) -> bytes:
        """Settings stay; the last strength is forgotten. Modem status 0: hardware reset."""
        self._deframer = Deframer()
        self._text, self._text_until_s, self.busy_until_s = b"", -1.0, 0.0
        self.values["DB"] = 0
        return frame(b"\x8a\x00", escaped=self.values["AP"] == 2) if self.values["AP"] else b""

    # The host's side

    def receive(self, data: bytes, now_s: float) -> list[bytes]:
        """Bytes from the host; what the module answers, in order."""
        self.bytes_in += len(data)
        if self.dead:
            return []
        silent_s, self._last_byte_s = now_s - self._last_byte_s, now_s
        if now_s < self._text_until_s:
            return list(self._text_mode(data, now_s))
        if data == b"+++" and silent_s >= 1.0 and self.values["AP"] == 0:
            self._text_until_s = now_s + 10.0
            return [b"OK\r"]
        if self.values["AP"] == 0:
            self.transmitted += 1
            return []
        replies = []
        for _, received in self._deframer.feed(data, 0, escaped=self._reads_escaped(data)):
            if (reply := self._answer(received[3:-1], now_s)) is not None:
                replies.append(frame(reply, escaped=self.values["AP"] == 2))
        return replies

    def _reads_escaped(self, data: bytes) -> bool:
        """digi-xbee sends its first frame unescaped whatever the mode; that frame has nothing to escape."""
        return self.values["AP"] == 2 and (ESCAPE in data or data.count(START) <= 1)

    def _answer(self, data: bytes, now_s: float) -> bytes | None:
        kind = data[0]
        if kind in (0x08, 0x09) and len(data) >= 4:
            name = data[2:4].decode("ascii", "replace").upper()
            self.asked.append(name)
            status, value = self._scan(data[4:], now_s) if name == "ED" else self._at(name, data[4:])
            return bytes([0x88, data[1]]) + data[2:4] + bytes([status]) + value
        if kind in (0x00, 0x01, 0x10, 0x11, 0x17) and len(data) >= 2:
            self.transmitted += 1
            return bytes([0x8B if kind in (0x10, 0x11) else 0x89, data[1], 0]) if kind != 0x17 else None
        return None

    def _scan(self, parameter: bytes, now_s: float) -> tuple[int, bytes]:
        """ED: busy for as long as the parameter says; then each channel's energy, a byte each."""
        value = int.from_bytes(parameter, "big")
        if self.profile.legacy_only and value > 6:
            return INVALID_PARAMETER, b""
        lasts_s = 16 * 0.01536 * 2**value if self.profile.legacy_only else value / 1000
        self.busy_until_s = now_s + lasts_s
        first, count = (12, 12) if self.profile.name == "s1pro" else (11, 16)
        levels = [self.energy_dbm.get(first + n, NOISE_DBM) for n in range(count)]
        return OK, bytes(round(-level) for level in levels)

    def _at(self, name: str, parameter: bytes) -> tuple[int, bytes]:
        high, low = self.serial_number >> 32, self.serial_number & 0xFFFFFFFF
        fixed = {
            "HV": self.profile.hardware_version,
            "VR": self.profile.firmware_version,
            "SH": high.to_bytes(4, "big"),
            "SL": low.to_bytes(4, "big"),
            "NI": b" ",
        }
        if name in fixed:
            return OK, fixed[name]
        unknown = name not in self.values or (name == "AO" and self.profile.legacy_only)
        if unknown or (name == "MY" and self.profile.name == "900hp"):
            return INVALID_COMMAND, b""
        if parameter:
            self.values[name] = int.from_bytes(parameter, "big")
            return OK, b""
        value = self.values[name]
        width = 2 if name in ("MY", "ID") else 1
        return OK, value.to_bytes(width, "big")

    def _text_mode(self, data: bytes, now_s: float) -> Iterator[bytes]:
        self._text += data
        self._text_until_s = now_s + 10.0
        while b"\r" in self._text:
            line, self._text = self._text.split(b"\r", 1)
            command = line.decode("ascii", "replace").upper()
            name, value = command[2:4], command[4:].strip()
            if not command.startswith("AT"):
                yield b"ERROR\r"
            elif name == "CN":
                self._text_until_s = -1.0
                yield b"OK\r"
            elif value:
                status, _ = self._at(name, int(value, 16).to_bytes(4, "big"))
                yield b"OK\r" if status == OK else b"ERROR\r"
            else:
                status, answer = self._at(name, b"")
                yield f"{int.from_bytes(answer, 'big'):X}\r".encode() if status == OK else b"ERROR\r"

    # The air's side

    def hear(
        self, rss_dbm: float, sender: int, payload: bytes, *, short_address: bool = False
    ) -> bytes | None:
        """A packet on the air at `rss_dbm`; what the module writes to its port, None if it does not hear it.

        `sender` is a 64-bit address, or a 16-bit one with `short_address`.
        """
        if self.dead or rss_dbm < self.profile.sensitivity_dbm:
            return None
        rssi = round(-min(rss_dbm, self.profile.saturation_dbm))
        self.values["DB"] = rssi
        if self.values["AP"] == 0:
            return payload
        return frame(self._reception(rssi, sender, payload, short_address), escaped=self.values["AP"] == 2)

    def sample(self, rss_dbm: float, sender: int, digital: int, *, short_address: bool = False) -> bytes:
        """An IO sample of four digital lines on the air (frames 0x82, 0x83); legacy output only."""
        rssi = round(-min(rss_dbm, self.profile.saturation_dbm))
        self.values["DB"] = rssi
        head = b"\x83" + sender.to_bytes(2, "big") if short_address else b"\x82" + sender.to_bytes(8, "big")
        body = bytes([rssi, 0x00, 1]) + (0x000F).to_bytes(2, "big") + (digital & 0x0F).to_bytes(2, "big")
        return frame(head + body, escaped=self.values["AP"] == 2)

    def _reception(self, rssi: int, sender: int, payload: bytes, short_address: bool) -> bytes:
        broadcast = 0x02
        long = sender.to_bytes(8, "big") if not short_address else b"\xff" * 8
        short = sender.to_bytes(2, "big") if short_address else b"\xff\xfe"
        output = 0 if self.profile.mesh else self.values["AO"]
        if not self.profile.mesh and (self.profile.legacy_only or output == 2):
            head = b"\x81" + short if short_address else b"\x80" + long
            return head + bytes([rssi, broadcast]) + payload
        if output == 1:
            return b"\x91" + long + short + b"\xe8\xe8\x00\x11\xc1\x05" + bytes([broadcast]) + payload
        return b"\x90" + long + short + bytes([broadcast]) + payload
