"""What can be wrong on one robot's computer alone: real processes, real Zenoh on loopback, emulated robots.

Two missions on one network, a file that differs, a clock that was never set, a full disk: each is said in words, and
the others go on.
"""

import contextlib
import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from test_agents import NAMES, Agent, fields, free_tcp_port, mode, moved_m, prepare, wait_until

from drivers.emulators.rover import HOLD
from drivers.emulators.running import RunningField
from mission.replay.collect import collect

resource = pytest.importorskip("resource")
pytest.importorskip("zenoh")
pytestmark = pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="limits of Linux")

__all__ = ["fields"]
Fields = dict[str, tuple[RunningField, str]]
ALONE = ("--contact-m", "5", "--wait-s", "1")
SAID_BYTES = 5_000
"""An agent says less than this in a short mission."""


@contextlib.contextmanager
def running(*agents: Agent) -> Iterator[None]:
    try:
        yield
    finally:
        for agent in agents:
            if agent.process.poll() is None:
                agent.process.kill()
                agent.process.wait()


def starts_m(fields: Fields) -> dict[str, tuple[float, float]]:
    return {name: fields[name][0].truth()[name][:2] for name in NAMES}


def drives(fields: Fields, name: str, start_m: tuple[float, float]) -> None:
    wait_until(lambda: moved_m(fields, name, start_m) > 0.3, f"{name} does not drive")


def other_file(folder: Path) -> None:
    """The same mission, but for one number."""
    path = folder / "mission.toml"
    path.write_text(path.read_text().replace("rate_hz = 0.5", "rate_hz = 0.25"))


def other_mission(folder: Path) -> None:
    """Another mission, with a key of its own."""
    path = folder / "mission.toml"
    path.write_text(path.read_text().replace('name = "agents"', 'name = "orchard"'))
    (folder / "mission.key").write_text("0123456789abcdef" * 4)


@pytest.mark.parametrize(
    ("change", "r1_says", "r2_says"),
    [
        (other_file, "has another mission or antenna file (mission 'agents'", "has another mission or antenna file"),
        (other_mission, "another mission is on this network, 'orchard' (r2 on ", "network, 'agents' (r1 on "),
    ],
    ids=["one key of the file", "two missions"],
)  # fmt: skip
def test_those_that_do_not_belong_together_name_each_other_and_each_goes_on_alone(
    tmp_path: Path, fields: Fields, change: Callable[[Path], None], r1_says: str, r2_says: str
) -> None:
    prepare(tmp_path, fields)
    there = tmp_path / "there"
    there.mkdir()
    for name in ("mission.toml", "antenna.toml", "mission.key"):
        shutil.copy(tmp_path / name, there / name)
    change(there)
    port, start_m = free_tcp_port(), starts_m(fields)
    r1 = Agent(tmp_path, "r1", port, True, ("--robot", "r1", *ALONE))
    r2 = Agent(there, "r2", port, False, ("--robot", "r2", *ALONE))
    with running(r1, r2):
        r1.until(r1_says)
        r2.until(r2_says)
        r1.until("no other agent is heard yet (looked nowhere: others must come by themselves)")
        r2.until(f"no other agent is heard yet (looked at tcp/127.0.0.1:{port})")
        r1.until("nothing was heard of r2: it goes on alone")
        r2.until("nothing was heard of r1: it goes on alone")
        for name in NAMES:
            drives(fields, name, start_m[name])
        r1.process.send_signal(signal.SIGTSTP)  # Ctrl-Z holds all of its own mission
        wait_until(lambda: mode(fields, "r1") == HOLD, "r1 does not hold")
        told = r1.end()
        drives(fields, "r2", starts_m(fields)["r2"])
        assert r2.process.poll() is None and "hold all" not in r2.said()
        r2.end()
    assert told["age_s"] == {"r2": None} and "r2 is in contact" not in r1.said()


CLOCK_OF_1970 = "import time; time.time_ns = lambda: 12 * 10**9; from fieldkit.cli import main; main()"


