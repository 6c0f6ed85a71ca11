"""Recordings that were cut, flipped or never were: nothing silently wrong, nothing crashes."""

import os
import random
import signal
import subprocess
import sys

import pytest
from closed import close
from mcap.writer import Writer
from sizes import size

from fieldkit.errors import RecordingError
from fieldkit.messages import Hold, Tick
from fieldkit.recording import RecordingWriter, open_recording, recover
from fieldkit.recording import writer as writer_module

from .conftest import record
from .samples import mission, same


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    """Several chunks in a small file: the interesting damage is between and inside them."""
    monkeypatch.setattr(writer_module, "CHUNK_BYTES", 4096)


def read(path):
    """What can be read, and the warning; None where the file was refused."""
    try:
        recording = open_recording(path)
        return list(recording.events()), recording.missing
    except RecordingError:
        return None


def assert_never_silently_wrong(path, events):
    got = read(path)
    if got is None:
        return 0
    found, missing = got
    for number, log_ns, event in found:
        assert same(event, events[number]) and log_ns == events[number].t_ns + 1000
    assert [n for n, _, _ in found] == sorted({n for n, _, _ in found})
    if len(found) < len(events):
        assert missing
    return len(found)


def test_a_file_cut_at_any_byte_gives_a_true_part_and_says_so(tmp_path):
    path = record(tmp_path / "m.mcap", seconds=1)
    whole = path.read_bytes()
    events, cut = mission(1), tmp_path / "cut.mcap"
    counts = []
    for length in range(0, len(whole), max(1, len(whole) // size(150, 600))):
        cut.write_bytes(whole[:length])
        counts.append(assert_never_silently_wrong(cut, events))
        if (got := read(cut)) is not None:
            assert "index" in got[1]
    assert counts == sorted(counts)
    assert counts[-1] == len(events)


def test_flipped_bits_never_give_a_wrong_value_without_a_warning(tmp_path):
    path = record(tmp_path / "m.mcap", seconds=2)
    whole = path.read_bytes()
    events, bad = mission(2), tmp_path / "bad.mcap"
    rng = random.Random(1)
    usable = 0
    for _ in range(tries := size(100, 400)):
        data = bytearray(whole)
        for _ in range(rng.choice((1, 1, 3))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        bad.write_bytes(data)
        usable += assert_never_silently_wrong(bad, events) > 0
        got = read(bad)
        assert got is None or got[1], "damage without a warning"
    assert usable > 3 * tries // 8


@pytest.mark.parametrize("bit", range(64))
def test_a_flipped_bit_in_the_length_of_the_record_that_no_crc_covers_is_noticed(tmp_path, bit):
    path = record(tmp_path / "m.mcap", seconds=1)
    data = bytearray(path.read_bytes())
    data_end = data.rindex(b"\x0f\x04" + bytes(7))  # opcode and length of the record that ends the data
    data[data_end + 1 + bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    assert open_recording(path).missing


def test_data_after_a_damaged_chunk_is_still_read(tmp_path):
    path = record(tmp_path / "m.mcap", seconds=3)
    data = bytearray(path.read_bytes())
    marks = [i for i in range(len(data)) if data[i : i + 8] == b"\x04\x00\x00\x00zstd"]
    data[marks[2] + 60] ^= 1
    path.write_bytes(data)
    recording = open_recording(path)
    numbers = [n for n, _, _ in recording.events()]
    assert numbers[-1] == len(mission(3)) - 1
    assert "are missing" in recording.missing and recording.seconds_missing > 0


def test_of_what_led_into_a_damaged_chunk_nothing_is_known(tmp_path):
    """Commands of a busy kernel stand behind their events: these are whole, and what they led to is lost."""
    path, late = tmp_path / "m.mcap", 30
    with RecordingWriter(path, mission_toml="a = 1\n") as writer:
        for number in range(400):
            writer.event(number, number, Tick(number))
            if number >= late:
                writer.command(number - late, number, Hold(number, "r1", "x" * 200), "kernel")
    data = bytearray(path.read_bytes())
    marks = [i for i in range(len(data)) if data[i : i + 8] == b"\x04\x00\x00\x00zstd"]
    data[marks[4] + 60] ^= 1
    path.write_bytes(data)
    recording = open_recording(path)
    assert "are missing" in recording.missing
    known = [step for step in recording.steps() if step.known]
    assert len(known) > 20 and all(step.commands for step in known)


def test_a_damaged_first_chunk_does_not_cost_the_mission(tmp_path):
    path, out = record(tmp_path / "m.mcap"), tmp_path / "out.mcap"
    data = bytearray(path.read_bytes())
    data[data.index(b"\x04\x00\x00\x00zstd") + 100] ^= 1
    path.write_bytes(data)
    recording = open_recording(path)
    assert recording.mission_toml == "a = 1\n" and "damaged" in recording.missing
    assert len(list(recording.events())) == len(mission(3))
    recover(path, out)
    mended = open_recording(out)
    assert mended.complete and mended.mission_toml == "a = 1\n"
    assert len(list(mended.events())) == len(mission(3))


def test_a_damaged_length_does_not_hide_the_chunks_it_skips(tmp_path):
    path = record(tmp_path / "m.mcap", seconds=3)
    data = bytearray(path.read_bytes())
    mark = data.index(b"\x04\x00\x00\x00zstd", 2500)
    data[mark - 36 + 2] ^= 0xFF
    path.write_bytes(data)
    assert len(list(open_recording(path).events())) > len(mission(3)) / 2


@pytest.mark.parametrize("bit", range(64))
def test_no_size_inside_a_chunk_is_believed(tmp_path, bit):
    path = record(tmp_path / "m.mcap", seconds=1)
    data = bytearray(path.read_bytes())
    # The length of the compressed data stands right after the name of the compression.
    mark = data.index(b"\x04\x00\x00\x00zstd", 2500) + 8
    data[mark + bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    assert read(path)[1]


def test_recovering_gives_a_whole_file_with_all_that_was_intact(tmp_path, recorded):
    whole = recorded.read_bytes()
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole[: len(whole) // 3])
    assert "cut" in recover(cut, out)[0]
    mended = open_recording(out)
    assert mended.complete
    before = open_recording(cut)
    assert all(map(same, mended.items(), before.items()))
    assert mended.mission_toml == before.mission_toml
    assert not list(tmp_path.glob(".*"))
    assert mended.summary()["duration_s"] == before.summary()["duration_s"]


def test_recovering_never_overwrites(tmp_path, recorded):
    with pytest.raises(RecordingError, match="exists already"):
        recover(recorded, recorded)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"\x89MCAP", "first bytes"),
        (b"a,b,c\n1,2,3\n" * 20, "not an MCAP recording"),
        (b"\x89MCAP0\r\n" + b"\xff" * 500, "beginning cannot be read"),
    ],
)
def test_what_is_no_recording_is_refused_by_name(tmp_path, content, says):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=says) as caught:
        open_recording(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(RecordingError, match="no such recording"):
        open_recording(tmp_path / "none.mcap")


def test_a_file_that_is_closed_to_us_is_refused_by_name(tmp_path, monkeypatch):
    path = record(tmp_path / "x.mcap")
    close(path, monkeypatch)
    with pytest.raises(RecordingError, match=r"x\.mcap: cannot be read: permission denied$"):
        open_recording(path)


def test_another_programs_mcap_is_refused(tmp_path):
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        other = Writer(stream)
        other.start()
        channel = other.register_channel("/t", "json", 0)
        other.add_message(channel, 1, b"{}", 1)
        other.finish()
    with pytest.raises(RecordingError, match="not a fieldkit recording"):
        open_recording(path)


def test_a_newer_schema_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(writer_module, "SCHEMA", 99)
    RecordingWriter(tmp_path / "m.mcap").close()
    with pytest.raises(RecordingError, match="newer"):
        open_recording(tmp_path / "m.mcap")


KILLED = """
import sys
from pathlib import Path
from fieldkit.messages import Hold, Tick
from fieldkit.recording import RecordingWriter
writer = RecordingWriter(Path(sys.argv[1]))
number = 0
while True:
    # A tenth of a second of mission time for each event; the number on the pipe is written down first.
    writer.event(number, number * 100_000_000, Tick(number))
    if number == int(sys.argv[2]):
        print("now", flush=True)
        sys.stdin.read()
    number += 1
"""


@pytest.mark.parametrize("last", [3, 57, 333])
def test_a_kill_loses_less_than_a_second(tmp_path, last):
    path = tmp_path / "m.mcap"
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path), str(last)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert process.stdout.readline() == b"now\n"
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    found = [(number, event) for number, _, event in open_recording(path).events()]
    assert found == [(i, Tick(i)) for i in range(len(found))]
    assert (last - (found[-1][0] if found else 0)) * 0.1 < 1.0
