"""How quick a live mission is: 16 robots on emulated wires in real time, the page open.

The time from a packet on a radio's wire to the belief updated by it, at two rates, and from HOLD ALL on the page to
the first of 16 vehicles getting the order and to the last one showing that it holds. Receptions are joined within
10 ms here, as with synchronised clocks; with the default `association` the belief waits a second for late ones, on any
machine.
"""

import asyncio
import json
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.clock import wall_s
from fieldkit.files import write_whole
from fieldkit.messages import Detection
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import Mission, read_mission
from mission.core.template import TemplateRobot, mission_text
from mission.page import serve
from mission.shell import setups
from mission.shell.runner import Runner
from mission.shell.warm_up import warm_up

ROBOTS = 16
SOURCES = 5
FIELD_M = 20.0
RATES_HZ = (1.0, 10.0)
"""Packets a second, each heard by every robot."""
WINDOW_S, LATENESS_S = 0.01, 0.01
SETTLE_S = 15.0
"""Left out: the first plans for all robots at once."""
DURATION_S = 30.0
HOLD_LIMIT_S = 30.0
FAR_REACHING = Antenna(2.0, -40.0, 3.0, -95.0)
"""So far that every robot hears every packet."""


def live() -> dict[str, Any]:
    """Latencies in milliseconds, by rate. Takes two minutes."""
    return {f"{rate_hz:g} readings a second and robot": _at(rate_hz) for rate_hz in RATES_HZ}


def _at(rate_hz: float) -> dict[str, Any]:
    with tempfile.TemporaryDirectory(prefix="fieldkit-") as folder:
        mission = _mission(Path(folder), rate_hz)
        warm_up(mission)
        gap_m = FIELD_M / SOURCES
        sources = tuple(
            TransientSource(gap_m * (k + 0.5), FIELD_M / 2, 0.0, rate_hz / SOURCES) for k in range(SOURCES)
        )
        with (
            setups.emulated(mission, sources, seed=1, rate=1.0) as setup,
            RecordingWriter(Path(folder) / "mission.mcap", mission_toml=mission.text) as recorder,
            serve.live(mission) as shown,
        ):
            runner = Runner(mission, setup, recorder, followers=(shown.follower,))
            return asyncio.run(_measure(runner, shown))


def _mission(folder: Path, rate_hz: float) -> Mission:
    write_whole(folder / "antenna.toml", dump_antenna(AntennaFile(FAR_REACHING)))
    text = mission_text(
        name="live",
        size_m=FIELD_M,
        cell_m=0.5,
        power_levels_db=(0.0,),
        rate_hz=rate_hz / SOURCES,
        expected=float(SOURCES),
        window_s=WINDOW_S,
        max_duration_s=3600.0,
        sources_found=99,
        fence_margin_m=0.2,
        min_separation_m=0.5,
        robots=[TemplateRobot(f"r{k}", f"port{k}", "udpin:127.0.0.1:0", k) for k in range(1, ROBOTS + 1)],
    )
    text = text.replace("[association]\n", f"[association]\nlateness_s = {LATENESS_S}\n")
    write_whole(folder / "mission.toml", text)
    return read_mission(folder / "mission.toml")


async def _measure(runner: Runner, shown: serve.LivePage) -> dict[str, Any]:
    clock, kernel = runner.setup.clock, runner.kernel
    late_ms: list[float] = []
    heard: list[int] = []
    detect_all = kernel.belief.detect_all

    def timed(detections: Sequence[Detection]) -> None:
        detect_all(detections)
        for detection in detections:
            late_ms.append((clock.now_ns() - detection.t_ns) * 1e-6)
            heard.append(int(detection.heard.sum()))

    kernel.belief.detect_all = timed  # type: ignore[method-assign]
    shown.attach(runner)
    running = asyncio.create_task(runner.run())
    while kernel.started_ns is None and not running.done():  # noqa: ASYNC110 the mission has no such event
        await asyncio.sleep(0.1)
    viewer = _Viewer(shown.page.address, shown.page.token)
    await clock.sleep(SETTLE_S)
    before, began_s, frames = len(late_ms), clock.elapsed_s(), viewer.frames
    await clock.sleep(DURATION_S)
    passed_s = clock.elapsed_s() - began_s
    measured, count = late_ms[before:], sum(heard[before:])
    frames = viewer.frames - frames
    hold = await _hold_all(runner, viewer)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
    viewer.close()
    if not measured:
        raise RuntimeError("no transmission was heard: nothing was measured")
    return {
        "robots": ROBOTS,
        "readings_believed_per_robot_hz": round(count / passed_s / ROBOTS, 2),
        "wire_to_belief_p50_ms": round(float(np.percentile(measured, 50)), 1),
        "wire_to_belief_p99_ms": round(float(np.percentile(measured, 99)), 1),
        "of_which_waiting_for_others_ms": round((WINDOW_S + LATENESS_S) * 1e3, 1),
        "frames_to_the_page_hz": round(frames / passed_s, 2),
        **hold,
    }


async def _hold_all(runner: Runner, viewer: "_Viewer") -> dict[str, Any]:
    """From the command on the page's socket to the first vehicle getting the order, and to the last one showing it."""
    ordered_s: list[float] = []
    shown_s: dict[str, float] = {}

    def watch(link: Any) -> None:
        hold = link.hold

        async def watched(robot: str) -> None:
            ordered_s.append(wall_s())
            await hold(robot)
            shown_s[robot] = wall_s()

        link.hold = watched

    for link in runner.setup.links:
        watch(link)
    asked_s = wall_s()
    viewer.hold_all()
    while len(shown_s) < ROBOTS and wall_s() - asked_s < HOLD_LIMIT_S:  # noqa: ASYNC110 as above
        await asyncio.sleep(0.002)
    return {
        "hold_all_first_ms": round((min(ordered_s) - asked_s) * 1e3, 1),
        "hold_all_last_of_16_ms": round((max(shown_s.values()) - asked_s) * 1e3, 1),
        "hold_all_held": len(shown_s),
    }


class _Viewer:
    """A browser's socket, with the right to command; takes everything it gets."""

    def __init__(self, address: str, token: str) -> None:
        from websockets.sync.client import connect

        self.frames = 0
        self._socket = connect(address.replace("http", "ws") + "live")
        self._socket.send(json.dumps({"kind": "token", "token": token}))
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for text in self._socket:
            self.frames += text.startswith('{"kind": "frame"')  # type: ignore[arg-type]

    def hold_all(self) -> None:
        self._socket.send(json.dumps({"kind": "command", "number": 1, "action": "hold", "robot": None}))

    def close(self) -> None:
        self._socket.close()
