"""Readers written by others accept our files: the reference library, and two that share no code with it."""

import json
from collections import Counter
from importlib import resources

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pybag.mcap.record_reader import McapRecordReaderFactory
from small_mcap import get_summary, read_message

from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose
from fieldkit.recording import RecordingWriter, recover
from fieldkit.recording.records import Contents, walk

from .samples import detection, estimate, mission


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "mission.mcap"
    with RecordingWriter(path, mission_toml="a = 1\n", frame=FieldFrame(48.0, 11.0)) as writer:
        for number, event in enumerate(mission(3)):
            writer.event(number, event.t_ns, event)
        writer.detection(number, event.t_ns, detection())
        writer.sources(number, event.t_ns, [estimate()])
        writer.raw(event.t_ns, "xbee", b"\x7e\x00\x01")
        writer.note("info", "a note")
    return path


def ours(path):
    return Counter((c.topic, m.sequence, m.log_time, m.data) for c, m in walk(path, Contents()))


def by_reference(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        return Counter((c.topic, m.sequence, m.log_time, m.data) for _, c, m in reader.iter_messages())


def by_small_mcap(path):
    with path.open("rb") as stream:
        found = read_message(stream, validate_crc=True)
        return Counter((c.topic, m.sequence, m.log_time, bytes(m.data)) for _, c, m in found)


def by_pybag(path):
    with McapRecordReaderFactory.from_file(path, enable_crc_check=True) as reader:
        topics = {number: channel.topic for number, channel in reader.get_channels().items()}
        found = reader.get_messages(in_log_time_order=False)
        return Counter((topics[m.channel_id], m.sequence, m.log_time, bytes(m.data)) for m in found)


READERS = [by_reference, by_small_mcap, by_pybag]


@pytest.mark.parametrize("read", READERS)
def test_an_independent_reader_finds_every_message(path, read):
    assert read(path) == ours(path)


@pytest.mark.parametrize("read", READERS)
def test_an_independent_reader_finds_every_message_of_a_recovered_file(path, tmp_path, read):
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    data = path.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    recover(cut, out)
    assert read(out) == ours(out) and ours(out)


def test_the_index_agrees_with_the_messages(path):
    with path.open("rb") as stream:
        summary = get_summary(stream)
    counts = {summary.channels[n].topic: c for n, c in summary.statistics.channel_message_counts.items()}
    assert counts == Counter(topic for topic, *_ in ours(path).elements())


def test_viewers_get_foxglove_messages_by_their_names(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        shown = [topic for (topic,) in topics(path) if topic.startswith(("/view", "/tf"))]
        found = {
            (schema.name, channel.topic): message
            for schema, channel, _, message in reader.iter_decoded_messages(topics=shown)
            if schema is not None and schema.encoding == "protobuf"
        }
    names = {name for name, _ in found}
    assert names == {
        f"foxglove.{n}" for n in ("PoseInFrame", "FrameTransform", "LocationFix", "SceneUpdate", "Log")
    }
    pose = next(e for e in reversed(mission(3)) if isinstance(e, Pose) and e.robot == "r1")
    shown = found["foxglove.PoseInFrame", "/view/pose/r1"].pose.position
    assert abs(shown.x - pose.east_m) < 0.11 and abs(shown.y - pose.north_m) < 0.4


def test_the_layout_shows_topics_that_recordings_have(path):
    layout = json.loads((resources.files("fieldkit.recording") / "lichtblick-layout.json").read_text())
    panels = layout["configById"]
    wanted = set(panels["3D!field"]["topics"]) | {panels["RosOut!log"]["topicToRender"]}
    wanted |= {
        p["value"].split(".")[0] for name in panels if name.startswith("Plot") for p in panels[name]["paths"]
    }
    wanted.add(panels["RawMessages!sources"]["topicPath"])
    with RecordingWriter(path.with_name("more.mcap")) as writer:
        writer.belief(1, 5, detection().position_m)
    assert wanted <= {topic for p in (path, path.with_name("more.mcap")) for topic, *_ in topics(p)}

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)


def topics(path):
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    return [(channel.topic,) for channel in summary.channels.values()]
