"""The outermost layer: whatever goes wrong, a person reads one sentence, and what was there stays."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fieldkit import cli
from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.errors import NotWritten
from fieldkit.files import write_whole
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter


def run(*arguments: object, **more: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "fieldkit", *map(str, arguments)],
        capture_output=True, text=True, timeout=120, check=False, **more,  # type: ignore[call-overload]
    )  # fmt: skip


@pytest.mark.parametrize("place", ["/proc/new.toml", "/dev/full", "/dev/null/mission.toml"])
def test_a_place_where_nothing_can_be_written_is_named_in_one_line(place: str) -> None:
    done = run("new", place)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert done.stderr.startswith(f"fieldkit: {place}") and done.stderr.count("\n") == 1, done.stderr
    assert not Path("/dev/full").is_file(), "a device is no file to be replaced"


def test_a_disk_that_is_full_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "antenna.toml"
    write_whole(path, "as it was")

    def no_room(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("fieldkit.files.os.fsync", no_room)
    with pytest.raises(
        NotWritten, match=r"antenna\.toml: cannot be written \(no space left on device\); make room"
    ):
        write_whole(path, "as it should be")
    assert path.read_text() == "as it was" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.EROFS, "read-only"), (errno.EACCES, "a folder of yours"), (errno.EIO, "another folder")],
)
def test_each_reason_has_something_to_do(number: int, remedy: str) -> None:
    assert remedy in str(NotWritten(Path("x"), OSError(number, "Why")))


def test_what_is_written_to_a_pipe_arrives(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with subprocess.Popen(["cat", str(pipe)], stdout=subprocess.PIPE) as reader:
        write_whole(pipe, "as it is")
        assert reader.communicate(timeout=60)[0] == b"as it is"
    assert pipe.is_fifo()
    with pytest.raises(NotWritten, match=r"/dev/full: cannot be written \(no space left"):
        write_whole(Path("/dev/full"), "x")


def test_an_error_of_our_own_is_one_sentence_and_a_file_to_report(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def broken() -> None:
        raise KeyError("nobody thought of this")

    monkeypatch.setattr(cli, "build", broken)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(SystemExit) as ended:
        cli.main()
    said = capsys.readouterr().err
    assert ended.value.code == 70 and "Traceback" not in said and "nobody thought of this" in said
    (report,) = tmp_path.iterdir()
    assert str(report) in said and "Traceback" in report.read_text()


def test_a_reader_that_has_enough_is_no_error() -> None:
    listing = subprocess.Popen(
        [sys.executable, "-m", "fieldkit", "--help"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert listing.stdout is not None and listing.stderr is not None
    listing.stdout.close()
    said = listing.stderr.read()
    listing.stderr.close()
    listing.wait(timeout=60)
    assert b"Traceback" not in said and b"Exception" not in said


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["check", "."], "is a folder; name the mission file in it"),
        (["check", "antenna.toml"], "is an antenna file; name the mission file that uses it"),
        (["check", "noise.bin"], "is no text in UTF-8"),
        (["report", "."], "no such recording"),
        (["log", "info", "noise.bin"], "is not an MCAP recording"),
    ],
)
def test_a_file_of_another_kind_is_told_from_the_one_that_was_meant(
    arguments: list[str], expected: str, tmp_path: Path
) -> None:
    (tmp_path / "antenna.toml").write_text(dump_antenna(AntennaFile(Antenna(2.5, -62.0, 3.0, -90.0))))
    (tmp_path / "noise.bin").write_bytes(bytes(range(256)))
    done = run(*arguments, cwd=tmp_path)
    assert done.returncode == 2 and expected in done.stderr and "Traceback" not in done.stderr, done.stderr


def test_the_folder_of_a_run_stands_for_its_recording(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "mission.mcap") as writer:
        writer.note("info", "here")
    assert open_recording(tmp_path).path == tmp_path / "mission.mcap"


LOSES_IT = """
import signal, sys, time
from fieldkit.interrupts import keep_interrupts

class Library:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
        sum(range(1000))  # where Python notices it

signal.signal(signal.SIGINT, signal.default_int_handler)
if sys.argv[1] == "kept":
    keep_interrupts()
Library()
time.sleep(1.0)
print("went on")
"""


@pytest.mark.parametrize(("kept", "went_on"), [("lost", True), ("kept", False)])
def test_a_ctrl_c_in_a_librarys_finaliser_is_not_lost(kept: str, went_on: bool) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOSES_IT, kept], capture_output=True, text=True, timeout=60, check=False
    )
    assert ("went on" in done.stdout) is went_on, "without the hook Python ignores it"
    assert (done.returncode != 0) is not went_on and ("KeyboardInterrupt" in done.stderr)


def test_what_else_cannot_be_raised_is_printed_as_ever() -> None:
    lost = (
        "from fieldkit.interrupts import keep_interrupts as k; k()\nclass A:\n def __del__(self): 1 / 0\nA()"
    )
    done = subprocess.run(
        [sys.executable, "-c", lost], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0 and "ZeroDivisionError" in done.stderr
