"""A satellite receiver as its wire shows it: NMEA 0183 sentences, or gpsd's reports on TCP."""

import asyncio
import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime

from fieldkit.geo import FieldFrame

WORTH_M = 2.5
"""Standard deviation of a coordinate at HDOP 1."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What a receiver reports at one moment."""

    t_ns: int
    east_m: float
    north_m: float
    up_m: float = 0.0
    speed_m_s: float = 0.0
    course_deg: float = 0.0
    hdop: float = 1.0
    quality: int = 1


def sentence(body: str) -> bytes:
    """With its checksum: the exclusive or of all characters between $ and *."""
    check = 0
    for letter in body.encode("ascii"):
        check ^= letter
    return f"${body}*{check:02X}\r\n".encode("ascii")


def _angle(value_deg: float, digits: int, letters: str) -> str:
    whole = math.floor(abs(value_deg))
    minutes = (abs(value_deg) - whole) * 60.0
    return f"{whole:0{digits}d}{minutes:010.7f},{letters[value_deg < 0]}"


def nmea(seen: Seen, frame: FieldFrame) -> bytes:
    """RMC and GGA of one second."""
    lat, lon, alt = frame.to_geodetic(seen.east_m, seen.north_m, seen.up_m)
    moment = datetime.fromtimestamp(seen.t_ns * 1e-9, UTC)
    clock = f"{moment:%H%M%S}.{moment.microsecond // 10_000:02d}"
    place = f"{_angle(lat, 2, 'NS')},{_angle(lon, 3, 'EW')}"
    valid = "A" if seen.quality else "V"
    knots = seen.speed_m_s * 3600.0 / 1852.0
    rmc = f"GNRMC,{clock},{valid},{place},{knots:.3f},{seen.course_deg:.2f},{moment:%d%m%y},,,A"
    gga = f"GNGGA,{clock},{place},{seen.quality},08,{seen.hdop:.2f},{alt:.2f},M,47.0,M,,"
    return sentence(rmc) + sentence(gga)


def gpsd_report(seen: Seen, frame: FieldFrame, device: str = "/dev/ttyACM0") -> bytes:
    """One TPV."""
    lat, lon, alt = frame.to_geodetic(seen.east_m, seen.north_m, seen.up_m)
    error_m = 1.96 * WORTH_M * seen.hdop
    moment = datetime.fromtimestamp(seen.t_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
    report = {
        "class": "TPV",
        "device": device,
        "mode": 3 if seen.quality else 1,
        "time": moment.replace("+00:00", "Z"),
        "lat": lat,
        "lon": lon,
        "altMSL": alt,
        "epx": error_m,
        "epy": error_m,
        "track": seen.course_deg,
        "speed": seen.speed_m_s,
    }
    return json.dumps(report).encode() + b"\n"


class EmulatedGpsd:
    """A server that greets, waits to be told to WATCH, and then reports what `tell` gives it."""

    def __init__(self, frame: FieldFrame) -> None:
        self._frame = frame
        self._watching: list[asyncio.StreamWriter] = []
        self._clients: set[asyncio.StreamWriter] = set()
        self.port = 0

    async def open(self) -> None:
        """On a port of its own; the same one when it is opened again."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._clients.add(writer)
        writer.write(b'{"class":"VERSION","release":"3.25","proto_major":3,"proto_minor":15}\n')
        try:
            while line := await reader.readline():
                if line.startswith(b"?WATCH="):
                    writer.write(
                        b'{"class":"DEVICES","devices":[{"class":"DEVICE","path":"/dev/ttyACM0"}]}\n'
                    )
                    self._watching.append(writer)
        except ConnectionError:
            pass
        finally:
            self._clients.discard(writer)
            writer.close()  # a client that left has only closed its own half

    def tell(self, seen: Seen) -> None:
        """To everybody who watches."""
        for writer in self._watching:
            writer.write(gpsd_report(seen, self._frame))

    async def die(self) -> None:
        """Connections break; nobody answers any more."""
        self._server.close()
        for writer in [*self._clients]:
            writer.transport.abort()
        self._watching.clear()
        await asyncio.sleep(0)
