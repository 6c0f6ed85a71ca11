"""Radios that print what they hear, each in the words of its own firmware; they take no commands."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime

Style = Callable[["PrintingRadio", float, str, int], str]
"""A line from received power, the sender's name and the packet's number."""


def _mac(sender: str) -> str:
    number = int.from_bytes(sender.encode()[-6:].rjust(6, b"\x02"), "big")
    return ":".join(f"{byte:02x}" for byte in number.to_bytes(6, "big"))


def _utc(radio: "PrintingRadio") -> str:
    time = datetime.fromtimestamp(radio.now_us() / 1e6, UTC)
    return time.strftime("%Y-%m-%d %H:%M:%S.") + f"{time.microsecond // 1000:03d}"


def _meshtastic(radio: "PrintingRadio", rss: float, sender: str, number: int) -> str:
    packet = {"fromId": f"!{sender}", "id": number, "rxSnr": 6.25, "rxRssi": round(rss)}
    return json.dumps(
        packet | {"rxTime": radio.now_us() // 1_000_000, "decoded": {"portnum": "TEXT_MESSAGE_APP"}}
    )


def _rtl_433(radio: "PrintingRadio", rss: float, sender: str, number: int) -> str:
    return json.dumps(
        {"model": "Acurite-Tower", "id": sender, "channel": "A", "rssi": round(rss, 3), "snr": 18.3}
    )


STYLES: dict[str, Style] = {
    "json": lambda radio, rss, sender, number: json.dumps({"rss_dbm": round(rss, 1), "source_id": sender}),
    "esp32-wifi": lambda radio, rss, sender, number: (
        f" 1 | {sender:<32.32} | {round(rss):5d} | {6:2d} | WPA2"
    ),
    "esp32-ble": lambda radio, rss, sender, number: (
        f"Advertised Device: Name: {sender}, Address: {_mac(sender)}, rssi: {round(rss)}"
    ),
    "meshtastic": _meshtastic,
    "rylr": lambda radio, rss, sender, number: f"+RCV={int(sender, 36) % 65536},5,HELLO,{round(rss)},40",
    "rak": lambda radio, rss, sender, number: f"+EVT:RXP2P:{round(rss)}:11:48656C6C6F",
    "lora-e5": lambda radio, rss, sender, number: f"+TEST: LEN:5, RSSI:{round(rss)}, SNR:10",
    "rtl_433": _rtl_433,
    "ctt": lambda radio, rss, sender, number: f"{_utc(radio)},4,{sender.upper():>08},{round(rss)},,0",
}
"""By the name of the map that reads them."""

ALIVE = {
    "esp32-wifi": "Scan done",
    "esp32-ble": "Devices found: 0",
    "rylr": "+READY",
    "json": '{"rss_dbm": null}',
}
"""What it prints while it hears nothing, where its firmware prints anything."""


@dataclass
class PrintingRadio:
    """A device for `wires`: what it hears it prints, with a number of its own for each packet."""

    now_us: Callable[[], int]
    style: str = "json"
    serial_number: int = 1
    busy_until_s: float = 0.0
    _number: int = field(default=0, init=False)

    def reboot(self) -> bytes:
        """It says a few words as it starts, as boot loaders do."""
        return b"ets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET)\r\n"

    def receive(self, data: bytes, now_s: float) -> list[bytes]:
        """It listens to nobody."""
        return []

    def hear(
        self, rss_dbm: float, sender: int, payload: bytes, *, short_address: bool = False
    ) -> bytes | None:
        """A packet on the air as it prints it."""
        self._number += 1
        return (STYLES[self.style](self, rss_dbm, f"{sender:x}"[-8:], self._number) + "\r\n").encode()

    def alive(self) -> bytes:
        """What it prints now and then though it hears nothing; empty where it is silent."""
        return (ALIVE[self.style] + "\r\n").encode() if self.style in ALIVE else b""
