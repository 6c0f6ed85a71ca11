"""Long recordings in parts, clocks that step, disks that fill: nothing is lost silently, nothing stalls."""

import shutil
import subprocess
import sys
from collections import namedtuple

import pytest

from fieldkit.messages import Pose, Tick
from fieldkit.recording import RecordingWriter, open_recording
from fieldkit.recording import writer as writer_module
from fieldkit.recording.salvage import recover

from .samples import mission, same

S = 1_000_000_000


def rotated(path, seconds=30):
    with RecordingWriter(path, mission_toml="a = 1\n", rotate_bytes=15_000) as writer:
        for number, event in enumerate(mission(seconds)):
            writer.event(number, event.t_ns, event)
        writer.result(number, event.t_ns, {"end_reason": "done"})
    return path


def test_parts_are_read_as_one_recording(tmp_path):
    path = rotated(tmp_path / "m.mcap")
    recording = open_recording(path)
    assert len(recording.parts) > 2 and recording.complete and not recording.missing
    assert all(map(same, (event for _, _, event in recording.events()), mission(30)))
    assert recording.result() == {"end_reason": "done"}
    said = recording.summary()
    assert said["counts"]["/in/pose"] == 600 and said["duration_s"] == pytest.approx(29.9)
    assert said["bytes"] == sum(part.stat().st_size for part in tmp_path.iterdir())


def test_a_cut_last_part_and_a_lost_middle_one_are_named(tmp_path):
    path = rotated(tmp_path / "m.mcap")
    *_, last = open_recording(path).parts
    last.write_bytes(last.read_bytes()[:5000])
    assert f"{last.name}: cut" in open_recording(path).missing
    second = open_recording(path).parts[1]
    second.write_bytes(second.read_bytes()[:7000])
    recording = open_recording(path)
    assert "are missing" in recording.missing and recording.seconds_missing > 0


def test_a_later_part_alone_says_what_it_is(tmp_path):
    later = open_recording(rotated(tmp_path / "m.mcap")).parts[1]
    recording = open_recording(later)
    assert not recording.complete and "is part 2" in recording.missing
    assert len(list(recording.events())) > 0


def test_another_recordings_part_is_not_taken_for_ours(tmp_path):
    path = rotated(tmp_path / "m.mcap")
    other = rotated(tmp_path / "other" / "m.mcap")
    shutil.copy(open_recording(other).parts[1], open_recording(path).parts[1])
    recording = open_recording(path)
    assert len(recording.parts) == 1 and not recording.complete
    assert "m.2.mcap is of another recording" in recording.missing


@pytest.mark.parametrize("left", [b"", b"\x89MCAP0\r\n", None])
def test_a_part_that_cannot_be_read_is_named(tmp_path, left):
    path = rotated(tmp_path / "m.mcap")
    second = open_recording(path).parts[1]
    second.unlink() if left is None else second.write_bytes(left)
    recording = open_recording(path)
    assert not recording.complete and "m.2.mcap cannot be read" in recording.missing


def test_a_recording_in_parts_becomes_one_file_again(tmp_path):
    path, out = rotated(tmp_path / "m.mcap"), tmp_path / "out.mcap"
    assert recover(path, out) == []
    recording = open_recording(out)
    assert recording.complete and recording.parts == [out]
    assert all(map(same, (event for _, _, event in recording.events()), mission(30)))
    assert len(list(recording.events())) == len(mission(30)) and recording.result() == {"end_reason": "done"}


def test_recovering_names_the_part_that_is_damaged(tmp_path):
    path = rotated(tmp_path / "m.mcap")
    second = open_recording(path).parts[1]
    second.write_bytes(second.read_bytes()[:7000])
    assert "m.2.mcap: cut" in recover(path, tmp_path / "out.mcap")[0]


def test_each_part_can_be_recovered(tmp_path):
    later = open_recording(rotated(tmp_path / "m.mcap")).parts[1]
    recover(later, tmp_path / "out.mcap")
    assert open_recording(tmp_path / "out.mcap").mission_toml == "a = 1\n"


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_a_clock_that_steps_is_noted_and_chunks_are_still_closed(tmp_path, step_s, monkeypatch):
    path = tmp_path / "m.mcap"
    writer = RecordingWriter(path, start_ns=10_000 * S)
    times = [10_000 * S + k * S // 10 for k in range(50)]
    times += [t + 5 * S + step_s * S for t in times]
    for number, t_ns in enumerate(times):
        writer.event(number, t_ns, Pose(t_ns, "r1", 1.0, 2.0))
    # Not closed: what a kill would leave.
    recording = open_recording(path)
    got = [log_ns for _, log_ns, _ in recording.events()]
    assert got == times[: len(got)] and times[-1] - got[-1] < S
    assert any("the clock stepped" in note.text for _, note in recording.notes())
    shown = recording.summary()["counts"]["/view/pose/r1"]
    assert shown > 40
    writer.close()


def test_little_space_is_said_early_and_costs_raw_bytes_first(tmp_path, monkeypatch):
    free = 1_900_000_000
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(writer_module.shutil, "disk_usage", lambda _: usage(1, 1, free))
    path = tmp_path / "m.mcap"
    with RecordingWriter(path) as writer:
        for second in range(40):
            free = 1_900_000_000 if second < 20 else 100_000_000
            writer.event(second, second * S, Tick(second))
            writer.raw(second * S, "xbee", b"x")
    recording = open_recording(path)
    assert recording.complete
    said = [note.text for _, note in recording.notes()]
    assert (
        "below 500 MB raw bytes will no longer" in said[0] and "raw bytes are no longer recorded" in said[1]
    )
    assert len(said) == 2
    counts = recording.summary()["counts"]
    assert counts["/in/tick"] == 40 and 20 <= counts["/raw/xbee"] < 30


FULL = """
import resource, signal, sys
from pathlib import Path
from fieldkit.messages import Pose
from fieldkit.recording import RecordingWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, 60_000))
writer = RecordingWriter(Path(sys.argv[1]))
for number in range(20_000):
    writer.event(number, number * 50_000_000, Pose(number, "r1", number / 7, number / 3))
writer.close()
print(writer.failure)
"""


def test_a_full_disk_ends_the_recording_not_the_mission(tmp_path):
    path = tmp_path / "m.mcap"
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and "recording stopped" in done.stdout
    found = [number for number, _, _ in open_recording(path).events()]
    assert found == list(range(len(found))) and len(found) > 100