@pytest.mark.parametrize("who", [("--robot", "r2"), ("--watch",), ("--hold",)], ids=lambda who: who[0])
def test_a_clock_that_was_never_set_is_said_before_anything_is_touched(
    tmp_path: Path, fields: Fields, who: tuple[str, ...]
) -> None:
    prepare(tmp_path, fields)
    out = tmp_path / "runs"
    done = subprocess.run(
        [sys.executable, "-c", CLOCK_OF_1970, "agent", str(tmp_path / "mission.toml"), *who, "--out", str(out)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    said = " ".join(done.stderr.split())
    assert done.returncode == 2 and "this computer's clock says 12 s since 1970" in said, said
    assert "set it first, by a satellite receiver" in said and "Traceback" not in said
    assert not out.exists()


def test_a_start_that_fails_leaves_no_folder(tmp_path: Path, fields: Fields) -> None:
    prepare(tmp_path, fields)
    path = tmp_path / "mission.toml"
    path.write_text(path.read_text().replace(fields["r2"][0].receiver_ports["r2"], str(tmp_path / "nothing")))
    out = tmp_path / "runs"
    command = [sys.executable, "-m", "fieldkit", "agent", str(path), "--robot", "r2", "--no-scouting"]
    done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "nothing was begun" in done.stderr, done.stderr
    assert not out.exists()


def fill_disk(agent: Agent) -> None:
    """From now on no file of an agent grows: as on a disk that has become full. What it prints is shorter."""
    log = agent.log / "observations.log"
    wait_until(lambda: log.stat().st_size > SAID_BYTES, "the journal does not grow")
    size = log.stat().st_size
    resource.prlimit(agent.process.pid, resource.RLIMIT_FSIZE, (size, size))


def page_frame(agent: Agent, until: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The first frame of an agent's page of which something is true."""
    from websockets.sync.client import connect

    agent.until("only to look:")
    (line,) = [each for each in agent.said().splitlines() if each.startswith("to look and command")]
    with connect(line.split()[-1].split("#")[0].replace("http", "ws") + "live") as browser:
        while True:
            message = json.loads(browser.recv(timeout=60.0))
            if message["kind"] == "frame" and until(message):
                return dict(message)


def test_a_disk_full_on_one_robot_is_said_there_and_nothing_is_lost(tmp_path: Path, fields: Fields) -> None:
    prepare(tmp_path, fields)
    port, start_m = free_tcp_port(), starts_m(fields)
    r1 = Agent(tmp_path, "r1", port, True)
    page = ("--robot", "r2", "--contact-m", "5", "--page", "--page-port", "0")
    r2 = Agent(tmp_path, "r2", port, False, page)
    with running(r1, r2):
        r1.until("r2 is in contact")
        for name in NAMES:
            drives(fields, name, start_m[name])
        fill_disk(r2)
        r2.until("mission.mcap: recording stopped: File too large")
        said = page_frame(r2, lambda frame: bool(frame["alarms"]))["alarms"]
        assert any("RECORDED" in alarm and "mission.mcap" in alarm for alarm in said), said
        r2.until("observations.log: cannot be written: File too large")
        assert "what this robot observes is with the others alone" in " ".join(r2.said().split())
        page_frame(r2, lambda frame: any("observations.log" in alarm for alarm in frame["alarms"]))
        cut_m = starts_m(fields)["r2"]
        drives(fields, "r2", cut_m)
        r1.process.send_signal(signal.SIGTSTP)
        wait_until(lambda: all(mode(fields, name) == HOLD for name in NAMES), "not all hold")
        second, first = r2.end(), r1.end()
    assert "out of contact" not in r1.said().split("hold all")[0] and "FAILED" not in r1.said()
    assert first["common_tick"] and second["common_tick"]
    done = collect(tmp_path / "collected.mcap", [tmp_path / "r1" / "runs"])
    both = collect(tmp_path / "both.mcap", [tmp_path / "r1" / "runs", tmp_path / "r2" / "runs"])
    assert both.refused == [] and both.observations == done.observations, "what is cut on r2's disk r1 has"
    assert done.belief_hash == both.belief_hash
