"""A second emulated field must not answer as the vehicles of the first, nor overwrite its mission."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.cli import emulate
from drivers.emulators.claims import claimed_vehicles
from fieldkit.errors import ConfigError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")
HELD = """
import sys
from pathlib import Path
from drivers.emulators.claims import claimed_folder, claimed_vehicles
with claimed_vehicles("127.0.0.1:39", (1, 2)), claimed_folder(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def first(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has vehicles 1 and 2 at 127.0.0.1:39 and the folder `out`."""
    with subprocess.Popen(
        [sys.executable, "-c", HELD, str(tmp_path / "out")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        yield process
        process.kill()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            "field --address localhost:39 --out other",
            "localhost:39 is taken: another 'fieldkit emulate' that still runs sends there as vehicle 1, 2. "
            "End it, or give this one another port: --address localhost:40",
        ),
        ("rover --system-id 2 --address 127.0.0.1:39", "as vehicle 2. End it, or"),
        ("field --address 127.0.0.1:49 --out out", "out is taken: it has the mission file of another"),
    ],
)
def test_what_another_one_has_is_refused(
    first: subprocess.Popen[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(emulate, words.split())
    assert isinstance(done.exception, ConfigError), done.output
    assert says in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_another_vehicle_of_the_same_address_is_welcome_and_an_end_of_any_kind_frees_all(
    first: subprocess.Popen[str],
) -> None:
    with claimed_vehicles("127.0.0.1:39", [3]):
        pass
    first.send_signal(signal.SIGKILL)
    first.wait(60)
    with claimed_vehicles("127.0.0.1:39", [1]):
        pass
