"""Files that the system does not give: tests often run as root, who may read what is closed to everybody else."""

import errno
from pathlib import Path

import pytest


def close(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on `path` is closed to us, as after `chmod 000`."""
    opened = Path.open

    def refusing(self: Path, *args, **options):
        if self.absolute() == path.absolute():
            raise PermissionError(errno.EACCES, "Permission denied", str(self))
        return opened(self, *args, **options)

    monkeypatch.setattr(Path, "open", refusing)
