"""A laptop among two agents: real processes, real Zenoh on loopback, emulated radios and vehicles."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from test_agents import Agent, fields, free_tcp_port, mode, moved_m, prepare, wait_until

from drivers.emulators.rover import HOLD
from drivers.emulators.running import RunningField
from mission.replay.collect import collect
from mission.replay.replay import replay

pytest.importorskip("zenoh")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")

__all__ = ["fields"]
NAMES = ("r1", "r2")


class Laptop(Agent):
    """`fieldkit agent --watch` in a process of its own, and its page."""

    def __init__(self, folder: Path, name: str, port: int) -> None:
        super().__init__(folder, name, port, False, ("--watch", "--page-port", "0"))

    def address(self) -> str:
        self.until("only to look:")
        (line,) = [each for each in self.said().splitlines() if each.startswith("to look and command")]
        return line.split()[-1]

    def frame(self, until: Any) -> dict[str, Any]:
        """The first frame of the page of which something is true."""
        from websockets.sync.client import connect

        with connect(self.address().split("#")[0].replace("http", "ws") + "live") as browser:
            while True:
                message = json.loads(browser.recv(timeout=60.0))
                if message["kind"] == "frame" and until(message):
                    return message

    def order(self, **order: Any) -> None:
        """Said on the page."""
        from websockets.sync.client import connect

        address, token = self.address().split("#")
        with connect(address.replace("http", "ws") + "live") as browser:
            browser.send(json.dumps({"kind": "token", "token": token}))
            browser.send(json.dumps({"kind": "command", "number": 1, "robot": None, **order}))
            while True:
                message = json.loads(browser.recv(timeout=60.0))
                if message["kind"] == "answer":
                    assert message["ok"], message
                    return


def known(frame: dict[str, Any]) -> bool:
    return all(robot["pose_age_s"] is not None and robot["pose_age_s"] < 3.0 for robot in frame["robots"])


def all_in(fields: dict[str, tuple[RunningField, str]], held: bool) -> bool:
    return all((mode(fields, name) == HOLD) == held for name in NAMES)


def test_two_laptops_come_show_all_hold_all_and_go(
    tmp_path: Path, fields: dict[str, tuple[RunningField, str]]
) -> None:
    prepare(tmp_path, fields)
    port = free_tcp_port()
    agents = [Agent(tmp_path, "r1", port, True), Agent(tmp_path, "r2", port, False)]
    laptops: list[Laptop] = []
    try:
        agents[0].until("r2 is in contact")
        laptops += [Laptop(tmp_path, "laptop", port), Laptop(tmp_path, "tablet", port)]
        laptop, tablet = laptops
        for name, start_m in zip(NAMES, ((3.0, 1.0), (7.0, 1.0)), strict=True):
            wait_until(
                lambda name=name, at=start_m: moved_m(fields, name, at) > 0.3, f"{name} does not drive"
            )  # type: ignore[misc]
        for each in laptops:
            each.until("r1 is in contact")
            each.until("r2 is in contact")
            assert {robot["name"] for robot in each.frame(known)["robots"]} == set(NAMES)
        laptop.order(action="hold")
        wait_until(lambda: all_in(fields, True), "not all hold")
        tablet.frame(lambda frame: all(robot["ordered"] == "hold" for robot in frame["robots"]))
        laptop.frame(lambda frame: not frame["alarms"])
        tablet.process.kill()  # nothing is said: nobody misses it
        laptop.order(action="resume", robot="r2")
        wait_until(lambda: mode(fields, "r2") != HOLD, "r2 does not go on")
        assert mode(fields, "r1") == HOLD
        laptop.order(action="resume")
        wait_until(lambda: all_in(fields, False), "not all go on")
        laptop.process.send_signal(signal.SIGTSTP)  # Ctrl-Z holds all
        wait_until(lambda: all_in(fields, True), "not all hold")
        time.sleep(1.5)
        laptop.order(action="end")
        out, _ = laptop.process.communicate(timeout=60.0)
        told = json.loads(out)
        for agent in agents:
            assert agent.process.poll() is None, "the robots' agents go on"
            agent.end()
            assert "laptop " not in agent.said() and "out of contact" not in agent.said()
    finally:
        for process in [each.process for each in (*agents, *laptops)]:
            if process.poll() is None:
                process.kill()
                process.wait()
    assert laptop.process.returncode == 0 and told["end_reason"] == "operator, on the laptop's page"
    assert told["not_shown_to_hold"] == told["not_handed_on"] == [] and not told["dropped"]["strangers"]
    assert replay(laptop.log / "common.mcap").complete
    done = collect(tmp_path / "collected.mcap", [tmp_path])
    assert done.refused == [] and len(done.journals) == 4 and done.orders >= 4
    cut = [note for note in done.notes if "did not come to its end" in note]
    assert len(cut) == 1 and "/tablet/" in cut[0]  # it was killed


def test_a_laptop_with_another_mission_file_is_refused_by_name_on_both_sides(
    tmp_path: Path, fields: dict[str, tuple[RunningField, str]]
) -> None:
    prepare(tmp_path, fields)
    other = tmp_path / "other"
    other.mkdir()
    for name in ("mission.toml", "antenna.toml", "mission.key"):
        text = (tmp_path / name).read_text()
        (other / name).write_text(text.replace("rate_hz = 0.5", "rate_hz = 0.25"))
    port = free_tcp_port()
    r1 = Agent(tmp_path, "r1", port, True)
    laptop = Laptop(other, "laptop", port)
    try:
        laptop.until("r1 on ")
        laptop.until("has another mission or antenna file")
        r1.until("has another mission or antenna file")
        assert "laptop " in r1.said()
        laptop.order(action="hold")
        time.sleep(2.0)
        assert "hold all" not in r1.said()
        laptop.process.send_signal(signal.SIGINT)
        out, _ = laptop.process.communicate(timeout=60.0)
        assert laptop.process.returncode == 4 and json.loads(out)["not_handed_on"] == ["hold all"]
        assert (
            "NOBODY HAS GOT: hold all" in laptop.said() and "NOT CONFIRMED to hold: r1, r2" in laptop.said()
        )
    finally:
        for process in (r1.process, laptop.process):
            if process.poll() is None:
                process.kill()
                process.wait()


def test_a_laptop_has_no_robot(tmp_path: Path, fields: dict[str, tuple[RunningField, str]]) -> None:
    prepare(tmp_path, fields)
    done = subprocess.run(
        [sys.executable, "-m", "fieldkit", "agent", str(tmp_path / "mission.toml"), "--watch", "--robot", "r1"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode != 0 and "on a computer without one either --watch or --hold" in done.stderr
