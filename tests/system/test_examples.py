"""The worked examples run as they are written, on a small recording."""

import subprocess
import sys
from pathlib import Path

import pytest

from fieldkit.recording import open_recording
from mission.lab.synthetic import record_simulated

EXAMPLES = Path(__file__).parent.parent.parent / "examples"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_simulated(tmp_path_factory.mktemp("log"), seed=2, duration_s=120.0)


def run(name: str, *arguments: object) -> list[str]:
    command = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_heard_where_counts_every_reading(log: Path) -> None:
    lines = run("heard_where.py", log)
    counts = open_recording(log).summary()["counts"]
    assert [line.split(":")[0] for line in lines] == ["r1", "r2", "r3", "r4"]
    assert sum(int(line.split("heard ")[1].split(" ")[0]) for line in lines) == counts["/in/reading"]


def test_belief_over_time_draws_a_picture(log: Path, tmp_path: Path) -> None:
    lines = run("belief_over_time.py", log, tmp_path / "belief.png")
    assert len(lines) == open_recording(log).summary()["counts"]["/view/belief/p"]
    assert (tmp_path / "belief.png").read_bytes().startswith(b"\x89PNG")


def test_what_if_finds_no_more_where_more_certainty_is_asked(log: Path) -> None:
    found = [int(line.split(": ")[1].split(" ")[0]) for line in run("what_if.py", log)]
    assert len(found) == 4 and found == sorted(found, reverse=True)
