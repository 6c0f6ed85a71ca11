"""`fieldkit walk` on emulated wires: gpsd tells where, a printing radio, an MQTT broker or Kismet what is heard.

gpsd dies once while the walk goes on; what comes before, after and meanwhile from the radio is all recorded.
"""

import asyncio
import json
import signal
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from drivers.emulators.gnss import EmulatedGpsd, Seen
from drivers.emulators.kismet import EmulatedKismet
from drivers.emulators.printer import PrintingRadio
from drivers.emulators.wires import PluggedModule, PtyWire
from fieldkit.channel.antenna_file import dump_antenna
from fieldkit.clock import RealClock
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, RssReading
from fieldkit.recording import open_recording
from mission.lab.walk_demo import ORIGIN_DEG, believed

FRAME = FieldFrame(*ORIGIN_DEG)
SENDS = 20
MAC = "5c:31:3e:a1:b2:c3"

pytestmark = pytest.mark.timeout(240)


@dataclass
class Radio:
    """What `--receiver` opens, and how it is made to hear something."""

    receiver: str
    hear: Callable[[float], Any]


@asynccontextmanager
async def esp32(folder: Path, port: int) -> AsyncIterator[Radio]:
    """A pseudo-terminal that prints as an ESP32 does, boot words first."""
    module = PluggedModule(PrintingRadio(lambda: 0, "esp32-ble"), PtyWire(folder / "esp32"))
    await module.plug()
    module.wire.write(b"ets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET)\r\n")
    yield Radio(f"{module.wire.port},esp32-ble", lambda rss_dbm: module.hear(rss_dbm, 0xBEEF, b""))
    module.unplug()


@asynccontextmanager
async def mqtt(folder: Path, port: int) -> AsyncIterator[Radio]:
    """A broker, and a node that publishes what it hears."""
    from amqtt.broker import Broker  # type: ignore[import-untyped]
    from paho.mqtt import publish

    broker = Broker(
        {
            "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}},
            "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
        }
    )
    await broker.start()

    async def hear(rss_dbm: float) -> None:
        line = json.dumps({"rss_dbm": rss_dbm, "source_id": "node"})
        send = partial(publish.single, "field/node/rx", line, hostname="127.0.0.1", port=port)
        await asyncio.get_running_loop().run_in_executor(None, send)

    yield Radio(f"mqtt://127.0.0.1:{port}/field/+/rx,json", hear)
    await broker.shutdown()


@asynccontextmanager
async def kismet(folder: Path, port: int) -> AsyncIterator[Radio]:
    """Kismet's REST interface."""
    with EmulatedKismet() as server:
        yield Radio(f"{server.port},kismet", lambda rss_dbm: server.hear(MAC, rss_dbm))


@pytest.mark.parametrize("radio", [esp32, mqtt, kismet])
async def test_a_walk_records_what_comes_over_its_wires_though_gpsd_dies_once(
    radio: Any, unused_tcp_port: int, tmp_path: Path
) -> None:
    (tmp_path / "antenna.toml").write_text(dump_antenna(believed()), encoding="utf-8")
    gpsd, clock, walking = EmulatedGpsd(FRAME), RealClock(), True

    async def walk_about() -> None:
        step = 0
        while walking:
            step += 1
            gpsd.tell(Seen(clock.now_ns(), 100.0 + 0.2 * step, 100.0, 430.0, 1.0, 90.0))
            await asyncio.sleep(0.2)

    await gpsd.open()
    about = asyncio.create_task(walk_about())
    async with radio(tmp_path, unused_tcp_port) as wire:
        command = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "fieldkit", "walk", "--receiver", wire.receiver, "--no-page", "--json",
            "--gnss", f"gpsd://127.0.0.1:{gpsd.port}", "--antenna", str(tmp_path / "antenna.toml"),
            "--out", str(tmp_path / "runs"),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            assert command.stderr is not None
            said = await asyncio.wait_for(command.stderr.readuntil(b"waiting for walker"), 120.0)
            await asyncio.sleep(4.0)
            for number in range(SENDS):
                heard = wire.hear(-70.0 - number)
                if heard is not None and asyncio.iscoroutine(heard):
                    await heard
                if number == SENDS // 2:
                    await gpsd.die()
                    await asyncio.sleep(1.5)
                    await gpsd.open()
                await asyncio.sleep(0.6)  # Kismet is asked twice a second
        finally:
            command.send_signal(signal.SIGINT)
            told, more = await asyncio.wait_for(command.communicate(), 60.0)
    walking = False
    await about
    await gpsd.die()
    words = (said + more).decode()
    assert "Traceback" not in words, words[-3000:]
    assert "no position: the receiver went away" in words
    recording = open_recording(Path(json.loads(told)["recording"]))
    events = [event for _, _, event in recording.events()]
    levels = [event.rss_dbm for event in events if isinstance(event, RssReading)]
    assert levels == [-70.0 - number for number in range(SENDS)]
    poses = [event for event in events if isinstance(event, Pose)]
    gaps_s = [(b.t_ns - a.t_ns) * 1e-9 for a, b in pairwise(poses)]
    assert len(poses) > 30 and max(gaps_s) > 1.0, "it was away"
    assert all(0.0 < pose.east_m < 300.0 and 0.0 < pose.north_m < 300.0 for pose in poses)
    assert {pose.up_m for pose in poses} == {0.0}, "430 m above the sea is on the ground here"
