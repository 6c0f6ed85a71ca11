"""Two robots without a common computer: real processes, real Zenoh on loopback, emulated radios and vehicles."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest

from drivers.emulators.field import EmulatedRobot, FieldSpec, start
from drivers.emulators.rover import HOLD
from drivers.emulators.running import RunningField
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.clock import ScaledClock
from fieldkit.geo import FieldFrame
from fieldkit.recording.reader import open_recording
from fieldkit.world.sources import TransientSource
from mission.core.template import TemplateRobot, mission_text
from mission.lab.synthetic import ANTENNA
from mission.replay.replay import replay
from mission.shell.setups import free_udp_port

pytest.importorskip("zenoh")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

ORIGIN = (47.3977, 8.5456)
NAMES = ("r1", "r2")
PATIENCE_S = 120.0


def free_tcp_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module")
def fields() -> Iterator[dict[str, tuple[RunningField, str]]]:
    """Each robot's own emulated wires, and where its vehicle sends to."""
    running: dict[str, tuple[RunningField, str]] = {}
    with contextlib.ExitStack() as stack:
        for number, name in enumerate(NAMES):
            address = f"127.0.0.1:{free_udp_port()}"
            robot = EmulatedRobot(name, number + 1, 3.0 + 4.0 * number, 1.0)
            sources = (TransientSource(5.0, 3.0, 0.0, 1.0),)
            spec = FieldSpec(
                ScaledClock(1.0), FieldFrame(*ORIGIN), ANTENNA, sources, (robot,), address, seed=number
            )
            running[name] = (stack.enter_context(start(spec)), address)
        yield running


class Agent:
    """`fieldkit agent` in a process of its own."""

    def __init__(self, folder: Path, name: str, port: int, listens: bool, who: tuple[str, ...] = ()) -> None:
        self.folder, self.name = folder / name, name
        self.folder.mkdir(exist_ok=True)
        wire = [f"--{'listen' if listens else 'connect'}", f"tcp/127.0.0.1:{port}"]
        self._path = self.folder / f"said{len(list(self.folder.glob('said*')))}"
        self._said: IO[bytes] = self._path.open("wb")
        arguments = [
            sys.executable, "-m", "fieldkit", "agent", str(folder / "mission.toml"),
            *(who or ("--robot", name, "--contact-m", "5")), *wire, "--no-scouting",
            "--out", str(self.folder / "runs"), "--json",
        ]  # fmt: skip
        env = {**os.environ, "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=self._said, env=env)

    def said(self) -> str:
        return self._path.read_text(errors="replace")

    def until(self, text: str) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while text not in self.said():
            assert self.process.poll() is None, f"{self.name} ended before {text!r}: {self.said()}"
            assert time.monotonic() < deadline_s, f"{self.name}: no {text!r} in {self.said()}"
            time.sleep(0.1)

    def end(self) -> dict[str, object]:
        self.process.send_signal(signal.SIGINT)
        out, _ = self.process.communicate(timeout=PATIENCE_S)
        self._said.close()
        assert self.process.returncode == 0, self.said()
        told: dict[str, object] = json.loads(out)
        return told

    @property
    def log(self) -> Path:
        return max((self.folder / "runs").iterdir())


def wait_until(true: object, words: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not true():  # type: ignore[operator]
        assert time.monotonic() < deadline_s, words
        time.sleep(0.1)


def prepare(folder: Path, fields: dict[str, tuple[RunningField, str]]) -> None:
    robots = [
        TemplateRobot(name, fields[name][0].receiver_ports[name], f"udpin:{fields[name][1]}", number + 1)
        for number, name in enumerate(NAMES)
    ]
    text = mission_text(
        name="agents", origin_deg=ORIGIN, size_m=10.0, cell_m=0.5, rate_hz=0.5, max_duration_s=600.0, robots=robots,
        fence_margin_m=0.2, min_separation_m=0.5, overrun_s=30.0, sources_found=9,
    )  # fmt: skip
    (folder / "mission.toml").write_text(text)
    (folder / "antenna.toml").write_text(dump_antenna(AntennaFile(ANTENNA)))
    done = subprocess.run(
        [sys.executable, "-m", "fieldkit", "agent", str(folder / "mission.toml"), "--new-key"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "mission.key" in done.stdout and (folder / "mission.key").stat().st_mode & 0o077 == 0


def mode(fields: dict[str, tuple[RunningField, str]], name: str) -> int:
    return int(fields[name][0].counts()["robots"][name]["mode"])


def moved_m(fields: dict[str, tuple[RunningField, str]], name: str, start_m: tuple[float, float]) -> float:
    east_m, north_m, _ = fields[name][0].truth()[name]
    return abs(east_m - start_m[0]) + abs(north_m - start_m[1])


def test_two_agents_search_hold_together_and_one_that_is_killed_comes_back(
    tmp_path: Path, fields: dict[str, tuple[RunningField, str]]
) -> None:
    prepare(tmp_path, fields)
    port = free_tcp_port()
    r1, r2 = Agent(tmp_path, "r1", port, True), Agent(tmp_path, "r2", port, False)
    try:
        r1.until("r2 is in contact")
        for number, name in enumerate(NAMES):
            start_m = (3.0 + 4.0 * number, 1.0)
            wait_until(
                lambda name=name, at=start_m: moved_m(fields, name, at) > 0.3, f"{name} does not drive"
            )  # type: ignore[misc]
        r1.process.send_signal(signal.SIGTSTP)  # Ctrl-Z holds all, and suspends nothing
        for name in NAMES:
            wait_until(lambda name=name: mode(fields, name) == HOLD, f"{name} does not hold")  # type: ignore[misc]
        held = r2.log
        time.sleep(1.5)  # what is written down is on its way to the disk
        r2.process.kill()  # as a battery that fails: nothing is said, nothing closed
        r2.process.wait()
        r2 = Agent(tmp_path, "r2", port, False)
        r2.until("goes on with what r2 knew")
        r2.until("r1 is in contact")
        start_m = fields["r2"][0].truth()["r2"][:2]
        time.sleep(2.0)
        assert moved_m(fields, "r2", start_m) < 0.2, "the hold stands"
        wire = ["--connect", f"tcp/127.0.0.1:{port}", "--no-scouting", "--json"]
        laptop = subprocess.run(
            [sys.executable, "-m", "fieldkit", "agent", str(tmp_path / "mission.toml"), "--hold", *wire],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert json.loads(laptop.stdout) == dict.fromkeys(NAMES, "holds"), laptop.stderr
        second, first = r2.end(), r1.end()
    finally:
        for agent in (r1, r2):
            if agent.process.poll() is None:
                agent.process.kill()
    assert "stopped by Ctrl-C" in str(first["end_reason"]) and not first["dropped"]["strangers"]  # type: ignore[index]
    for agent in (r1, r2):
        own, common = open_recording(agent.log / "mission.mcap"), agent.log / "common.mcap"
        assert own.complete and own.metadata["agent"] == agent.name
        assert replay(common).complete
    assert "from others: hold all: Ctrl-Z" in {
        note.text for _, note in open_recording(held / "mission.mcap").notes()
    }
    assert len(list((tmp_path / "r2" / "runs").iterdir())) == 2
    assert first["bytes_heard"] and second["bytes_heard"]
