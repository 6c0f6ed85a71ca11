"""Find unknown, short-lived radio transmitters with a team of small robots."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # nobody should wait for numpy to read the version
    from pathlib import Path

    from fieldkit.recording.log import Log

__version__ = "0.1.0"


def open_log(path: "Path | str") -> "Log":
    """A mission's recording for notebooks: readings, poses, detections as numpy arrays, beliefs by time.

    Raises `RecordingError` for what is not a recording.
    """
    from fieldkit.recording.log import open_log as open_it

    return open_it(path)
