"""The quick starts of docs/quickstart: one command each, from nothing to a found transmitter."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from mission.lab import drone_demo
from mission.lab.walk_demo import KINDS, hidden

pytestmark = pytest.mark.timeout(600)


LONG = pytest.mark.skipif(
    not os.environ.get("FIELDKIT_LONG"), reason="flown with FIELDKIT_LONG=1; its wire has tests of its own"
)
NAMED = ("yagi",)
"""Quick starts that are not flown by their page in a browser as well (lora is, and the drone with FIELDKIT_LONG=1)."""


@pytest.mark.parametrize(
    "kind", [kind if kind in NAMED else pytest.param(kind, marks=LONG) for kind in sorted(KINDS)]
)
def test_a_walk_on_emulated_devices_finds_what_is_hidden(kind: str, tmp_path: Path) -> None:
    seed = 3
    command = [
        sys.executable,
        "-m",
        "fieldkit",
        "demo",
        "--walk",
        kind,
        "--seed",
        str(seed),
        "--rate",
        "20",
        "--json",
    ]
    done = subprocess.run(
        [*command, "--out", str(tmp_path)], capture_output=True, text=True, check=False, timeout=500
    )
    assert done.returncode == 0, done.stderr[-2000:]
    result = json.loads(done.stdout)
    (source,) = hidden(seed)
    finds = [each for each in result["sources"] if each["state"] == "found"]
    assert len(finds) == 1, result["end_reason"]
    assert math.dist((finds[0]["east_m"], finds[0]["north_m"]), (source.east_m, source.north_m)) < 25.0


@LONG
def test_a_drone_with_a_dongle_finds_what_is_hidden(tmp_path: Path) -> None:
    seed = 3
    command = [sys.executable, "-m", "fieldkit", "demo", "--drone", "--seed", str(seed), "--json"]
    done = subprocess.run(
        [*command, "--out", str(tmp_path)], capture_output=True, text=True, check=False, timeout=500
    )
    assert done.returncode == 0, done.stderr[-2000:]
    result = json.loads(done.stdout)
    (source,) = drone_demo.hidden(seed)
    finds = [each for each in result["sources"] if each["state"] == "found"]
    assert len(finds) == 1, result["end_reason"]
    assert math.dist((finds[0]["east_m"], finds[0]["north_m"]), (source.east_m, source.north_m)) < 15.0
