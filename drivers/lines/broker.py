"""Lines from an MQTT broker: each message's payload is one line, or several."""

import queue
import time
from typing import Any

from drivers.links import READ_TIMEOUT_S, host_and_port
from fieldkit.errors import DeviceError

MQTT_PORT = 1883
CONNECT_S = 5.0
MOST_WAITING = 50_000


class MqttLink:
    """`HOST[:PORT]/TOPIC`; the topic may have + and # in it."""

    def __init__(self, rest: str, device: str) -> None:
        """Raises `DeviceError` with the remedy."""
        try:
            from paho.mqtt import client as mqtt
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError:
            raise DeviceError(
                f"{device}: mqtt:// needs paho-mqtt: pip install 'spog-fieldkit[mqtt]'"
            ) from None
        where, _, topic = rest.partition("/")
        if not topic:
            raise ValueError("expected mqtt://HOST[:PORT]/TOPIC, got no topic")
        host, port = host_and_port(where) if ":" in where else (where, MQTT_PORT)
        self.arrived_s = time.monotonic()
        self._lines: queue.Queue[tuple[float, bytes]] = queue.Queue(MOST_WAITING)
        self._gone = ""
        self._ready = False
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe(topic)
        self._client.on_subscribe = self._subscribed
        self._client.on_message = self._message
        self._client.on_disconnect = self._disconnected
        self._client.connect(host, port, keepalive=5)
        self._client.loop_start()
        deadline_s = time.monotonic() + CONNECT_S
        while not self._ready and not self._gone and time.monotonic() < deadline_s:
            time.sleep(0.02)
        if not self._ready:
            self.close()
            raise DeviceError(
                f"{device}: {host}:{port} does not let us subscribe to {topic!r} ({self._gone or 'no answer'})"
            )

    def _subscribed(self, client: Any, userdata: Any, number: int, codes: Any, *_: Any) -> None:
        refused = [str(code) for code in codes if code.is_failure]
        self._gone = self._gone or ", ".join(refused)
        self._ready = not refused

    def _message(self, client: Any, userdata: Any, message: Any) -> None:
        if message.retain:  # kept by the broker from before we came: nobody knows when it was heard
            return
        line = bytes(message.payload)
        if self._lines.full():
            self._gone = "messages come faster than they are taken"
            return
        self._lines.put((time.monotonic(), line if line.endswith(b"\n") else line + b"\n"))

    def _disconnected(self, *arguments: Any) -> None:
        self._gone = self._gone or "the broker closed the connection"

    def read(self) -> bytes:
        """Raises `OSError` when the broker is gone."""
        if self._gone:
            raise ConnectionResetError(self._gone)
        try:
            self.arrived_s, line = self._lines.get(timeout=READ_TIMEOUT_S)
        except queue.Empty:
            return b""
        return line

    def write(self, data: bytes) -> None:
        """Nothing is ever sent."""
        raise OSError("a broker is only listened to")

    def close(self) -> None:
        """Twice is harmless."""
        self._client.disconnect()
        self._client.loop_stop()
