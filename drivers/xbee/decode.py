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

Via = Literal["rx64", "rx16", "io"]

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
    frame_id: str
    """Sender's address and a checksum of the payload: the same packet has the same id at every robot."""


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
