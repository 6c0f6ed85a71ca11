"""Every error fieldkit raises on purpose.

FieldkitError
 +-- ConfigError (ValueError)           a file or option says something impossible: nothing has moved
 +-- DataError (ValueError)             readings or a recording cannot be used as asked
 |    +-- RecordingError                a recording is damaged, from a newer schema, or not one
 |    +-- ReplayMismatch                replaying gave another result than was recorded
 +-- CalibrationRefused (ValueError)    the data cannot carry the calibration asked of it
 +-- NotWritten (OSError)               a file cannot be written where it was asked for
 +-- DeviceError (OSError)              a radio, vehicle or camera
      +-- DeviceTimeout (TimeoutError)  it did not answer in time
      +-- VehicleRefused                it answered no

A message names the thing, what was expected, what came, and what to try. Commands print it and exit with code 2
(`ReplayMismatch`: 1).
"""

import errno
from typing import Any, ClassVar


class FieldkitError(Exception):
    """The root: catch this at the outermost layer only."""

    exit_code = 2


class ConfigError(FieldkitError, ValueError):
    """A configuration file or an option: names file, key path, what was expected and what was there."""


class DataError(FieldkitError, ValueError):
    """Readings or a recording cannot be used as asked."""


class RecordingError(DataError):
    """A recording is damaged beyond use, from a newer schema, or not a recording."""


class ReplayMismatch(DataError):
    """Replaying a recording gave another result than was recorded; names the first event that differs."""

    exit_code = 1


class CalibrationRefused(FieldkitError, ValueError):
    """The data cannot carry the calibration asked of it; says why and what to collect."""


def os_words(error: Exception) -> str:
    """Why the operating system refused something, without its number and the path that stands beside it."""
    why = error.strerror if isinstance(error, OSError) else None
    return why.lower() if why else str(error)


class NotWritten(FieldkitError, OSError):
    """A file cannot be written: names it, why, and what to do."""

    REMEDIES: ClassVar = {
        errno.ENOSPC: "make room, or write to another disk",
        errno.EDQUOT: "make room, or write to another disk",
        errno.EACCES: "write to a folder of yours",
        errno.EPERM: "write to a folder of yours",
        errno.EROFS: "this disk is read-only: write to another",
        errno.EEXIST: "name another file",
        errno.EISDIR: "it is a folder: name a file in it",
        errno.ENOTDIR: "a part of that path is a file: name another",
        errno.ENAMETOOLONG: "give it a shorter name",
    }

    def __init__(self, path: object, error: OSError) -> None:
        remedy = self.REMEDIES.get(error.errno or 0, "write to another folder")
        super().__init__(f"{path}: cannot be written ({os_words(error)}); {remedy}")
        self._made_of = path, error

    def __reduce__(self) -> tuple[Any, ...]:  # it travels from worker processes
        return type(self), self._made_of


class DeviceError(FieldkitError, OSError):
    """A radio, vehicle or camera is missing, busy, broken or the wrong one."""


class DeviceTimeout(DeviceError, TimeoutError):
    """A device did not answer in time."""


class VehicleRefused(DeviceError):
    """A vehicle answered no; carries its own words."""
