"""Recordings of robots that logged apart become one, on one clock that their shared receptions tell."""

import numpy as np
import pytest

from fieldkit.errors import DataError, RecordingError
from fieldkit.messages import Pose, RssReading
from fieldkit.recording import RecordingWriter, open_recording
from fieldkit.recording.merge import merge
from fieldkit.recording.offsets import estimate_offset

FIELD = "[field]\norigin_lat_deg = 48.0\norigin_lon_deg = 11.0\nsize_east_m = 10.0\nsize_north_m = 10.0\n"
START_NS = 1_700_000_000_000_000_000


def record(path, robot, shift_s, *, frames=False, toml=FIELD, seed=1, heard=True):
    """A minute of one robot: poses at 2 Hz and the packets of one source, of which a fifth are missed."""
    sent_s = np.cumsum(np.random.default_rng(seed).exponential(1.0, 60))
    missed = np.random.default_rng([seed, ord(robot[-1])])
    events = [Pose(START_NS + round((k / 2 + shift_s) * 1e9), robot, 0.1 * k, 1.0) for k in range(120)]
    for number, t_s in enumerate(sent_s):
        if heard and missed.random() > 0.2:
            jitter_s = missed.normal(0.0, 0.002)
            t_ns = START_NS + round((t_s + shift_s + jitter_s) * 1e9)
            events.append(RssReading(t_ns, robot, -60.0, frame_id=f"a:{number}" if frames else None))
    events.sort(key=lambda event: event.t_ns)
    with RecordingWriter(path, mission_toml=toml) as writer:
        for number, event in enumerate(events):
            writer.event(number, event.t_ns, event)
    return path


@pytest.mark.parametrize("frames", [True, False])
@pytest.mark.parametrize("shift_s", [0.0, 7.25, -123.4])
def test_shared_receptions_tell_the_clock_offset(tmp_path, frames, shift_s):
    paths = [
        record(tmp_path / "r1.mcap", "r1", 0.0, frames=frames),
        record(tmp_path / "r2.mcap", "r2", shift_s, frames=frames),
    ]
    done = merge(paths, tmp_path / "all.mcap")
    offset = done.offsets[str(paths[1])]
    assert offset.seconds == pytest.approx(-shift_s, abs=0.005)
    assert abs(offset.seconds + shift_s) < 5.0 * offset.sigma_s
    assert offset.by == ("frames" if frames else "rhythm") and offset.shared > 20
    recording = open_recording(tmp_path / "all.mcap")
    assert recording.complete and recording.metadata["merged"]["r2.mcap"]["seconds"] == offset.seconds
    times = [event.t_ns for _, _, event in recording.events()]
    assert times == sorted(times)
    assert {event.robot for _, _, event in recording.events() if isinstance(event, Pose)} == {"r1", "r2"}


def test_unrelated_receptions_tell_nothing_and_nothing_is_written(tmp_path):
    paths = [record(tmp_path / f"r{k}.mcap", f"r{k}", 0.0, seed=k) for k in (1, 2)]
    with pytest.raises(DataError, match=r"--offset r2\.mcap=SECONDS"):
        merge(paths, tmp_path / "all.mcap")
    assert not list(tmp_path.glob("*all*"))
    assert merge(paths, tmp_path / "all.mcap", given_s={"r2": 1.5}).offsets[str(paths[1])].seconds == 1.5


def test_a_regular_beat_is_not_taken_for_a_rhythm():
    beat = [RssReading(k * 1_000_000_000, "r1", -60.0) for k in range(60)]
    assert estimate_offset(beat, [RssReading(r.t_ns + 250_000_000, "r2", -60.0) for r in beat]) is None


def test_another_field_is_refused(tmp_path):
    paths = [
        record(tmp_path / "r1.mcap", "r1", 0.0),
        record(tmp_path / "r2.mcap", "r2", 0.0, toml=FIELD.replace("48.0", "49.0")),
    ]
    with pytest.raises(DataError, match=r"another field.*origin_lat_deg 48\.0 and 49\.0"):
        merge(paths, tmp_path / "all.mcap")
    assert not list(tmp_path.glob("*all*"))


