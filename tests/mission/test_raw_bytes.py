"""Raw bytes of the radios in the recording, where the mission file asks for them: as they came, and replayed alike."""

from pathlib import Path

from fieldkit.messages import RssReading
from fieldkit.recording import open_recording
from fieldkit.recording.records import Contents, walk
from mission.core.mission_file import read_mission
from mission.lab.synthetic import hidden_sources, small_mission
from mission.replay.replay import replay
from mission.shell import setups
from mission.shell.flight import fly


def recorded(folder: Path, more: str) -> Path:
    small_mission(folder, duration_s=40.0, robots=2, sources_found=99)
    file = folder / "mission.toml"
    file.write_text(file.read_text() + more)
    mission = read_mission(file)
    with setups.emulated(mission, hidden_sources(1), seed=1, rate=4.0) as setup:
        fly(mission, setup, folder / "mission.mcap")
    return folder / "mission.mcap"


def test_every_reading_is_in_the_raw_bytes_of_its_radio(tmp_path: Path) -> None:
    log = recorded(tmp_path, "\n[recording]\nraw = true\n")
    raw = {"r1": b"", "r2": b""}
    for channel, message in walk(log, Contents(), {"/raw/r1", "/raw/r2"}):
        raw[channel.topic.removeprefix("/raw/")] += message.data
    readings = [event for _, _, event in open_recording(log).events() if isinstance(event, RssReading)]
    assert readings
    for reading in readings:
        # An API frame begins with 0x7E and holds the strength as the byte -dBm (Digi manual, frames 0x80 and 0x81).
        assert b"\x7e" in raw[reading.robot] and bytes([round(-reading.rss_dbm)]) in raw[reading.robot]
    assert replay(log).complete


def test_nothing_raw_is_kept_unasked(tmp_path: Path) -> None:
    counts = open_recording(recorded(tmp_path, "")).summary()["counts"]
    assert not [topic for topic in counts if topic.startswith("/raw/")]
