"""Damaged byte streams against every codec: `fieldkit bench fuzz`, or by hand

    python -m drivers.fuzz --streams 1000000 --seed 1

Each stream is a few good frames, mutated, then a quiet moment, then one good frame. No exception may escape, the
codec may keep no more than `KEEPS` bytes, and the last frame must come out. A capture has no marker to find the next
packet by: there a damaged stream may also end with `CaptureError`, and the next capture must be read.
"""

import json
import math
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any

import typer

from drivers.emulators.capture import classic_head, classic_record, tap_packet
from drivers.emulators.gnss import Seen, gpsd_report, nmea
from drivers.emulators.printer import STYLES, PrintingRadio
from drivers.emulators.sniffers import NrfDongle, TiDongle, data_frame
from drivers.gnss.gpsd import GpsdReader
from drivers.gnss.nmea import NmeaReader
from drivers.lines.mapping import Heard, LineMap, NoReadingError
from drivers.lines.maps import MAPS
from drivers.lines.receiver import LineSplitter
from drivers.sniffers.capture import CaptureError, CaptureReader
from drivers.sniffers.ieee802154 import frame_id
from drivers.sniffers.nrf import NrfText
from drivers.sniffers.strength import from_status_bytes, from_tap
from drivers.sniffers.ti import TiBinary
from drivers.xbee.decode import db_answer, decode, name_of
from drivers.xbee.frames import Deframer, frame
from fieldkit.geo import FieldFrame

_FRAME = FieldFrame(47.3977, 8.5456)
_LAST_SEEN = Seen(1_790_000_000 * 10**9, 12.0, 34.0)
KEEPS = 1 << 21
STREAMS = 20_000
"""Bytes a codec may keep of a stream that makes no sense: a pcapng block may claim a megabyte."""
INTERESTING = (
    b"\x7e",
    b"\x7d",
    b"\x40\x53",
    b"\x40\x45",
    b"\r\n",
    b"received: ",
    b"\x00",
    b"\xff\xff\xff\xff",
)


@dataclass(frozen=True, slots=True)
class Codec:
    """One codec under test."""

    good: Callable[[random.Random], bytes]
    """A good frame."""
    survives: Callable[[bytes, bytes], bool]
    """Feed it a damaged stream, then, after a quiet moment, a good one; whether the good one came out."""


def _xbee_frame(rng: random.Random, *, escaped: bool) -> bytes:
    kind = rng.choice((0x80, 0x81, 0x82, 0x83, 0x88, 0x8A, 0x90, 0x91, 0x92))
    return frame(bytes([kind]) + rng.randbytes(rng.randint(0, 40)), escaped=escaped)


def _xbee(escaped: bool) -> Codec:
    last = bytes.fromhex("80 0013A20012345678 5E 01 5478446174 61")

    def survives(damaged: bytes, _: bytes) -> bool:
        codec = Deframer()
        got: list[bytes] = []
        for at in range(0, len(damaged), 97):
            got += [each for _, each in codec.feed(damaged[at : at + 97], 0, escaped=escaped)]
        got += [each for _, each in codec.idle(escaped=escaped)]
        after = [each for _, each in codec.feed(frame(last, escaped=escaped), 1, escaped=escaped)]
        after += [each for _, each in codec.idle(escaped=escaped)]
        for each in got + after:
            decode(each)
            name_of(each)
            db_answer(each)
        return frame(last) in after and len(codec._buffer) < KEEPS

    return Codec(lambda rng: _xbee_frame(rng, escaped=escaped), survives)


def _sniffer(make: Callable[[], Any], good: Callable[[random.Random], bytes]) -> Codec:
    def survives(damaged: bytes, last: bytes) -> bool:
        codec = make()
        for at in range(0, len(damaged), 97):
            for captured in codec.feed(damaged[at : at + 97]):
                assert -129.0 < captured.rss_dbm < 0.0
                frame_id(captured.psdu)
        list(codec.idle())
        after = list(codec.feed(last)) + list(codec.idle())
        held = getattr(codec, "_buffer", b"") or getattr(codec, "_rest", b"")
        return bool(after) and after[-1].psdu.endswith(b"the last") and len(held) < KEEPS

    return Codec(good, survives)


def _lines(name: str) -> Codec:
    """A damaged line is its own: the next one is read."""
    style, line_map = STYLES[name], MAPS[name]
    radio = PrintingRadio(lambda: 0, name)

    def good(rng: random.Random) -> bytes:
        sender = f"{rng.getrandbits(24):x}"
        return (style(radio, -float(rng.randint(20, 100)), sender, rng.getrandbits(16)) + "\r\n").encode()

    def survives(damaged: bytes, last: bytes) -> bool:
        split, after = LineSplitter(), None
        for at in range(0, len(damaged), 97):
            for line in split.feed(damaged[at : at + 97]):
                _is_sane(line_map, line)
        for line in split.feed(b"\n" + last):
            after = _is_sane(line_map, line)
        return after is not None and len(split._rest) < KEEPS

    return Codec(good, survives)


