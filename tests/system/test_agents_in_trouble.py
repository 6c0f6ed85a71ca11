"""An autopilot that refuses to hold, and an agent started again: real processes, Zenoh and MAVLink on loopback."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from test_agents import NAMES, Agent, fields, free_tcp_port, mode, moved_m, prepare, wait_until

from drivers.emulators.rover import HOLD
from drivers.emulators.running import RunningField
from mission.cli.missions import UNCONFIRMED_EXIT
from mission.replay.collect import collect

pytest.importorskip("zenoh")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
__all__ = ["fields"]


def test_a_robot_whose_autopilot_refuses_to_hold_is_named(
    tmp_path: Path, fields: dict[str, tuple[RunningField, str]]
) -> None:
    prepare(tmp_path, fields)
    port = free_tcp_port()
    r1, r2 = Agent(tmp_path, "r1", port, True), Agent(tmp_path, "r2", port, False)

    def hold() -> subprocess.CompletedProcess[str]:
        wire = ["--connect", f"tcp/127.0.0.1:{port}", "--no-scouting", "--json"]
        return subprocess.run(
            [sys.executable, "-m", "fieldkit", "agent", str(tmp_path / "mission.toml"), "--hold", *wire],
            capture_output=True, text=True, check=False,
        )  # fmt: skip

    try:
        r1.until("r2 is in contact")
        for number, name in enumerate(NAMES):
            start_m = (3.0 + 4.0 * number, 1.0)
            wait_until(
                lambda name=name, at=start_m: moved_m(fields, name, at) > 0.3, f"{name} does not drive"
            )  # type: ignore[misc]
        fields["r2"][0].inject("refuses_hold", "r2", True)
        refused = hold()
        assert refused.returncode == UNCONFIRMED_EXIT, refused.stderr
        assert json.loads(refused.stdout) == {"r1": "holds", "r2": "has not shown it"}
        assert mode(fields, "r1") == HOLD != mode(fields, "r2")
        fields["r2"][0].inject("refuses_hold", "r2", False)
        done = hold()
        assert done.returncode == 0 and json.loads(done.stdout) == dict.fromkeys(NAMES, "holds"), done.stderr
        r2.end(), r1.end()
    finally:
        for agent in (r1, r2):
            if agent.process.poll() is None:
                agent.process.kill()


def test_an_agent_that_is_ended_and_started_again_goes_on_with_its_log(
    tmp_path: Path, fields: dict[str, tuple[RunningField, str]]
) -> None:
    prepare(tmp_path, fields)
    port = free_tcp_port()
    r1, r2 = Agent(tmp_path, "r1", port, True), Agent(tmp_path, "r2", port, False)
    try:
        r1.until("r2 is in contact")
        start_m = fields["r2"][0].truth()["r2"][:2]
        wait_until(lambda: moved_m(fields, "r2", start_m) > 0.3, "r2 does not drive")
        r2.end()
        start_m = fields["r2"][0].truth()["r2"][:2]
        r2 = Agent(tmp_path, "r2", port, False)
        r2.until("goes on with r2's log, where it stood: ")
        r2.until("r1 is in contact")
        wait_until(lambda: moved_m(fields, "r2", start_m) > 0.3, "r2 is no member again")
        r1.end(), r2.end()
    finally:
        for agent in (r1, r2):
            if agent.process.poll() is None:
                agent.process.kill()
    done = collect(tmp_path / "collected.mcap", [tmp_path / "r1", tmp_path / "r2"])
    assert len(done.journals) == 3 and done.refused == []
    assert not [note for note in done.notes if "is another one" in note], done.notes
