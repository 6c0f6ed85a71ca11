"""A second agent of a robot on one computer is refused by name, before it touches a port."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fieldkit.errors import ConfigError
from mission.shell.alone import alone

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="locks of POSIX")
HELD = "import sys; from pathlib import Path; from mission.shell.alone import alone\n"
HELD += "with alone('r1', 'ab', Path(sys.argv[1])): print('in', flush=True); sys.stdin.read()"


def test_the_second_is_told_who_has_it_until_that_one_is_gone(tmp_path: Path) -> None:
    first = subprocess.Popen(
        [sys.executable, "-c", HELD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert first.stdout is not None and first.stdout.readline() == "in\n"
        with (
            pytest.raises(ConfigError, match=rf"an agent for r1 already runs .*\(process {first.pid}\)"),
            alone("r1", "ab", tmp_path),
        ):
            raise AssertionError("there were two")
        for robot, team in (("r2", "ab"), ("r1", "cd")):
            with alone(robot, team, tmp_path):
                pass
    finally:
        first.kill()
        first.communicate()
    for _ in range(2):
        with alone("r1", "ab", tmp_path):
            assert str(os.getpid()) in (tmp_path / "fieldkit-agent-ab-r1.lock").read_text()


def test_a_lock_that_cannot_be_had_keeps_nobody_from_flying(tmp_path: Path) -> None:
    with alone("r1", "ab", tmp_path / "nowhere"):
        pass
    (tmp_path / "elsewhere").touch()
    (tmp_path / "fieldkit-agent-ab-r1.lock").symlink_to(tmp_path / "elsewhere")
    with alone("r1", "ab", tmp_path):
        assert (tmp_path / "elsewhere").read_text() == ""
