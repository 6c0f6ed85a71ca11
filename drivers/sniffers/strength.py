"""Received strength out of captured 802.15.4 packets, by link type.

283 (TAP): type-length-value headers with RSS as a float, in dBm. 195 (with check bytes): some dongles put
strength and correlation where the check bytes were. 230 (without): no strength at all.
Sources: LINKTYPE_IEEE802_15_4_TAP specification 1.2; TI CC24xx/CC253x data sheets (appended status bytes).
"""

import struct
from dataclasses import dataclass

from drivers.sniffers.ieee802154 import fcs

TAP, WITH_FCS, WITHOUT_FCS = 283, 195, 230
_FCS_TYPE, _RSS, _CHANNEL, _LQI = 0, 1, 3, 10
CC253X_OFFSET_DB = -73
"""RSSI register to dBm on CC253x; on CC2420 it is -45."""


@dataclass(frozen=True, slots=True)
class Strength:
    """One packet's strength, None where the capture holds none, and its frame without check bytes."""

    rss_dbm: float | None
    psdu: bytes
    channel: int | None = None
    lqi: int | None = None


def from_tap(data: bytes) -> Strength | None:
    """A TAP packet; None if its headers do not add up."""
    if len(data) < 4 or data[0] != 0:
        return None
    (size,) = struct.unpack_from("<H", data, 2)
    if size % 4 or not 4 <= size <= len(data):
        return None
    rss_dbm: float | None = None
    channel = lqi = None
    check_bytes, at = 0, 4
    while at + 4 <= size:
        kind, length = struct.unpack_from("<HH", data, at)
        value = data[at + 4 : at + 4 + length]
        if at + 4 + length > size:
            return None
        if kind == _FCS_TYPE and length >= 1:
            check_bytes = {0: 0, 1: 2, 2: 4}.get(value[0], 0)
        elif kind == _RSS and length >= 4:
            rss_dbm = struct.unpack("<f", value[:4])[0]
        elif kind == _CHANNEL and length >= 3:
            channel = int.from_bytes(value[:2], "little")
        elif kind == _LQI and length >= 1:
            lqi = value[0]
        at += 4 + (length + 3) // 4 * 4
    psdu = data[size : len(data) - check_bytes] if check_bytes else data[size:]
    return Strength(rss_dbm, psdu, channel, lqi)


def has_real_fcs(data: bytes) -> bool:
    """Whether a packet of type 195 ends in its true check bytes."""
    return len(data) >= 3 and fcs(data[:-2]) == data[-2:]


def from_status_bytes(data: bytes, offset_db: int = CC253X_OFFSET_DB) -> Strength | None:
    """A packet of type 195 with TI's status for check bytes: signed RSSI, check-good bit and correlation."""
    if len(data) < 5 or not data[-1] & 0x80:
        return None
    rssi = int.from_bytes(data[-2:-1], "big", signed=True)
    return Strength(float(rssi + offset_db), data[:-2], lqi=data[-1] & 0x7F)
