"""The mission's notebook: one MCAP file, complete, safe and open to other tools."""

from fieldkit.recording.reader import BeliefGrid, Item, Recording, open_recording
from fieldkit.recording.salvage import recover
from fieldkit.recording.writer import RecordingWriter

__all__ = ["BeliefGrid", "Item", "Recording", "RecordingWriter", "open_recording", "recover"]
