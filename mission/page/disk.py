"""What a page says of the recording under way: how large, and how much room is left."""

import shutil
from pathlib import Path

from fieldkit.clock import wall_s
from fieldkit.recording.writer import EARLY_BYTES

LOOK_EVERY_S = 5.0
"""A disk is asked no oftener."""


class DiskWords:
    """For the recording at `path`; words are made anew every few seconds."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._said = ""
        self._looked_s = -LOOK_EVERY_S

    def now(self) -> str:
        """A few words; a warning where the disk is nearly full."""
        if wall_s() - self._looked_s >= LOOK_EVERY_S:
            self._looked_s = wall_s()
            self._said = self._look()
        return self._said

    def _look(self) -> str:
        try:
            written, free = self._path.stat().st_size, shutil.disk_usage(self._path.parent).free
        except OSError as error:
            return f"the recording cannot be seen: {error.strerror}"
        if free < EARLY_BYTES:
            return f"DISK NEARLY FULL: {sized(free)} left"
        return f"recording, {sized(written)}; {sized(free)} left"


def sized(count: float) -> str:
    """A number of bytes as people say it."""
    for unit in ("B", "kB", "MB"):
        if count < 1000.0:
            return f"{count:.0f} {unit}"
        count /= 1000.0
    return f"{count:.0f} GB" if count >= 10.0 else f"{count:.1f} GB"
