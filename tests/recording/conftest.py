from pathlib import Path

import pytest

from fieldkit.geo import FieldFrame
from fieldkit.recording import RecordingWriter

from .samples import detection, estimate, mission


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A small complete recording of three seconds."""
    return record(tmp_path / "mission.mcap")


def record(path: Path, seconds: int = 3, close: bool = True) -> Path:
    frame = FieldFrame(48.0, 11.0)
    writer = RecordingWriter(
        path, mission_toml="a = 1\n", antenna_toml="b = 2\n", metadata={"seed": 7}, frame=frame
    )
    for number, event in enumerate(mission(seconds)):
        writer.event(number, event.t_ns + 1000, event)
    writer.detection(number, event.t_ns + 1000, detection())
    writer.sources(number, event.t_ns + 1000, [estimate()])
    if close:
        writer.close()
    return path
