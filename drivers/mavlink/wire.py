"""MAVLink's frame marks and checksum. Source: https://mavlink.io/en/guide/serialization.html"""

import binascii

V1, V2 = 0xFE, 0xFD

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def checksum(frame: bytes, crc_extra: int) -> bytes:
    """The two check bytes of a frame given up to its payload's end: CRC-16/MCRF4XX, start mark left out.

    `crc_extra` is the message definition's own byte. The standard library computes the same polynomial with
    the bits the other way round.
    """
    value = binascii.crc_hqx((frame[1:] + bytes([crc_extra])).translate(_REVERSED), 0xFFFF)
    return bytes((_REVERSED[value >> 8], _REVERSED[value & 0xFF]))
