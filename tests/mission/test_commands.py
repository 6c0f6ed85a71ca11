"""The command line as a user meets it: exit codes, messages, JSON alone on standard output."""

import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from mission.cli.missions import print_flown
from mission.lab.synthetic import record_simulated, small_mission
from mission.shell.runner import Runner

COMMANDS = [
    ["demo"],
    ["run"],
    ["replay"],
    ["report"],
    ["new"],
    ["check"],
    ["bench"],
    ["calibrate", "fit"],
    ["log", "info"],
]


def fieldkit(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "fieldkit", *arguments], capture_output=True, text=True, cwd=cwd, check=False
    )


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_simulated(tmp_path_factory.mktemp("log"), seed=2, duration_s=60.0)


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom fieldkit.cli import build\nimport typer.main\n"
        "typer.main.get_command(build())\n"
        "heavy = {'scipy', 'numba', 'matplotlib', 'pymavlink', 'digi.xbee', 'pydantic', 'jinja2'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_has_a_summary_and_an_example(command: list[str]) -> None:
    done = fieldkit(*command, "--help")
    assert done.returncode == 0
    assert "Example: fieldkit " + " ".join(command) in " ".join(done.stdout.split())


def test_replay_json_is_alone_on_standard_output(log: Path) -> None:
    done = fieldkit("replay", str(log), "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["identical"] is True


def test_replay_with_a_changed_antenna_file_names_the_change_and_the_way_out(
    log: Path, tmp_path: Path
) -> None:
    other = tmp_path / "antenna.toml"
    other.write_text((log.parent / "antenna.toml").read_text().replace("sigma_db = 3.3", "sigma_db = 5.0"))
    done = fieldkit("replay", str(log), "--antenna", str(other))
    assert done.returncode == 2
    assert all(word in done.stderr for word in ("antenna.toml", "sigma_db 3.3", "5.0", "--what-if"))
    what_if = fieldkit("replay", str(log), "--antenna", str(other), "--what-if", "--json")
    assert json.loads(what_if.stdout)["identical"] is None
    unchanged = fieldkit("replay", str(log), "--antenna", str(log.parent / "antenna.toml"))
    assert unchanged.returncode == 0


def test_report_is_one_offline_page(log: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    done = fieldkit("report", str(log), "-o", str(page), "--json")
    assert json.loads(done.stdout)["complete"] is True
    text = page.read_text()
    assert text.count("<svg") >= 4
    assert 'src="http' not in text and 'href="http' not in text.replace('xlink:href="#', "")


def test_report_on_a_cut_log_says_so(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    done = fieldkit("report", str(cut), "-o", str(tmp_path / "r.html"))
    assert done.returncode == 0
    assert "not whole" in (tmp_path / "r.html").read_text()


def test_new_then_check_round(tmp_path: Path) -> None:
    small_mission(tmp_path)
    assert fieldkit("new", "mine.toml", cwd=tmp_path).returncode == 0
    checked = fieldkit("check", "mine.toml", "--json", cwd=tmp_path)
    assert json.loads(checked.stdout)["ok"] is True
    again = fieldkit("new", "mine.toml", cwd=tmp_path)
    assert again.returncode == 2 and "exists already" in again.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "nothing.toml"], ["nothing.toml", "fieldkit new"]),
        (["check", "nothing.toml"], ["nothing.toml"]),
        (["replay", "nothing.mcap"], ["nothing.mcap"]),
        (["report", "nothing.mcap"], ["nothing.mcap"]),
        (["bench", "nothing"], ["nothing", "spog"]),
    ],
)
def test_bad_input_is_code_2_with_a_plain_message_and_nothing_written(
    arguments: list[str], words: list[str], tmp_path: Path
) -> None:
    done = fieldkit(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == "" and "Traceback" not in done.stderr
    assert all(word in done.stderr for word in words)
    assert list(tmp_path.iterdir()) == []


def test_run_with_a_missing_port_names_it_and_moves_nothing(tmp_path: Path) -> None:
    small_mission(tmp_path)
    done = fieldkit("run", "mission.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert "port1" in done.stderr and "Traceback" not in done.stderr


def test_whoever_is_impatient_at_the_end_still_reads_what_was_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second Ctrl-C comes while the report is written."""

    def pressed(path: Path) -> None:
        raise KeyboardInterrupt

    importlib.import_module(
        "mission.analysis.history"
    )  # what is first imported now would keep the patched name
    monkeypatch.setattr("mission.analysis.history.open_recording", pressed)
    monkeypatch.setattr("fieldkit.recording.reader.open_recording", pressed)
    radio = SimpleNamespace(name="ada", radio_why="no line for 5 s")
    runner = SimpleNamespace(
        kernel=SimpleNamespace(sources=list, detections=0), recorder=SimpleNamespace(failure=""), unconfirmed=[],
        safety=SimpleNamespace(robots={"ada": radio}), end_reason="stopped by Ctrl-C",
    )  # fmt: skip
    print_flown(cast(Runner, runner), tmp_path, as_json=False)
    out, err = capsys.readouterr()
    assert "ended: stopped by Ctrl-C" in out
    assert "ada: its radio was down at the end: no line for 5 s" in err
    assert "no report was written: interrupted; 'fieldkit report" in err
