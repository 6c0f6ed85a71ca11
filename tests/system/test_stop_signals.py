"""Signals to a mission in a process of its own: every one stops, none stops the stop."""

import contextlib
import os
import pty
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fieldkit.recording.reader import open_recording

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

MISSION = """
import asyncio, sys
from pathlib import Path
from fieldkit.clock import RealClock
from fieldkit.errors import DeviceTimeout
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from fieldkit.world.bodies import Rover
from mission.lab.synthetic import small_mission
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places

folder, confirms = Path(sys.argv[1]), sys.argv[2] == "confirms"
said = open(folder / "said", "w", buffering=1)

class Fleet(FakeFleet):
    async def goto(self, robot, waypoint):
        await super().goto(robot, waypoint)
        print("goto", file=said)

    async def hold(self, robot):
        print("hold", robot, file=said)
        if not confirms:
            await asyncio.sleep(0.1)
            raise DeviceTimeout(f"{robot}: did not show mode hold")
        await super().hold(robot)

mission = small_mission(folder, duration_s=600.0)
clock = RealClock()
fleet = Fleet({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
setup = Setup(clock, tuple(FakeReceiver(name, clock) for name in mission.kernel.engine.robots), (fleet,))
with RecordingWriter(folder / "mission.mcap", mission_toml=mission.text, antenna_toml=mission.antenna_text) as log:
    runner = Runner(mission, setup, log, lambda progress: print("tick", flush=True))
    reason = asyncio.run(runner.run())
print("ended", reason, "unconfirmed", *runner.unconfirmed, file=said)
"""


class Flight:
    """A mission in a process with a terminal of its own."""

    def __init__(self, folder: Path, *, confirms: bool) -> None:
        self.folder = folder
        self._terminal, far = pty.openpty()
        arguments = [sys.executable, "-c", MISSION, str(folder), "confirms" if confirms else "stubborn"]
        self.process = subprocess.Popen(
            arguments, stdin=far, stdout=far, stderr=far, start_new_session=True, close_fds=True
        )
        os.close(far)
        self.until("goto")

    def said(self) -> str:
        path = self.folder / "said"
        return path.read_text() if path.exists() else ""

    def until(self, text: str) -> None:
        deadline_s = time.monotonic() + 90.0
        while text not in self.said():
            assert self.process.poll() is None, f"it ended before {text!r}: {self.said()}"
            assert time.monotonic() < deadline_s, f"no {text!r} in {self.said()}"
            os.set_blocking(self._terminal, False)
            with contextlib.suppress(OSError):
                os.read(self._terminal, 65_536)  # a full terminal would stop the mission's own words
            time.sleep(0.02)

    def hang_up(self) -> None:
        """Close the terminal's window: what is left of it says nothing any more."""
        os.close(self._terminal)
        self.process.send_signal(signal.SIGHUP)


@pytest.mark.parametrize(
    ("number", "why"), [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "another program (SIGTERM)")]
)
def test_a_signal_holds_everybody_and_closes_the_recording(tmp_path: Path, number: int, why: str) -> None:
    flight = Flight(tmp_path, confirms=True)
    flight.process.send_signal(number)
    assert flight.process.wait(60.0) == 0
    assert f"ended stopped by {why} unconfirmed\n" in flight.said()
    assert {line for line in flight.said().splitlines() if line.startswith("hold")} >= {"hold r1", "hold r2"}
    assert open_recording(tmp_path / "mission.mcap").complete


def test_a_closed_terminal_holds_everybody_and_closes_the_recording(tmp_path: Path) -> None:
    flight = Flight(tmp_path, confirms=True)
    flight.hang_up()
    flight.process.wait(60.0)
    assert "the terminal was closed (SIGHUP) unconfirmed" in flight.said()
    assert open_recording(tmp_path / "mission.mcap").complete


def test_a_second_signal_cancels_nothing_and_a_third_leaves_with_names(tmp_path: Path) -> None:
    flight = Flight(tmp_path, confirms=False)
    flight.process.send_signal(signal.SIGINT)
    flight.until("hold r1")
    flight.process.send_signal(signal.SIGINT)
    held = flight.said().count("hold")
    while flight.said().count("hold") < held + 6:  # it goes on being ordered
        flight.until("hold")
        time.sleep(0.05)
    flight.process.send_signal(signal.SIGINT)
    assert flight.process.wait(60.0) == 0
    assert "unconfirmed r1 r2" in flight.said()
    assert open_recording(tmp_path / "mission.mcap").complete


def test_ctrl_z_holds_everybody_and_suspends_nothing(tmp_path: Path) -> None:
    flight = Flight(tmp_path, confirms=True)
    flight.process.send_signal(signal.SIGTSTP)
    flight.until("hold r1")
    flight.until("hold r2")
    assert "ended" not in flight.said()
    flight.process.send_signal(signal.SIGINT)
    assert flight.process.wait(60.0) == 0
    assert "ended stopped by Ctrl-C unconfirmed\n" in flight.said()