def _is_sane(line_map: LineMap, line: str) -> Heard | None:
    try:
        heard = line_map.read(line)
    except NoReadingError:
        return None
    assert heard is None or (
        math.isfinite(heard.rss_dbm) and (heard.source is None or heard.source.isprintable())
    )
    return heard


def _seen(rng: random.Random) -> Seen:
    place = rng.uniform(-500.0, 500.0), rng.uniform(-500.0, 500.0)
    return Seen(
        rng.randrange(1_600_000_000, 1_800_000_000) * 10**9, *place, 0.0, 1.2, rng.uniform(0.0, 360.0)
    )


def _fixes(make: Callable[[], NmeaReader | GpsdReader], last: Seen) -> Codec:
    """A satellite receiver: a damaged sentence is none, and the next good one is read."""
    lat, lon, _ = _FRAME.to_geodetic(last.east_m, last.north_m)

    def survives(damaged: bytes, good: bytes) -> bool:
        codec = make()
        for at in range(0, len(damaged), 97):
            for fix in codec.feed(damaged[at : at + 97], 0.0):
                assert fix.why_absent or (math.isfinite(fix.lat_deg) and math.isfinite(fix.lon_deg))
        after = codec.feed(b"\r\n" + good, 1.0)
        found = bool(after) and abs(after[-1].lat_deg - lat) < 1e-6 and abs(after[-1].lon_deg - lon) < 1e-6
        return found and len(codec._rest) < KEEPS

    writer = nmea if make is NmeaReader else gpsd_report
    return Codec(lambda rng: writer(_seen(rng), _FRAME), survives)


def _nrf_line(rng: random.Random, payload: bytes | None = None) -> bytes:
    dongle = NrfDongle(lambda: rng.getrandbits(33))
    dongle.capturing, dongle.listening_on = True, dongle.channel
    payload = rng.randbytes(rng.randint(0, 60)) if payload is None else payload
    return dongle.hear(-float(rng.randint(20, 100)), rng.getrandbits(64), payload) or b""


def _ti_packet(rng: random.Random, payload: bytes | None = None) -> bytes:
    dongle = TiDongle(lambda: rng.getrandbits(40), with_checksum=rng.random() < 0.5)
    dongle.capturing, dongle.listening_on = True, dongle.channel
    payload = rng.randbytes(rng.randint(0, 60)) if payload is None else payload
    return dongle.hear(-float(rng.randint(20, 100)), rng.getrandbits(64), payload) or b""


def _tap(rng: random.Random) -> bytes:
    psdu = data_frame(rng.getrandbits(16), rng.randbytes(rng.randint(0, 40)), 1, short_address=True)
    return tap_packet(-float(rng.randint(20, 100)), psdu)


def _ng_block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = (12 + len(body)).to_bytes(4, "little")
    return kind.to_bytes(4, "little") + size + body + size


_NG_HEAD = _ng_block(0x0A0D0D0A, bytes.fromhex("4d3c2b1a01000000ffffffffffffffff")) + _ng_block(
    1, (283).to_bytes(2, "little") + bytes(6)
)


def _ng_packet(data: bytes) -> bytes:
    return _ng_block(6, bytes(12) + 2 * len(data).to_bytes(4, "little") + data)


def _capture(head: bytes, record: Callable[[bytes], bytes]) -> Codec:
    def survives(damaged: bytes, last: bytes) -> bool:
        codec = CaptureReader()
        try:
            for at in range(0, len(damaged), 97):
                for packet in codec.feed(damaged[at : at + 97]):
                    from_status_bytes(packet.data)
                    if (strength := from_tap(packet.data)) is not None:
                        frame_id(strength.psdu)
        except CaptureError:
            pass
        again = [from_tap(packet.data) for packet in CaptureReader().feed(head + last)]
        return len(again) == 1 and again[0] is not None and len(codec._buffer) < KEEPS

    return Codec(lambda rng: record(_tap(rng)), survives)


@cache
def _mavlink_writer() -> Any:
    from drivers.mavlink.codec import mavlink

    return mavlink.MAVLink(None, 7, 1)


def _mavlink_frame(rng: random.Random) -> bytes:
    from drivers.mavlink.codec import mavlink

    numbers = (rng.getrandbits(30) for _ in range(5))
    message = mavlink.MAVLink_global_position_int_message(*numbers, 1, 2, 3, rng.getrandbits(16))
    return bytes(message.pack(_mavlink_writer()))


