"""The mission's notebook: one MCAP file, complete, safe and open to other tools.

Names are imported on first use: `fieldkit --help` looks into this package and should not wait for numpy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fieldkit.recording.reader import BeliefGrid, Item, Recording, open_recording
    from fieldkit.recording.salvage import recover
    from fieldkit.recording.writer import RecordingWriter

__all__ = ["BeliefGrid", "Item", "Recording", "RecordingWriter", "open_recording", "recover"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    home = {"recover": "salvage", "RecordingWriter": "writer"}.get(name, "reader")
    return getattr(import_module(f"{__name__}.{home}"), name)
