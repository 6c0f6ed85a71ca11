"""A Kismet as its REST interface shows it: devices heard again since a moment, to whoever has the API key.

Written against https://www.kismetwireless.net/docs/api/devices/ ("last-time" and field simplification).
"""

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Self

LAST_TIME = "kismet.device.base.last_time"


class EmulatedKismet:
    """Serves while used as a context manager. `refused` are requests without the key."""

    def __init__(self, key: str = "secret", clock_off_s: int = 0) -> None:
        self.refused = 0
        self._off_s = clock_off_s
        self._key = key
        self._devices: dict[str, dict[str, Any]] = {}
        emulated = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                allowed = self.headers.get("Cookie") == f"KISMET={emulated._key}"
                emulated.refused += not allowed
                since_s = int(self.path.split("/")[3])
                since_s += emulated._now_s() if since_s < 0 else 0  # so long before now
                answer = json.dumps(emulated._answer(asked, since_s)).encode()
                self.send_response(200 if allowed else 401)
                self.end_headers()
                self.wfile.write(answer if allowed else b"")

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="emulated kismet", daemon=True
        )

    @property
    def port(self) -> str:
        """For a receiver `lines`."""
        return f"kismet://127.0.0.1:{self._server.server_port}?key={self._key}"

    def hear(self, mac: str, rss_dbm: float, channel: str = "6") -> None:
        """One packet more of a device."""
        known = self._devices.get(mac, {}).get("kismet.device.base.packets.total", 0)
        self._devices[mac] = {
            "kismet.device.base.macaddr": mac,
            "kismet.device.base.channel": channel,
            LAST_TIME: self._now_s(),
            "kismet.device.base.packets.total": known + 1,
            "kismet.device.base.signal/kismet.common.signal.last_signal": round(rss_dbm),
        }

    def _now_s(self) -> int:
        """By its own clock."""
        return int(time.time()) + self._off_s

    def _answer(self, asked: dict[str, Any], since_s: int) -> list[dict[str, Any]]:
        """Devices heard since then: the fields asked for, each under the name asked for."""
        return [
            {name: device.get(path, 0) for path, name in asked["fields"]}
            for device in list(self._devices.values())
            if device[LAST_TIME] >= since_s
        ]

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
