"""What an IEEE 802.15.4 frame says of its sender: enough of the MAC header to distinguish transmissions.

Frame control, sequence number, addressing: IEEE 802.15.4-2015, 7.2. The check sequence is CRC-16 of
polynomial 0x1021, reflected, start value 0 (7.2.10).
"""

import binascii

ACK = 2
_NONE, _SHORT, _LONG = 0, 2, 3
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def fcs(psdu: bytes) -> bytes:
    """The two check bytes of a frame given without them."""
    # crc_hqx is the unreflected polynomial: reflect the input's bits and the result's.
    value = binascii.crc_hqx(psdu.translate(_REVERSED), 0)
    return bytes((_REVERSED[value >> 8], _REVERSED[value & 0xFF]))


def frame_id(psdu: bytes) -> str | None:
    """`PAN:address/sequence number` of the sender; None for an acknowledgement or a frame that names nobody.

    The same transmission has the same id at every robot. Given without check bytes.
    """
    if len(psdu) < 3:
        return None
    control = psdu[0] | psdu[1] << 8
    kind, compressed, version = control & 7, bool(control & 0x40), control >> 12 & 3
    destination, source = control >> 10 & 3, control >> 14 & 3
    if kind == ACK or source not in (_SHORT, _LONG) or version > 2:
        return None
    suppressed = version == 2 and bool(control & 0x0100)
    at = 2 if suppressed else 3
    number = "" if suppressed else f"/{psdu[2]:02x}"
    pan = b""
    if destination in (_SHORT, _LONG):
        pan = psdu[at : at + 2]
        at += 2 + (2 if destination == _SHORT else 8)
    if not (compressed and destination != _NONE):
        pan = psdu[at : at + 2]
        at += 2
    size = 2 if source == _SHORT else 8
    address = psdu[at : at + size]
    if len(pan) < 2 or len(address) < size:
        return None
    return f"{pan[::-1].hex().upper()}:{address[::-1].hex().upper()}{number}"
