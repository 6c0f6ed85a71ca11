"""Every command that reads a file, given every odd file: it says what is wrong, and never how it fell over."""

import os
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from sizes import size
from typer.testing import CliRunner

from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.cli import build
from fieldkit.errors import ConfigError, FieldkitError, NotWritten
from mission.core.template import mission_text
from mission.lab.synthetic import record_simulated

APP = build()
COMMANDS: dict[str, Callable[[str, str], list[str]]] = {
    "check": lambda file, out: ["check", file],
    "report": lambda file, out: ["report", file, "-o", out],
    "replay": lambda file, out: ["replay", file],
    "compare": lambda file, out: ["compare", file, "-o", out],
    "log info": lambda file, out: ["log", "info", file],
    "log list": lambda file, out: ["log", "list", file],
    "log export": lambda file, out: ["log", "export", file, "-o", out + ".csv"],
    "log recover": lambda file, out: ["log", "recover", file, "-o", out + ".mcap"],
    "log redact": lambda file, out: ["log", "redact", file, "-o", out + ".mcap"],
    "log merge": lambda file, out: ["log", "merge", file, file, "-o", out + ".mcap"],
    "calibrate fit": lambda file, out: ["calibrate", "fit", file, "-o", out],
    "survey": lambda file, out: ["survey", file, file, "--antenna", file],
    "calibrate update": lambda file, out: ["calibrate", "update", file, file],
    "collect": lambda file, out: ["collect", out + ".mcap", file],
    "refit": lambda file, out: ["refit", file, "-o", out + ".geojson"],
    "analyze": lambda file, out: ["analyze", file, "--results", out],
}


def mcap_head() -> bytes:
    return b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, 2**40) + b"profile"


ODD: dict[str, bytes] = {
    "empty.toml": b"",
    "nothing.mcap": b"",
    "head only.mcap": mcap_head(),
    "noise.bin": bytes(range(256)) * 64,
    "zeros.mcap": bytes(4096),
    "one line.csv": b"x" * 300_000,
    "header only.csv": b"time_s,robot,rss_dbm\n",
    "nan.csv": b"distance_m,rss_dbm\n" + b"nan,-60\ninf,inf\n-1,5\n,\n" * 30,
    "latin1.csv": "distance_m,rss_dbm\n1,-60 \xb0\n".encode("latin-1"),
    "utf16.csv": "distance_m,rss_dbm\n1,-60\n".encode("utf-16"),
    "bom.toml": b"\xef\xbb\xbf" + mission_text().encode(),
    "cut.toml": mission_text().encode()[:700],
    "other.toml": b"[tool.black]\nline-length = 110\n",
    "deep.toml": b"a = " + b"[" * 400 + b"]" * 400,
    "deep.json": b"[" * 100_000,
    "name [bold]x[-x].csv": b"distance_m,rss_dbm\n1,-60\n",
    "track.gpx": b"<gpx><trk><trkseg><trkpt lat='x' lon='1'/></trkseg></trk></gpx>",
    "bomb.gpx": b"<!DOCTYPE x [<!ENTITY a 'aaaa'><!ENTITY b '&a;&a;&a;'>]><gpx>&b;</gpx>",
    "flight.tlog": bytes([0xFD] * 5000),
}


def said_of(words: list[str]) -> str:
    """What a command says; fails where it falls over."""
    done = CliRunner().invoke(APP, words)
    error = done.exception
    if error is not None and not isinstance(error, SystemExit | FieldkitError | OSError):
        raise AssertionError(f"{words}: {type(error).__name__}: {error}") from error
    return f"{done.output}{error if isinstance(error, FieldkitError | OSError) else ''}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("odd")
    for name, content in ODD.items():
        (folder / name).write_bytes(content)
    (folder / "folder.mcap").mkdir()
    (folder / "dangling.mcap").symlink_to(folder / "nowhere")
    return folder


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record_simulated(tmp_path_factory.mktemp("whole"), duration_s=30.0).read_bytes()


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("name", [*ODD, "folder.mcap", "dangling.mcap", "absent"])
def test_an_odd_file_is_refused_in_words(folder: Path, tmp_path: Path, command: str, name: str) -> None:
    said = said_of(COMMANDS[command](str(folder / name), str(tmp_path / "out")))
    assert "Traceback" not in said and said.strip()


