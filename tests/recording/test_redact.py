"""A redacted recording tells nothing it should not, and everything it should."""

import json
import tomllib

import pytest

from fieldkit.errors import RecordingError
from fieldkit.messages import RssReading, Tick, VehicleState
from fieldkit.recording import RecordingWriter, open_recording, recover
from fieldkit.recording.records import Contents, walk
from fieldkit.recording.redact import redact

MISSION = """
schema = 1
[field]
origin_lat_deg = 47.3977  # behind the barn
origin_lon_deg = 8.5456
size_east_m = 10.0
background = "secret valley.mbtiles"
[maps]
cot = ["tcp://secret.local:8087"]
[[robot]]
name = "r1"
receiver = { driver = "xbee", port = "/dev/ttySECRET" }
vehicle = { driver = "mavlink", address = "udpin:secret-host:14550", system_id = 1 }
"""


def make(path):
    more = {"background": "/home/secret/valley.mbtiles"}
    with RecordingWriter(path, mission_toml=MISSION, antenna_toml="schema = 1\n", metadata=more) as writer:
        writer.raw(1, "xbee", b"secret bytes")
        writer.attach("secret.txt", b"secret")
        writer.event(1, 1, RssReading(1, "r1", -60.0, frame_id="secret-address:1"))
        writer.event(2, 2, RssReading(2, "r2", -61.0, frame_id="secret-address:1"))
        writer.event(3, 3, RssReading(3, "r1", -62.0, frame_id="secret-address:2"))
        writer.event(4, 4, VehicleState(4, "r1", "guided", True, text="secret firmware"))
        writer.event(5, 5, Tick(5))
        writer.note("warning", "secret device failed")
        writer.note("info", "found source 1")
    return path


def test_nothing_secret_is_left_anywhere_in_the_file(tmp_path):
    out = tmp_path / "out.mcap"
    count = redact(make(tmp_path / "m.mcap"), out)
    contents = Contents()
    texts = [message.data + channel.topic.encode() for channel, message in walk(out, contents)]
    texts += [attachment.data for attachment in contents.attachments]
    everything = b"".join(texts) + out.read_bytes()
    assert b"ecret" not in everything.replace(b"SECRET", b"ecret") and b"47.3977" not in everything
    assert b"barn" not in everything and count["addresses"] == 3 and count["raw_messages"] == 1


def test_frames_that_were_the_same_still_are_and_numbers_stay(tmp_path):
    out = tmp_path / "out.mcap"
    redact(make(tmp_path / "m.mcap"), out)
    recording = open_recording(out)
    assert recording.complete
    readings = [e for _, _, e in recording.events() if isinstance(e, RssReading)]
    assert readings[0].frame_id == readings[1].frame_id != readings[2].frame_id
    assert [r.rss_dbm for r in readings] == [-60.0, -61.0, -62.0]
    field = tomllib.loads(recording.mission_toml)["field"]
    assert field == {"origin_lat_deg": 0.0, "origin_lon_deg": 0.0, "size_east_m": 10.0}
    assert [note.text for _, note in recording.notes()] == ["redacted", "found source 1"]


def test_the_place_is_kept_on_request(tmp_path):
    out = tmp_path / "out.mcap"
    redact(make(tmp_path / "m.mcap"), out, keep_place=True)
    assert tomllib.loads(open_recording(out).mission_toml)["field"]["origin_lat_deg"] == 47.3977
    assert json.dumps(open_recording(out).mission_toml).count("ecret") == 0


@pytest.mark.parametrize("rewritten", [redact, recover])
def test_the_folder_of_a_run_is_named_as_well_as_its_recording(tmp_path, rewritten):
    (tmp_path / "run").mkdir()
    make(tmp_path / "run/mission.mcap")
    rewritten(tmp_path / "run", tmp_path / "out.mcap")
    assert open_recording(tmp_path / "out.mcap").complete
    with pytest.raises(RecordingError, match=r"no such recording; name the mission\.mcap"):
        rewritten(tmp_path / "none.mcap", tmp_path / "other.mcap")
