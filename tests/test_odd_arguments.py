"""Options of commands that end by themselves, given odd values; and what one that goes on must refuse at once."""

import shutil
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sizes import size
from test_odd_files import said_of
from typer.main import get_command
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.errors import FieldkitError
from mission.lab.synthetic import record_simulated

EXAMPLE = Path(__file__).parents[1] / "examples" / "readings.csv"
APP = build()
BASE: dict[str, list[str]] = {
    "replay": ["run.mcap"],
    "report": ["run.mcap"],
    "compare": ["run.mcap"],
    "analyze": ["runs"],
    "refit": ["run.mcap"],
    "survey": ["heard.csv", "walk.csv"],
    "log export": ["run.mcap"],
    "log merge": ["run.mcap", "run.mcap"],
    "log redact": ["run.mcap"],
    "log recover": ["run.mcap"],
    "log layout": [],
    "calibrate fit": ["readings.csv"],
    "calibrate check": ["antenna.toml", "readings.csv"],
    "calibrate import": ["heard.csv"],
    "calibrate update": ["antenna.toml", "run.mcap"],
}
"""Command to arguments with which it does something."""
NOT_HERE = {"--dask", "--workers", "--speed"}
"""What waits for another machine, or for real time."""
ODD = (
    "", " ", "x", "-1", "0", "1e999", "nan", "-inf", "1,2", "9" * 400, "1:2", "a=b", "=", "[/x]", "[bold]",
    "-", "--", "../..", "/", "/dev/null", "nowhere/at/all", "\x00", "🛰" * 90, "שלום",
    "engine.found_probability=nan", "tuning.x.y=1", "engine.found_probability=" + "[" * 50, "r1", "r1=1e6",
    "rss_dbm=level", "run.mcap", "antenna.toml", "*", "%s{}",
)  # fmt: skip
REFUSED = (
    "demo --rate 0", "demo --rate nan", "demo --seed x", "demo --seed -1", "demo --walk nobody",
    "demo --page-port 99999", "emulate field --rate 0", "emulate field --robots 0",
    "emulate field --robots -1", "emulate field --size-m nan", "emulate field --sources -1",
    "emulate xbee --rate-hz -1", "emulate xbee --profile nobody", "emulate rover --firmware no",
    "emulate rover --rate 0", "emulate rover --address nonsense", "emulate printer --style nobody",
    "emulate printer --rate-hz nan", "emulate sniffer --kind nobody",
    "emulate radios --mission nowhere.toml", "vehicles --seconds -1", "vehicles --seconds nan",
    "vehicles --address nonsense", "channels nowhere", "devices nowhere --seconds nan", "bench nobody",
    "study nobody", "study trust --trials 0", "study trust --trials -3", "study trust --workers 0",
    "study reality --data nowhere", "walk --size-m 0", "walk --receiver nobody", "walk nowhere.toml",
    "preflight nowhere.toml", "run nowhere.toml", "run mission.toml --page-port -1",
    "run --resume nowhere.mcap", "plan nowhere/at/all/mission.toml --page-port 99999", "dashboard nowhere",
    "dashboard run.mcap --page-port -1", "docs --port 99999", "camera calibrate nowhere points.csv",
    "camera look nowhere calibration.toml", "calibrate collect --receiver nobody -o new.csv", "nonsense",
    "check", "check a b", "check --nonsense mission.toml", "new mission.toml", "log", "log nonsense",
    "calibrate fit", "--nonsense", "agent nowhere.toml --robot r1", "agent mission.toml",
    "agent mission.toml --robot nobody", "agent mission.toml --robot r1", "agent mission.toml --hold",
    "agent mission.toml --watch", "agent mission.toml --watch --robot r1", "agent mission.toml --watch --hold",
    "agent mission.toml --robot r1 --key readings.csv", "agent mission.toml --robot r1 --bytes-s x",
    "agent mission.toml --new-key --key readings.csv", "collect", "collect new.mcap", "collect new.mcap nowhere",
    "collect new.mcap runs readings.csv run.mcap", "collect run.mcap runs",
)  # fmt: skip


def options_of(name: str) -> list[str]:
    """The options of a command that take a value."""
    command = get_command(APP)
    for word in name.split():
        command = command.commands[word]  # type: ignore[attr-defined]
    return [
        each.opts[0]
        for each in command.params
        if each.param_type_name == "option"
        and not getattr(each, "is_flag", False)
        and each.opts[0] not in NOT_HERE
    ]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arguments")
    shutil.move(record_simulated(folder, duration_s=20.0), folder / "run.mcap")
    shutil.copy(EXAMPLE, folder / "readings.csv")
    rows = range(0, 60, 2)
    (folder / "heard.csv").write_text("time_s,rss_dbm\n" + "".join(f"{t},{-60 - t % 7}\n" for t in rows))
    (folder / "walk.csv").write_text(
        "time_s,lat_deg,lon_deg\n" + "".join(f"{t},{47.0 + t * 1e-6},{8.0 + t % 9 * 1e-6}\n" for t in rows)
    )
    (folder / "runs").mkdir()
    shutil.copy(folder / "run.mcap", folder / "runs" / "run.mcap")
    return folder


@pytest.fixture
def here(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of these to work in: what is written stays there."""
    shutil.copytree(made, tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "here"


@pytest.mark.parametrize("name", BASE)
@settings(
    max_examples=size(4, 10), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_an_odd_value_is_taken_or_refused_in_words(here: Path, name: str, data: st.DataObject) -> None:
    words = [*name.split(), *BASE[name]]
    for option in data.draw(st.lists(st.sampled_from(options_of(name)), min_size=1, max_size=2)):
        words += [option, data.draw(st.sampled_from(ODD))]
    assert "Traceback" not in said_of(words)


@pytest.mark.timeout(60)
@pytest.mark.parametrize("line", REFUSED)
def test_what_cannot_be_done_is_refused_before_anything_begins(here: Path, line: str) -> None:
    done = CliRunner().invoke(APP, line.split())
    error = done.exception
    assert done.exit_code != 0, done.output
    assert error is None or isinstance(error, SystemExit | FieldkitError | OSError), repr(error)
    assert done.output.strip() or str(error).strip()