@pytest.mark.parametrize("command", [each for each in COMMANDS if each.startswith(("log", "rep", "comp"))])
@settings(
    max_examples=size(4, 12), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_a_damaged_recording_is_read_or_refused_in_words(
    tmp_path: Path, whole: bytes, command: str, data: st.DataObject
) -> None:
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(len(damaged) // 2, len(damaged)))
    path, out = tmp_path / "damaged.mcap", tmp_path / "out"
    path.write_bytes(damaged[:cut])
    for made in tmp_path.glob("out*"):
        made.unlink()
    assert "Traceback" not in said_of(COMMANDS[command](str(path), str(out)))


@pytest.mark.parametrize(
    "command",
    [
        ["calibrate", "fit", "a.csv", "-o", "a.csv"],
        ["calibrate", "fit", "a.csv", "-o", "new.toml", "--plot", "./new.toml"],
        ["calibrate", "fit", "a.csv", "-o", "new.toml", "--report", "a.csv"],
        ["calibrate", "import", "a.csv", "-o", "link.csv"],
        ["survey", "a.csv", "b.csv", "--antenna", "c.toml", "--geojson", "b.csv"],
    ],
    ids=" ".join,
)
def test_nothing_is_written_over_what_is_read(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("distance_m,rss_dbm\n1,-60\n")
    Path("link.csv").symlink_to("a.csv")
    result = CliRunner().invoke(APP, command)
    assert isinstance(result.exception, ConfigError)
    assert "would be written over" in str(result.exception)
    assert Path("a.csv").read_text().startswith("distance_m") and not Path("new.toml").exists()


def test_no_recording_is_ever_replaced(tmp_path: Path) -> None:
    log = tmp_path / "mission.mcap"
    log.write_bytes(mcap_head())
    result = CliRunner().invoke(APP, ["log", "layout", "-o", str(log)])
    assert isinstance(result.exception, NotWritten)
    assert "a recording is there" in str(result.exception) and "name another" in str(result.exception)
    assert log.read_bytes() == mcap_head()


@pytest.mark.timeout(60)
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("check PIPE", "expected a mission file, got a pipe or device"),
        ("run PIPE", "expected a mission file, got a pipe or device"),
        ("plan PIPE --no-open --page-port 0", "expected a mission file, got a pipe or device"),
        (
            "calibrate fit PIPE",
            "expected a CSV of readings, got a pipe or device; write it into a file first",
        ),
        ("calibrate check antenna.toml PIPE", "expected a CSV of readings, got a pipe"),
        ("calibrate import PIPE -o new.csv", "expected a CSV of readings, got a pipe"),
        ("calibrate import pipe.html -o new.csv", "expected a report, got a pipe"),
        ("calibrate check PIPE readings.csv", "expected an antenna file, got a pipe"),
        ("survey readings.csv pipe.csv --antenna antenna.toml", "expected a file of positions, got a pipe"),
        ("survey pipe.mcap track.csv --antenna antenna.toml", "expected a file of readings, got a pipe"),
        (
            "survey bag.mcap track.csv --antenna antenna.toml --topics PIPE",
            "expected a map of topics, got a pipe",
        ),
    ],
)
def test_a_pipe_that_nobody_writes_into_is_not_waited_for(
    words: str, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("PIPE", "pipe.html", "pipe.csv", "pipe.mcap"):
        os.mkfifo(name)
    Path("track.csv").write_text("time_s,east_m,north_m\n0,0,0\n1,1,1\n")
    with Path("bag.mcap").open("wb") as stream:
        bag = Writer(stream)
        bag.start(profile="ros2")
        bag.finish()
    (tmp_path / "antenna.toml").write_text(dump_antenna(AntennaFile(Antenna(2.5, -62.0, 3.0, -90.0))))
    assert expected in said_of(words.split())
