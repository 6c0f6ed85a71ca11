"""Received frames to readings: the one place where an RSSI byte becomes dBm.

The byte is the received strength as a positive number of -dBm (0x28 is -40 dBm): Digi 90000982, frames
0x80 to 0x83. 0x00 means "no value"; 0xFF is what damaged firmware reports; neither is a measurement.
"""

import zlib
from dataclasses import dataclass
from typing import Any, Literal

from digi.xbee.exception import XBeeException
from digi.xbee.models.mode import OperatingMode
from digi.xbee.packets.raw import RX16IOPacket, RX16Packet, RX64IOPacket, RX64Packet

Via = Literal["rx64", "rx16", "io", "db"]

_CLASSES: dict[int, tuple[Any, Via]] = {
    0x80: (RX64Packet, "rx64"),
    0x81: (RX16Packet, "rx16"),
    0x82: (RX64IOPacket, "io"),
    0x83: (RX16IOPacket, "io"),
}
WITHOUT_RSSI = (0x90, 0x91, 0x92)
"""Receive frames of AO=0, AO=1 and of the mesh firmwares: they carry no strength."""
MODEM_STATUS = 0x8A


@dataclass(frozen=True, slots=True)
class Heard:
    """One received transmission."""

    rss_dbm: float
    via: Via
    frame_id: str | None
    """Sender's address and a checksum of the payload: the same packet has the same id at every robot.

    None where the strength is not surely this sender's."""


@dataclass(frozen=True, slots=True)
class DbAnswer:
    """The module's word on its last packet's strength, None where it has none, to the question `number`."""

    number: int
    rss_dbm: float | None


def name_of(frame: bytes) -> str | None:
    """Sender and payload checksum of a reception without strength (0x90, 0x91, 0x92); None if it is too short.

    0x90 and 0x92: type, 8 and 2 bytes of address, options, data. 0x91 has six more bytes before the options.
    """
    head = 20 if frame[3] == 0x91 else 14
    if len(frame) < 3 + head:
        return None
    long, short = frame[4:12], frame[12:14]
    address = long if long != b"\xff" * 8 else short
    return f"{address.hex().upper()}/{zlib.crc32(frame[head + 1 : -1]):08x}"


def db_answer(frame: bytes) -> DbAnswer | None:
    """The answer to ATDB: 88, number, 'DB', status, strength as a positive number of -dBm."""
    if len(frame) < 9 or frame[3] != 0x88:
        return None
    value = int.from_bytes(frame[8:-1], "big")
    return DbAnswer(frame[4], rss_dbm_of(value) if frame[7] == 0 else None)


def rss_dbm_of(rssi: int) -> float | None:
    """The RSSI byte in dBm, None where it is no measurement."""
    return -float(rssi) if 0 < rssi < 0xFF else None


def decode(frame: bytes) -> Heard | None:
    """What a frame says was heard; None if it is no reception with RSSI, or is malformed."""
    known = _CLASSES.get(frame[3])
    if known is None:
        return None
    packet_class, via = known
    try:
        packet = packet_class.create_packet(bytearray(frame), OperatingMode.API_MODE)
        rss_dbm = rss_dbm_of(packet.rssi)
        address = packet.x64bit_source_addr if frame[3] in (0x80, 0x82) else packet.x16bit_source_addr
    except (XBeeException, ValueError, IndexError, TypeError):
        return None
    if rss_dbm is None:
        return None
    data = frame[14:-1] if frame[3] in (0x80, 0x82) else frame[8:-1]
    return Heard(rss_dbm, via, f"{address}/{zlib.crc32(data):08x}")
