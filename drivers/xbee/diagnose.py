"""Why a port does not talk API: distinguishes a module in transparent mode from a dead one."""

import time

from drivers.links import ByteLink

GUARD_S = 1.1
"""Silence the module wants around `+++` (GT, 1 s from the factory)."""
REPLY_S = 1.5


def why_silent(link: ByteLink, port: str, baud: int) -> str:
    """Ask in command mode, as a terminal would; what was found, with the remedy. Takes up to 4 s."""
    drain(link)
    time.sleep(GUARD_S)
    drain(link)
    link.write(b"+++")
    answer = read_until(link, b"OK\r", REPLY_S)
    if b"OK\r" not in answer and answer:
        return (
            f"what answers on {port} at {baud} baud makes no sense: is `baud` what the module uses "
            "(BD; 9600 from the factory), and is it an XBee?"
        )
    if b"OK\r" not in answer:
        return (
            f"nothing answers on {port} at {baud} baud. Is the radio powered and is this its port? "
            "Is `baud` what the module uses (BD; 9600 from the factory)?"
        )
    link.write(b"ATAP\r")
    api = read_until(link, b"\r", 1.0).strip(b"\r\nOK ")
    link.write(b"ATCN\r")
    if api == b"0":
        return (
            f"the XBee on {port} is in transparent mode (AP=0): it passes on data, not signal strength. "
            "Set AP=2 (API, escaped) with XCTU and write it (WR)"
        )
    mode = api.decode("ascii", "replace")
    return (
        f"the module on {port} answers in command mode (AP={mode}) but not in API mode; power it off and on"
    )


def drain(link: ByteLink) -> None:
    """Throw away what is waiting."""
    deadline = time.monotonic() + 0.3
    while link.read() and time.monotonic() < deadline:
        pass


def read_until(link: ByteLink, end: bytes, timeout_s: float) -> bytes:
    """What arrives up to `end`, or within `timeout_s`."""
    got = b""
    deadline = time.monotonic() + timeout_s
    while end not in got and time.monotonic() < deadline:
        got += link.read()
    return got
