"""What was recorded is what is read, in file order; other people's readers accept the file."""

import threading

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from fieldkit.errors import RecordingError
from fieldkit.messages import GoTo, Hold, Plan, Tick, Waypoint
from fieldkit.recording import RecordingWriter, open_recording
from fieldkit.recording.writer import close_chunk

from .samples import detection, estimate, mission, same


def test_events_come_back_in_inbox_order_with_their_times(recorded):
    recording = open_recording(recorded)
    assert recording.complete and recording.missing == ""
    sent = mission()
    for (number, log_ns, event), expected in zip(recording.events(), sent, strict=True):
        assert same(event, expected)
        assert log_ns == event.t_ns + 1000
        assert sent[number] is expected


def test_configuration_and_seeds_come_back(recorded):
    recording = open_recording(recorded)
    assert (recording.mission_toml, recording.antenna_toml) == ("a = 1\n", "b = 2\n")
    assert recording.metadata == {"seed": 7}


def test_one_pass_gives_everything_in_the_order_written(tmp_path):
    path = tmp_path / "m.mcap"
    plan = Plan(3, {"r1": (Waypoint(1, 2, 0.4),)}, {"r1": "search"})
    go, hold = GoTo(4, "r1", Waypoint(1, 2, 0.4)), Hold(4, "r1", "fence")
    belief = np.arange(6.0).reshape(2, 3) / 10
    with RecordingWriter(path) as writer:
        writer.event(0, 10, Tick(9))
        writer.detection(0, 10, detection())
        writer.sources(0, 10, [estimate()])
        writer.plan(0, 10, plan)
        writer.command(0, 10, go)
        writer.command(0, 10, hold, origin="safety")
        writer.belief(0, 10, belief, cell_m=0.2, origin_m=(1.0, 2.0), digest="abc", numbers={"left": 0.5})
        writer.event(1, 11, Tick(10))
        writer.note("warning", "receiver of r1 is silent", 12)
        writer.raw(13, "r1-radio", b"\x7e\x00")
        writer.result(1, 14, {"found": 1, "error_m": float("inf")})
    recording = open_recording(path)
    kinds = [item.kind for item in recording.items()]
    assert kinds == [
        *("event", "detection", "sources", "plan", "command", "command", "belief"),
        *("event", "note", "result"),
    ]
    assert [(origin, c) for _, _, origin, c in recording.commands()] == [("kernel", go), ("safety", hold)]
    assert same(next(recording.detections())[2], detection())
    assert same(next(recording.sources())[2], [estimate()])
    assert next(recording.plans())[2] == plan
    assert next(recording.digests())[2].digest == "abc"
    assert recording.result() == {"found": 1, "error_m": "inf"}
    grid = next(recording.beliefs())
    np.testing.assert_allclose(grid.values, belief, rtol=1e-7)
    assert (grid.cell_m, grid.origin_m) == (0.2, (1.0, 2.0))


def test_the_librarys_own_reader_accepts_the_file_and_knows_the_schemas(recorded):
    with recorded.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        names = {schema.name for schema in summary.schemas.values()}
        assert {"foxglove.PoseInFrame", "foxglove.LocationFix", "foxglove.FrameTransform"} <= names
        assert {"foxglove.SceneUpdate", "fieldkit.RssReading"} <= names
        fixes = [m for _, _, _, m in reader.iter_decoded_messages(topics=["/view/fix/r1"])]
        assert abs(fixes[0].latitude - 48.0) < 1e-4
        assert {"mission.toml", "antenna.toml"} <= {a.name for a in reader.iter_attachments()}
        assert summary.statistics.message_count == sum(open_recording(recorded).summary()["counts"].values())


def test_a_recording_is_never_overwritten(recorded):
    with pytest.raises(RecordingError, match="never overwritten"):
        RecordingWriter(recorded)


def test_times_outside_what_mcap_can_hold_do_not_stop_the_recording(tmp_path):
    with RecordingWriter(tmp_path / "m.mcap") as writer:
        writer.event(0, 5, Tick(-3))
    assert [event for _, _, event in open_recording(tmp_path / "m.mcap").events()] == [Tick(-3)]


def test_the_library_still_has_the_chunk_finaliser_we_depend_on(tmp_path):
    with (tmp_path / "m.mcap").open("wb", buffering=0) as stream:
        writer = Writer(stream)
        writer.start()
        channel = writer.register_channel("/t", "json", 0)
        before = stream.tell()
        writer.add_message(channel, 1, b"{}", 1)
        assert stream.tell() == before
        close_chunk(writer)
        assert stream.tell() > before


def test_a_full_disk_ends_the_recording_not_the_mission(tmp_path, caplog):
    writer = RecordingWriter(tmp_path / "m.mcap")
    writer.event(0, 1, Tick(1))
    writer.flush()

    class Full:
        def __getattr__(self, name):
            raise OSError(28, "No space left on device")

    writer._mcap._Writer__stream = Full()
    for number in range(1, 600):  # a minute: nothing is said of its clock either, which stands still
        writer.event(number, number * 100_000_000, Tick(number))
    writer.close()
    assert "No space left" in writer.failure
    assert len(caplog.records) == 1
    assert [n for n, _, _ in open_recording(tmp_path / "m.mcap").events()] == [0]


def test_a_disk_that_stalls_does_not_stall_the_mission(tmp_path, monkeypatch):
    stalls, synced = threading.Event(), []

    def fsync(descriptor):
        assert stalls.wait(10.0)
        synced.append(descriptor)

    monkeypatch.setattr("fieldkit.recording.disk.os.fsync", fsync)
    stalls.set()
    writer = RecordingWriter(tmp_path / "m.mcap")
    writer._disk.wait()
    stalls.clear()
    synced.clear()
    for number in range(600):  # a minute, and a note every second
        writer.event(number, number * 100_000_000, Tick(number))
        if number % 10 == 0:
            writer.flush()
    assert not synced and [n for n, _, _ in open_recording(tmp_path / "m.mcap").events()][-1] >= 590
    stalls.set()
    writer.result(599, 60_000_000_000, {"end_reason": "done"})
    assert len(synced) in (2, 3), "one that was under way, one that waited, and one for the result"
    writer.close()


def test_a_disk_that_fails_later_ends_the_recording_not_the_mission(tmp_path, monkeypatch):
    writer = RecordingWriter(tmp_path / "m.mcap")
    writer._disk.wait()

    def fails(descriptor):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("fieldkit.recording.disk.os.fsync", fails)
    writer.result(0, 1, {})
    writer.event(1, 2, Tick(2))
    writer.close()
    assert "Input/output error" in writer.failure


def test_a_disk_getting_full_costs_the_raw_bytes_first(tmp_path, caplog, monkeypatch):
    monkeypatch.setattr("fieldkit.recording.writer.LOW_BYTES", 2**62)
    with RecordingWriter(tmp_path / "m.mcap") as writer:
        writer.flush()
        writer.raw(1, "r1-radio", b"\x7e")
        writer.event(0, 1, Tick(1))
    counts = open_recording(tmp_path / "m.mcap").summary()["counts"]
    assert "/raw/r1-radio" not in counts and counts["/in/tick"] == 1
    assert [record.levelname for record in caplog.records] == ["WARNING"]
