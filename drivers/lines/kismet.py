"""Kismet's devices as JSON lines: from its running server (REST), or from the database it writes.

Written from Kismet's documents (kismetwireless.net/docs/api/devices, /docs/dev/kismetdb): `POST
/devices/last-time/TIME/devices.json` with a list of fields gives the devices seen since, or within so many last seconds
where TIME is negative; table `packets` of a kismetdb
has ts_sec, ts_usec, sourcemac, frequency in kHz and signal in dBm.
"""

import http.client
import json
import sqlite3
import time
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from fieldkit.errors import DeviceError

POLL_S = 0.5
TIMEOUT_S = 3.0
LOOK_BACK_S = 10
"""Devices of so many last seconds are asked for, by Kismet's own clock: it may be years off ours."""
LAST_SIGNAL = "kismet.device.base.signal/kismet.common.signal.last_signal"
FIELDS = [
    ["kismet.device.base.macaddr", "mac"],
    ["kismet.device.base.channel", "channel"],
    ["kismet.device.base.last_time", "time"],
    ["kismet.device.base.packets.total", "packets"],
    [LAST_SIGNAL, "signal"],
]


class _Polled:
    """Asks now and then; a moment passes between two questions."""

    def __init__(self) -> None:
        self.arrived_s = self._asked_s = time.monotonic()

    def _wait(self) -> None:
        time.sleep(max(0.0, min(POLL_S, self._asked_s + POLL_S - time.monotonic())))
        self._asked_s = self.arrived_s = time.monotonic()

    def write(self, data: bytes) -> None:
        """Nothing is ever sent."""
        raise OSError("Kismet is only listened to")


class KismetLink(_Polled):
    """`kismet://HOST:PORT[?key=API_KEY]`, or kismets:// over TLS. A device with new packets is a line."""

    def __init__(self, url: str, device: str) -> None:
        super().__init__()
        parts = urlsplit(url)
        scheme = "https" if parts.scheme == "kismets" else "http"
        key = parse_qs(parts.query).get("key", [""])[0]
        self._base = f"{scheme}://{parts.netloc}"
        self._headers = {"Content-Type": "application/json"} | ({"Cookie": f"KISMET={key}"} if key else {})
        self._packets: dict[str, int] = {}
        try:
            self._ask()
        except urllib.error.HTTPError as error:
            remedy = (
                "give an API key: kismet://HOST:2501?key=..." if error.code in (401, 403) else "is it Kismet?"
            )
            raise DeviceError(f"{device}: {self._base} answers {error.code}; {remedy}") from error

    def read(self) -> bytes:
        """Raises `OSError` when the server is gone."""
        self._wait()
        return b"".join(self._ask())

    def _ask(self) -> list[bytes]:
        lines = []
        for each in self._devices():
            mac, packets = str(each.get("mac", "")), int(each.get("packets") or 0)
            # The list has whoever was seen lately; only one with new packets was heard since we asked.
            if packets != self._packets.get(mac, 0) and each.get("signal"):
                lines.append(_line(each["signal"], mac, each.get("channel"), each.get("time")))
            self._packets[mac] = packets
        return lines

    def _devices(self) -> list[dict[str, Any]]:
        """Raises `OSError` for whatever is no list of devices: nothing is known of who was heard."""
        request = urllib.request.Request(
            f"{self._base}/devices/last-time/-{LOOK_BACK_S}/devices.json",
            json.dumps({"fields": FIELDS}).encode(),
            self._headers,
        )
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
                devices = json.loads(answer.read())
        except (http.client.HTTPException, RecursionError, ValueError) as error:
            raise OSError(f"{self._base} answers with something that is not JSON: is it Kismet?") from error
        if not isinstance(devices, list) or not all(_is_device(each) for each in devices):
            raise OSError(f"{self._base} answers with something that is no list of devices: is it Kismet?")
        return devices

    def close(self) -> None:
        """Nothing is kept open."""


class KismetDbLink(_Polled):
    """The database that a running Kismet writes: every packet is a line."""

    def __init__(self, path: Path, from_start: bool) -> None:
        """Raises `OSError` where it is none."""
        super().__init__()
        if not path.is_file():
            raise FileNotFoundError("no such file")
        self._database = sqlite3.connect(
            f"{path.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False
        )
        try:
            (last,) = self._database.execute("select coalesce(max(rowid), 0) from packets").fetchone()
        except sqlite3.Error as error:
            self._database.close()
            raise OSError(f"not a kismetdb ({error})") from error
        self._row = 0 if from_start else int(last)

    def read(self) -> bytes:
        """Raises `OSError` when it cannot be read any more."""
        self._wait()
        try:
            rows = self._database.execute(
                "select rowid, ts_sec, ts_usec, sourcemac, frequency, signal from packets where rowid > ? "
                "order by rowid limit 4000",
                (self._row,),
            ).fetchall()
        except sqlite3.Error as error:
            raise OSError(str(error)) from error
        if rows:
            self._row = rows[-1][0]
        return b"".join(
            _line(signal, mac, _channel(frequency), seconds + 1e-6 * microseconds)
            for _, seconds, microseconds, mac, frequency, signal in rows
            if signal
        )

    def close(self) -> None:
        """Twice is harmless."""
        self._database.close()


def _is_device(each: object) -> bool:
    return isinstance(each, dict) and isinstance(each.get("packets") or 0, int)


def _line(signal: object, mac: object, channel: object, at_s: object) -> bytes:
    row = {"rss_dbm": signal, "source_id": mac, "channel": channel, "time": at_s}
    return json.dumps(row).encode() + b"\n"


def _channel(frequency_khz: float | None) -> int | None:
    """Of 2.4 GHz WiFi; None elsewhere."""
    mhz = (frequency_khz or 0.0) / 1e3
    return round((mhz - 2407.0) / 5.0) if 2410.0 < mhz < 2480.0 else None
