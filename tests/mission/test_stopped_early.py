"""A signal to `fieldkit run` before the mission has begun: a person or a script reads that nothing has moved."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mission.lab.synthetic import small_mission

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

STARTED = """
import os, sys
from fieldkit.cli import main
from mission.shell import flight, warm_up

moment, number = sys.argv.pop(), int(sys.argv.pop())

def signalled(*_, **__):
    os.kill(os.getpid(), number)

if moment == "warm-up":
    warm_up.warm_up = signalled
else:
    warm_up.warm_up = lambda mission: None
    flight.keyboard = signalled  # the event loop runs by then
main()
"""


@pytest.mark.parametrize("moment", ["warm-up", "event loop"])
@pytest.mark.parametrize(
    ("number", "why"),
    [
        (signal.SIGINT, "stopped by Ctrl-C"),
        (signal.SIGTERM, "stopped by another program (SIGTERM)"),
        (signal.SIGHUP, "the terminal was closed (SIGHUP)"),
    ],
)
def test_a_signal_before_the_start_says_that_nothing_has_moved(
    tmp_path: Path, number: int, why: str, moment: str
) -> None:
    small_mission(tmp_path)
    words = ["run", str(tmp_path / "mission.toml"), "--out", str(tmp_path / "runs"), "--no-page"]
    done = subprocess.run(
        [sys.executable, "-c", STARTED, *words, str(int(number)), moment],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 128 + number, done.stderr
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"fieldkit: {why} before the mission began: nothing was started"), done.stderr
    assert "no vehicle was given an order" in last and "Traceback" not in done.stderr


def test_what_nohup_ignores_stays_ignored(tmp_path: Path) -> None:
    small_mission(tmp_path)
    words = ["run", str(tmp_path / "mission.toml"), "--out", str(tmp_path / "runs"), "--no-page"]
    ignoring = "import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    nothing_more = STARTED.replace("main()", "flight.fly = lambda *_, **__: sys.exit(7)\nmain()")
    done = subprocess.run(
        [sys.executable, "-c", ignoring + nothing_more, *words, str(int(signal.SIGHUP)), "warm-up"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 7, done.stderr
