"""Energy scan (ATED): how strongly anything is heard on each channel, without transmitting.

The one thing an XBee can say about networks that are not its own, WiFi and Bluetooth included; it names nobody.
While it scans, the module hears no packets. S1: the parameter is an exponent, each channel takes 2^n x 15.36 ms
(Digi 90000982, ED). S2C and XBee 3: milliseconds for the whole scan, 0 to 3A98 (Digi 90001500, 90002273). The
answer holds a channel's strongest energy as a positive number of -dBm; the manuals show it as text, in API frames
some firmwares send bytes, so both are read.
"""

import re

FIRST_CHANNEL, CHANNELS = 11, 16
FIRST_CHANNEL_PRO = 12
"""S1 PRO modules scan 12 or 13 channels, from 12 up."""
S1_CHANNEL_S = 0.01536
LONGEST_S = 15.0


def parameter(scan_s: float, *, legacy: bool) -> tuple[bytes, float]:
    """ED's parameter for a scan of all channels of about `scan_s`, and how long it will really take, in s."""
    if not legacy:
        milliseconds = round(1000 * min(max(scan_s, 0.01), LONGEST_S))
        return milliseconds.to_bytes(2, "big"), milliseconds / 1000
    exponent = 0
    while exponent < 6 and CHANNELS * S1_CHANNEL_S * 2**exponent < scan_s:
        exponent += 1
    return bytes([exponent]), CHANNELS * S1_CHANNEL_S * 2**exponent


def energies(answer: bytes) -> dict[int, float]:
    """Channel to its strongest energy in dBm. Empty if the answer makes no sense."""
    if re.fullmatch(rb"[0-9A-Fa-f]{1,2}([,\r][0-9A-Fa-f]{1,2}){11,15}[,\r]?", answer):
        values = [int(each, 16) for each in re.split(rb"[,\r]", answer.rstrip(b",\r"))]
    else:
        values = list(answer)
    if not 12 <= len(values) <= CHANNELS:
        return {}
    first = FIRST_CHANNEL if len(values) == CHANNELS else FIRST_CHANNEL_PRO
    return {first + n: -float(value) for n, value in enumerate(values) if 0 < value < 0xFF}
