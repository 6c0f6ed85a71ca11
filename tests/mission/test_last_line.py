"""What a mission says last, where its output is no terminal: a line every few seconds, and how it ended."""

from dataclasses import replace
from pathlib import Path

import pytest

from mission.core.kernel import Kernel
from mission.lab.synthetic import small_mission
from mission.shell.progress import Progress
from mission.shell.terminal import Watch


def test_the_last_line_is_how_it_ended(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    now = Progress(10.0, 1, Kernel(small_mission(tmp_path).kernel), {}, (), 0.9)
    with Watch() as watch:
        for second in range(3):  # at once: no line is due but the first
            watch.show(replace(now, elapsed_s=10.0 + second, probability_left=0.9 - 0.1 * second))
    lines = capfd.readouterr().err.splitlines()
    assert [line.split()[0] for line in lines] == ["10", "12"]
    assert "one still hidden 70%" in lines[-1]
