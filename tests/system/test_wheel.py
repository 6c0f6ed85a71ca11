"""The wheel as it is installed: somebody else's package (tests/consumer) against it, in a fresh environment.

Nothing is downloaded: the fresh environment looks up the dependencies in the one that runs the tests, by a path file,
behind its own packages. An editable installation is not seen through such a path.
"""

import json
import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from sizes import size

from mission.lab.synthetic import small_mission

ROOT = Path(__file__).parents[2]
CONSUMER = ROOT / "tests" / "consumer"
PACKAGES = ("fieldkit", "calibration", "drivers", "mission")


def run(*command: str | Path, cwd: Path, env: dict[str, str] | None = None) -> str:
    """What a command printed; its errors fail the test with both outputs."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "COV"))}
    done = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env={**clean, **(env or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{command}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build(source: Path, into: Path) -> Path:
    """The wheel of a project, built with what is installed here."""
    run(
        sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-index", "--no-build-isolation",
        "--wheel-dir", into, source, cwd=into,
    )  # fmt: skip
    (wheel,) = into.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run(
        sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", ROOT / "fieldkit" / "_manual",
        cwd=ROOT, env={"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    return build(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def fresh(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with the two wheels."""
    folder = tmp_path_factory.mktemp("fresh")
    consumer = build(CONSUMER, tmp_path_factory.mktemp("consumer"))
    run(sys.executable, "-m", "venv", "--without-pip", folder / "venv", cwd=folder)
    scripts = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    python = scripts / ("python.exe" if os.name == "nt" else "python")
    site = Path(
        run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip()
    )
    run(
        sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index",
        wheel, consumer, cwd=folder,
    )  # fmt: skip
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return python


def test_the_wheel_carries_types_page_examples_and_licences(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    assert "fieldkit/_examples/readings.csv" in names
    assert "mission/page/static/page.html" in names
    assert {"fieldkit/_manual/index.html", "fieldkit/_manual/reference/api.html"} <= set(names)
    assert any(name.endswith("licenses/NOTICE") for name in names)
    assert not any(name.startswith(("tests/", "docs/")) for name in names)


def test_the_fresh_environment_runs_the_wheel(fresh: Path, tmp_path: Path) -> None:
    said = run(
        fresh, "-c", "import fieldkit, mission; print(fieldkit.__file__, mission.__file__)", cwd=tmp_path
    )
    assert all(str(fresh.parents[1]) in each for each in said.split())


def test_the_consumer_passes_a_strict_type_check_against_the_wheel(fresh: Path, tmp_path: Path) -> None:
    said = run(
        sys.executable, "-m", "mypy", "--strict", "--python-executable", fresh,
        "--cache-dir", tmp_path / "cache", "--follow-imports", "silent", CONSUMER / "src" / "treasure",
        cwd=tmp_path,
    )  # fmt: skip
    assert "Success" in said


def test_the_installed_manual_opens(fresh: Path, tmp_path: Path) -> None:
    index = Path(run(fresh, "-m", "fieldkit", "docs", "--path", cwd=tmp_path).strip())
    assert "fieldkit" in index.read_text() and str(fresh.parents[1]) in str(index)


@pytest.mark.parametrize("planner", size(["treasure"], ["treasure", "infogain"]))
def test_a_mission_is_flown_with_the_consumers_belief(fresh: Path, tmp_path: Path, planner: str) -> None:
    small_mission(tmp_path, duration_s=600.0, engine={"belief": "intensity", "planner": "infogain"})
    text = (tmp_path / "mission.toml").read_text()
    text = text.replace('belief = "intensity"', 'belief = "treasure"')
    text = text.replace('planner = "infogain"', f'planner = "{planner}"').replace('"xbee"', '"treasure"')
    (tmp_path / "mission.toml").write_text(text)
    run(fresh, "-m", "fieldkit", "check", "mission.toml", cwd=tmp_path)
    said = json.loads(
        run(fresh, "-m", "fieldkit", "treasure", "mission.toml", "run.mcap", "3.1", "4.3", cwd=tmp_path)
    )
    assert said["belief"] == "OneSource" and said["readings"] > 0
    assert said["end_reason"] == "the probability that a source is left is 0.000"
    ((east_m, north_m),) = said["found"]
    assert abs(east_m - 3.1) < 0.5 and abs(north_m - 4.3) < 0.5
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


RADIO = """
import asyncio
from fieldkit import plugins
from fieldkit.clock import VirtualClock
from fieldkit.geo import FieldFrame
from fieldkit.ports import Receiver, DriverContext

async def listen():
    radio = plugins.load("fieldkit.receivers", "treasure")(
        "r1", {"rss_dbm": -61.0}, DriverContext(VirtualClock(), FieldFrame(47.0, 8.0))
    )
    assert isinstance(radio, Receiver)
    async with radio:
        items = radio.readings()
        print(await anext(items))
        print((await anext(items)).rss_dbm)
        await items.aclose()

asyncio.run(listen())
"""


def test_the_consumers_radio_is_opened_by_name(fresh: Path, tmp_path: Path) -> None:
    state, level = run(fresh, "-c", RADIO, cwd=tmp_path).splitlines()
    assert "up=True" in state and level == "-61.0"
