"""Writing files whole or not at all."""

import errno
import os
import tempfile
from pathlib import Path

from fieldkit.errors import ConfigError, NotWritten

RECORDING = b"\x89MCAP"
"""A recording begins so. It cannot be had again, so nothing is ever written over it."""


def is_stream(path: Path) -> bool:
    """Whether a path is a pipe or a device: whoever reads one that nobody writes into waits for ever."""
    try:
        return path.exists() and not (path.is_file() or path.is_dir())
    except OSError:  # whoever opens it says why
        return False


def keep_apart(read: Path, *written: Path | None) -> None:
    """Raises `ConfigError` where a command would write over what it reads, or one of its files over another."""
    taken = {_there(read): "what is read"}
    for path in written:
        if path is None or (path.exists() and not path.is_file()):  # /dev/stdout may be both
            continue
        if over := taken.get(_there(path)):
            raise ConfigError(f"{path}: would be written over {over}; name another file")
        taken[_there(path)] = "another of its files"


def _there(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # links that go in a circle; whoever opens it says so
        return path


def write_whole(path: Path, content: str | bytes) -> None:
    """Write `content` to `path` so that a reader sees the old file or the new one, never a part of one.

    Devices and pipes (/dev/stdout) are written to as they are. A recording is never replaced. Raises `NotWritten`,
    naming file and reason.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    try:
        if path.exists() and not path.is_file():
            with path.open("wb") as stream:
                stream.write(data)
            return
        if path.exists() and _is_recording(path):
            raise FileExistsError(errno.EEXIST, "a recording is there")
        path.parent.mkdir(parents=True, exist_ok=True)
        _replace(path, data)
    except OSError as error:
        raise NotWritten(path, error) from error


def _is_recording(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(len(RECORDING)) == RECORDING
    except PermissionError:  # nobody can tell; its folder decides
        return False


def _replace(path: Path, data: bytes) -> None:
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name[:100]}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        Path(name).chmod(0o644)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
