"""kill -9 on the real program: vehicles hold by themselves, and the mission goes on from its recording."""

import json
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers.emulators.alone import ANTENNA
from drivers.emulators.field import EmulatedRobot, FieldSpec, start
from drivers.emulators.rover import GUIDED, HOLD
from drivers.emulators.running import RunningField
from fieldkit.clock import ScaledClock, wall_sleep
from fieldkit.recording.reader import open_recording
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import read_mission
from mission.lab.synthetic import small_mission
from mission.replay.replay import replay
from mission.shell.setups import start_places


def wait_until(condition: Any, timeout_s: float = 120.0) -> None:
    for _ in range(int(timeout_s / 0.1)):
        if condition():
            return
        wall_sleep(0.1)
    raise AssertionError(f"did not happen within {timeout_s:g} s")


def modes(field: RunningField) -> set[int]:
    return {robot["mode"] for robot in field.counts()["robots"].values()}


def fieldkit(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "fieldkit", *arguments, "--page-port", "0", "--json"]
    return subprocess.Popen(
        command,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        stdin=subprocess.DEVNULL,
    )


@pytest.mark.timeout(400)
def test_a_killed_mission_holds_and_is_resumed_with_the_same_belief(tmp_path: Path) -> None:
    plain = small_mission(tmp_path, duration_s=45.0, robots=2)
    port = 20_000 + hash(str(tmp_path)) % 20_000
    robots = tuple(
        EmulatedRobot(name, number, east, north)
        for number, (name, (east, north)) in enumerate(start_places(plain).items(), start=1)
    )
    spec = FieldSpec(
        ScaledClock(1.0), plain.frame, ANTENNA, (TransientSource(5.0, 3.0, 0.0, 1.0),), robots, f"127.0.0.1:{port}",
        seed=1,
    )  # fmt: skip
    with start(spec) as field:
        text = (tmp_path / "mission.toml").read_text().replace("14550", str(port))
        for number, robot in enumerate(robots, start=1):
            text = text.replace(f'"port{number}"', f'"{field.receiver_ports[robot.name]}"')
        (tmp_path / "mission.toml").write_text(text)
        assert tomllib.loads(text) and read_mission(tmp_path / "mission.toml")

        first = fieldkit(tmp_path, "run", "mission.toml")
        wait_until(lambda: modes(field) == {GUIDED})
        (log,) = (tmp_path / "runs").glob("*/mission.mcap")
        wait_until(lambda: any(open_recording(log).detections()))
        first.send_signal(signal.SIGKILL)
        first.communicate()
        wait_until(lambda: modes(field) == {HOLD}, 30.0)  # their own failsafe: nobody is left to tell them

        left = open_recording(log)
        assert not left.complete
        before = replay(log)
        assert before.kernel.detections > 0

        second = fieldkit(tmp_path, "run", "--resume", str(log))
        said, errors = second.communicate(timeout=200)
        assert second.returncode == 0, errors
        result = json.loads(said)
    assert "time is up" in result["end_reason"]
    assert result["detections"] >= before.kernel.detections
    whole = replay(tmp_path / result["recording"])
    assert whole.complete
    same = replay(tmp_path / result["recording"], check=False, until_s=before.duration_s)
    assert same.kernel.digest() == before.kernel.digest()
