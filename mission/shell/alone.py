"""One agent of a robot on one computer: a second one is told so before it asks for a port that the first one has."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fieldkit.errors import ConfigError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def alone(robot: str, team: str, folder: Path | None = None) -> Iterator[None]:
    """Nobody else on this computer is in here for this robot of this team. Raises `ConfigError` where one is.

    The system lets go of the lock however the process ends. Where there is none nobody is kept out: others on the
    network are still asked (`mission.shell.look_round`).
    """
    path = Path(tempfile.gettempdir() if folder is None else folder) / f"fieldkit-agent-{team}-{robot}.lock"
    lock = _opened(path)
    try:
        if lock is not None and not _locked(lock):
            raise ConfigError(
                f"an agent for {robot} already runs on this computer{_who(lock)}: end that one first; nothing was "
                "touched by this one"
            )
        yield
    finally:
        if lock is not None:
            os.close(lock)


def _opened(path: Path) -> int | None:
    if fcntl is None:
        return None
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError:  # somebody else's file, or no room for one
        return None


def _locked(lock: int) -> bool:
    """Whether nobody else had it; it says then who has."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without locks
        return True
    try:
        os.ftruncate(lock, 0)
        os.pwrite(lock, str(os.getpid()).encode(), 0)
    except OSError:  # a full disk
        pass
    return True


def _who(lock: int) -> str:
    said = os.pread(lock, 20, 0).decode("ascii", "replace")
    return f" (process {said})" if said.isdecimal() else ""
