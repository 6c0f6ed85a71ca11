"""`fieldkit emulate field` writes a mission that runs on it, with no file edited by hand."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fieldkit.clock import wall_sleep
from mission.shell.setups import free_udp_port


def said_at_start(field: subprocess.Popen[str]) -> str:
    """What a field says until it is there."""
    assert field.stdout is not None
    said = ""
    while "Ctrl-C ends it" not in said:
        line = field.stdout.readline()
        assert line, said
        said += line
    return said


@pytest.mark.timeout(240)
def test_what_it_writes_passes_check_and_preflight_and_flies(tmp_path: Path) -> None:
    fieldkit = [sys.executable, "-m", "fieldkit"]
    words = [
        "emulate",
        "field",
        "--robots",
        "2",
        "--sources",
        "1",
        "--address",
        f"127.0.0.1:{free_udp_port()}",
    ]
    with subprocess.Popen([*fieldkit, *words], cwd=tmp_path, stdout=subprocess.PIPE, text=True) as field:
        said = said_at_start(field)
        assert "fieldkit run emulated-field/mission.toml --page" in said
        mission = tmp_path / "emulated-field" / "mission.toml"
        try:
            checked = subprocess.run(
                [*fieldkit, "check", mission], capture_output=True, text=True, check=False
            )
            assert checked.returncode == 0, checked.stderr
            looked = subprocess.run(
                [*fieldkit, "preflight", mission, "--json"],
                capture_output=True,
                text=True,
                check=False,
                cwd=tmp_path,
            )
            assert json.loads(looked.stdout)["verdict"] != "red", looked.stdout
            with subprocess.Popen(
                [*fieldkit, "run", mission, "--page-port", "0", "--json"],
                cwd=tmp_path,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            ) as run:
                while run.poll() is None and not list(tmp_path.glob("runs/*/mission.mcap")):
                    wall_sleep(0.5)
                wall_sleep(15.0)
                run.send_signal(signal.SIGINT)
                out, said = run.communicate(timeout=60)
            assert json.loads(out or "{}").get("end_reason") == "stopped by Ctrl-C", said[-2000:]
        finally:
            field.send_signal(signal.SIGINT)
            field.wait(20)


@pytest.mark.timeout(120)
def test_for_agents_each_vehicle_has_an_address_of_its_own(tmp_path: Path) -> None:
    port = free_udp_port()
    words = ["emulate", "field", "--robots", "2", "--agents", "--address", f"127.0.0.1:{port}"]
    fieldkit = [sys.executable, "-m", "fieldkit"]
    with subprocess.Popen([*fieldkit, *words], cwd=tmp_path, stdout=subprocess.PIPE, text=True) as field:
        said = said_at_start(field)
        field.send_signal(signal.SIGINT)
        field.wait(20)
    text = (tmp_path / "emulated-field" / "mission.toml").read_text()
    for number in (1, 2):
        address = f"127.0.0.1:{port + number - 1}"
        assert f"robot{number} sends to {address}" in said
        assert f'address = "udpin:{address}", system_id = {number}' in text
    assert "fieldkit agent emulated-field/mission.toml --robot robot2 --out robot2" in said
    assert "fieldkit collect collected.mcap robot1 robot2 laptop" in said
    assert all(len(line) <= 80 for line in said.splitlines())
