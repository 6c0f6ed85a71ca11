"""Ctrl-C once more while a mission that is over closes what it wrote: what was found is said all the same."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mission.lab.synthetic import small_mission

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

STARTED = """
import os, signal, sys
from fieldkit.cli import main
from fieldkit.clock import RealClock
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from mission.analysis import report
from mission.shell import setups, terminal, warm_up

number, moment = int(sys.argv.pop()), sys.argv.pop()

def fake(mission):
    clock = RealClock()
    rovers = {name: Rover(*place) for name, place in setups.start_places(mission).items()}
    return setups.Setup(clock, tuple(FakeReceiver(name, clock) for name in rovers), (FakeFleet(rovers, clock),))

def pressed(*_, **__):
    os.kill(os.getpid(), number)

def pressed_once(self, progress):
    terminal.Watch.show = lambda *_: None
    pressed()

def closed(self):
    pressed()
    close(self)

warm_up.warm_up = lambda mission: None
setups.live, terminal.Watch.show, close = fake, pressed_once, RecordingWriter.close
if moment == "closing":
    RecordingWriter.close = closed
else:
    report.write_report = pressed
main()
"""


def flown(folder: Path, number: int, moment: str) -> subprocess.CompletedProcess[str]:
    small_mission(folder)
    words = ["run", str(folder / "mission.toml"), "--out", str(folder / "runs"), "--no-page"]
    return subprocess.run(
        [sys.executable, "-c", STARTED, *words, moment, str(int(number))],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("number", "why"),
    [(signal.SIGINT, "stopped by Ctrl-C"), (signal.SIGTERM, "stopped by another program (SIGTERM)")],
)
def test_while_the_recording_closes_it_keeps_nobody_from_what_was_found(
    tmp_path: Path, number: int, why: str
) -> None:
    done = flown(tmp_path, number, "closing")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"ended: {why}\nnothing was heard")
    assert len(list((tmp_path / "runs").glob("*/report.html"))) == 1


def test_while_the_report_is_written_it_ends_that(tmp_path: Path) -> None:
    done = flown(tmp_path, signal.SIGINT, "report")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("ended: stopped by Ctrl-C")
    assert "no report was written: interrupted" in done.stderr