def test_a_robot_in_two_recordings_is_refused(tmp_path):
    paths = [record(tmp_path / f"{k}.mcap", "r1", 0.0) for k in (1, 2)]
    with pytest.raises(DataError, match="robot 'r1'"):
        merge(paths, tmp_path / "all.mcap")


def test_positions_come_from_another_programs_log(tmp_path):
    first = record(tmp_path / "r1.mcap", "r1", 0.0)
    walk = tmp_path / "r9.gpx"
    walk.write_text(
        '<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
        '<trkpt lat="48.0" lon="11.0"><time>2023-11-14T22:13:30Z</time></trkpt>'
        '<trkpt lat="48.00001" lon="11.0"><time>2023-11-14T22:13:31Z</time></trkpt>'
        "</trkseg></trk></gpx>"
    )
    merge([first, walk], tmp_path / "all.mcap")
    poses = [e for _, _, e in open_recording(tmp_path / "all.mcap").events() if isinstance(e, Pose)]
    walked = [pose for pose in poses if pose.robot == "r9"]
    assert [pose.north_m for pose in walked] == pytest.approx([0.0, 1.112], abs=0.01)


def test_a_telemetry_log_gives_poses_too(tmp_path):
    """A MAVLink .tlog: each packet behind its time in microseconds, as ground stations write it."""
    from pymavlink.dialects.v20 import ardupilotmega

    first = record(tmp_path / "r1.mcap", "r1", 0.0)
    sender = ardupilotmega.MAVLink(None, srcSystem=9, srcComponent=1)
    flight = b""
    for k in range(4):
        north_deg = 48.0 + 1e-5 * k
        packet = sender.global_position_int_encode(
            1000 * k, round(north_deg * 1e7), round(11.0 * 1e7), 500_000, 2_000, 0, 0, 0, 9_000
        ).pack(sender)
        flight += (START_NS // 1000 + 1_000_000 * k).to_bytes(8, "big") + packet
    (tmp_path / "r9.tlog").write_bytes(flight)
    done = merge([first, tmp_path / "r9.tlog"], tmp_path / "all.mcap", given_s={"r9": 0.5})
    assert done.robots == ("r1", "r9")
    flown = [
        e
        for _, _, e in open_recording(tmp_path / "all.mcap").events()
        if isinstance(e, Pose) and e.robot == "r9"
    ]
    assert [pose.north_m for pose in flown] == pytest.approx([0.0, 1.112, 2.224, 3.336], abs=0.02)
    assert [pose.t_ns for pose in flown] == [START_NS + 500_000_000 + k * 1_000_000_000 for k in range(4)]
    assert {(pose.heading_deg, pose.up_m) for pose in flown} == {(90.0, 2.0)}


def test_positions_of_another_year_are_refused_and_those_long_before_are_left_out(tmp_path):
    """A flight controller's clock may begin in 1970: tick by tick to there would take all memory."""
    first = record(tmp_path / "r1.mcap", "r1", 0.0)
    head = "time,east_m,north_m\n"
    rows = "".join(f"{START_NS * 1e-9 + 1 + k},1.0,2.0\n" for k in range(3))
    (tmp_path / "r9.csv").write_text(head + "1000.0,1.0,2.0\n")
    with pytest.raises(DataError, match=r"before them.*--offset r9.csv=SECONDS"):
        merge([first, tmp_path / "r9.csv"], tmp_path / "all.mcap")
    assert not (tmp_path / "all.mcap").exists()
    (tmp_path / "r8.csv").write_text(f"{head}{START_NS * 1e-9 - 90_000},1.0,2.0\n{rows}")
    merge([first, tmp_path / "r8.csv"], tmp_path / "all.mcap")
    poses = [e for _, _, e in open_recording(tmp_path / "all.mcap").events() if isinstance(e, Pose)]
    assert sum(pose.robot == "r8" for pose in poses) == 3


def test_a_recording_given_twice_is_refused(tmp_path):
    path = record(tmp_path / "r1.mcap", "r1", 0.0)
    with pytest.raises(DataError, match="is given twice"):
        merge([path, path], tmp_path / "all.mcap")


def test_merging_never_overwrites(tmp_path):
    paths = [record(tmp_path / f"r{k}.mcap", f"r{k}", 0.0) for k in (1, 2)]
    with pytest.raises(RecordingError, match="exists already"):
        merge(paths, paths[0])