def _mavlink() -> Codec:
    """A false start may hold back what follows until its claimed length, 280 bytes at most, has come."""

    def survives(damaged: bytes, last: bytes) -> bool:
        from drivers.mavlink.codec import Parser

        codec = Parser()
        for at in range(0, len(damaged), 97):
            codec.parse(damaged[at : at + 97])
        after = [message for _ in range(1 + 300 // len(last)) for message in codec.parse(last)]
        return bool(after) and bytes(after[-1].get_msgbuf()) == last and len(codec._buffer) < KEEPS

    return Codec(_mavlink_frame, survives)


CODECS: dict[str, tuple[Codec, Callable[[random.Random], bytes], bytes]] = {
    "xbee": (_xbee(False), lambda rng: b"", b""),
    "xbee-escaped": (_xbee(True), lambda rng: b"", b""),
    "nrf": (_sniffer(NrfText, _nrf_line), lambda rng: _nrf_line(rng, b"the last"), b""),
    "ti": (_sniffer(TiBinary, _ti_packet), lambda rng: _ti_packet(rng, b"the last"), b""),
    "mavlink": (_mavlink(), _mavlink_frame, b""),
    "pcap": (
        _capture(classic_head(), lambda data: classic_record(5_000_000_000, data)),
        lambda rng: classic_record(6_000_000_000, _tap(rng)),
        classic_head(),
    ),
    **{f"lines-{name}": (_lines(name), _lines(name).good, b"") for name in STYLES},
    "nmea": (_fixes(NmeaReader, _LAST_SEEN), lambda rng: nmea(_LAST_SEEN, _FRAME), b""),
    "gpsd": (_fixes(GpsdReader, _LAST_SEEN), lambda rng: gpsd_report(_LAST_SEEN, _FRAME), b""),
    "pcapng": (_capture(_NG_HEAD, _ng_packet), lambda rng: _ng_packet(_tap(rng)), _NG_HEAD),
}
"""Codec, the good frame at the end, and what a stream begins with."""


def mutated(data: bytes, rng: random.Random) -> bytes:
    """One to six changes: flipped bits, bytes lost, put in, repeated, cut off, swapped."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        at, size = rng.randrange(len(out) + 1), rng.randint(1, 24)
        change = rng.randrange(7)
        if change == 0 and at < len(out):
            out[at] ^= 1 << rng.randrange(8)
        elif change == 1:
            del out[at : at + size]
        elif change == 2:
            out[at:at] = rng.randbytes(size)
        elif change == 3:
            out[at:at] = out[at : at + size]
        elif change == 4:
            out[at:at] = rng.choice(INTERESTING)
        elif change == 5 and rng.random() < 0.3:
            del out[at:]
        elif at < len(out):
            out[at] = rng.choice((0, 0x7E, 0x7F, 0x80, 0xFF))
    return bytes(out)


def fuzz_codec(name: str, streams: int, seed: int) -> dict[str, Any]:
    """Run one codec over `streams` damaged streams. Raises `AssertionError` naming the first that breaks it."""
    codec, last_good, head = CODECS[name]
    rng = random.Random(f"{name}/{seed}")
    good = [codec.good(rng) for _ in range(200)]
    lasts = [last_good(rng) for _ in range(20)]
    began_s = time.monotonic()
    for number in range(streams):
        damaged = mutated(head + b"".join(rng.choices(good, k=rng.randint(1, 4))), rng)
        try:
            fine = codec.survives(damaged, rng.choice(lasts))
        except Exception as error:
            raise AssertionError(f"{name}, stream {number}, {damaged.hex()}: {error!r}") from error
        if not fine:
            raise AssertionError(f"{name}, stream {number}, {damaged.hex()}: the next good frame was lost")
    return {"streams": streams, "seed": seed, "wall_s": round(time.monotonic() - began_s, 1), "failures": 0}


def fuzz(streams: int = STREAMS, seed: int = 1) -> dict[str, Any]:
    """Every codec over `streams` damaged streams."""
    return {name: fuzz_codec(name, streams, seed) for name in CODECS}


def main(
    streams: Annotated[int, typer.Option(min=1, help="Damaged streams for each codec.")] = STREAMS,
    seed: Annotated[int, typer.Option(help="Same seed, same damage.")] = 1,
    codec: Annotated[list[str] | None, typer.Option(help="Only these; repeat.")] = None,
) -> None:
    """Feed damaged streams to the codecs. Example: python -m drivers.fuzz --streams 1000000"""
    for name in codec or CODECS:
        typer.echo(json.dumps({name: fuzz_codec(name, streams, seed)}))


if __name__ == "__main__":
    typer.run(main)
