"""What commands say while they work: logs above a live table, bars with the time left, silence where asked for."""

import io
import logging
import os
import pty
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console
from rich.live import Live

from fieldkit import console
from mission.shell.terminal import Watch

EXAMPLE = Path(__file__).parents[1] / "examples" / "readings.csv"


@pytest.fixture(autouse=True)
def loud() -> Iterator[None]:
    yield
    console.be_quiet(False)


def at_a_terminal(*words: str) -> str:
    """What a command writes where standard error is a terminal of 80 columns."""
    ours, theirs = pty.openpty()
    environment = os.environ | {"COLUMNS": "80", "TERM": "xterm"}
    done = subprocess.Popen(
        [sys.executable, "-m", "fieldkit", *words], stdout=subprocess.DEVNULL, stderr=theirs, env=environment
    )
    os.close(theirs)
    written = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        written += part
    assert done.wait(120) == 0, written
    os.close(ours)
    return written.decode()


def test_a_log_line_stands_above_a_live_table(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    monkeypatch.setattr(sys, "stderr", screen)
    handler = console.StderrHandler()
    record = logging.LogRecord("drivers", logging.WARNING, "", 0, "the radio of r1 is lost", None, None)
    with Live("table", console=Console(file=screen, force_terminal=True), redirect_stderr=True):
        handler.emit(record)
    assert "the radio of r1 is lost\n" in screen.getvalue()
    after = screen.getvalue().split("the radio of r1 is lost")[1]
    assert "table" in after, "the table is drawn anew below it"


def test_work_that_lasts_shows_a_bar_on_a_terminal_and_nothing_elsewhere() -> None:
    seen = at_a_terminal("calibrate", "fit", str(EXAMPLE))
    assert "fitting" in seen and re.search(r"\d:\d\d:\d\d", seen)
    silent = subprocess.run(
        [sys.executable, "-m", "fieldkit", "calibrate", "fit", str(EXAMPLE)], capture_output=True, check=True
    )
    assert b"fitting" not in silent.stderr


def test_quiet_says_nothing_but_results() -> None:
    assert "fitting" not in at_a_terminal("--quiet", "calibrate", "fit", str(EXAMPLE))


def test_a_quiet_watch_still_says_alarms(capsys: pytest.CaptureFixture[str]) -> None:
    console.be_quiet(True)
    progress: Any = SimpleNamespace(
        elapsed_s=12.0, alarms=("r1 has not shown for 3 s that it holds",), notes=("found source 3",)
    )
    with Watch() as watch:
        watch.show(progress)
    said = capsys.readouterr().err
    assert "ALARM: r1 has not shown" in said and "found source" not in said


def test_an_alarm_that_comes_again_is_said_again(capsys: pytest.CaptureFixture[str]) -> None:
    console.be_quiet(True)
    late = "r1 has not shown for {} s that it holds"
    seen = ((late.format(2),), (late.format(3), "r2 is lost"), (), (late.format(2),), (late.format(3),))
    with Watch() as watch:
        for k, alarms in enumerate(seen):
            progress: Any = SimpleNamespace(elapsed_s=float(k), alarms=alarms, notes=())
            watch.show(progress)
    said = [line.split(" s  ", 1) for line in capsys.readouterr().err.splitlines()]
    assert [(int(at_s), word) for at_s, word in said] == [
        (0, f"ALARM: {late.format(2)}"),
        (1, "ALARM: r2 is lost"),
        (3, f"ALARM: {late.format(2)}"),
    ]


def test_a_line_of_a_mission_says_why_a_robot_is_held_and_is_not_broken(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    engine = SimpleNamespace(teams=(("r1", "r2"),))
    kernel = SimpleNamespace(sources=tuple, settings=SimpleNamespace(engine=engine))
    doing = {"r1": "search", "r2": "held: its path comes within 0.55 m of r1, which is nearer than allowed"}
    progress: Any = SimpleNamespace(
        elapsed_s=12.0, alarms=(), notes=(), kernel=kernel, doing=doing, detections=3, probability_left=0.5
    )
    with Watch() as watch:
        watch.show(progress)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith(f"one still hidden 50%  r1 search; r2 {doing['r2']}"), "words as on the page"


def test_the_shell_is_told_how_to_complete() -> None:
    environment = os.environ | {
        "_FIELDKIT_COMPLETE": "complete_bash",
        "COMP_WORDS": "fieldkit calib",
        "COMP_CWORD": "1",
    }
    done = subprocess.run(
        [str(Path(sys.executable).with_name("fieldkit"))],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert done.stdout.split() == ["calibrate"], done.stderr
