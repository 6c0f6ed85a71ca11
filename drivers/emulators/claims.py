"""Two emulations on one computer must not answer as the same vehicle, nor write their mission over each other's.

Telemetry is only sent, so no socket refuses the second one. A lock that the system keeps on a file in the temporary
folder does, and lets go of it however its process ends. Where there are no such locks (Windows), nothing is refused.
"""

import contextlib
import hashlib
import os
import socket
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from drivers.links import host_and_port
from fieldkit.errors import ConfigError


@contextlib.contextmanager
def claimed_vehicles(address: str, system_ids: Iterable[int]) -> Iterator[None]:
    """Nobody else on this computer sends to `address` as one of these meanwhile. Raises `ConfigError`."""
    host, port = host_and_port(address)
    with contextlib.suppress(OSError):
        host = socket.gethostbyname(host)
    with _locked(f"{host}:{port}", tuple(system_ids)) as taken:
        if taken:
            raise ConfigError(
                f"{address} is taken: another 'fieldkit emulate' that still runs sends there as vehicle "
                f"{', '.join(map(str, taken))}. End it, or give this one another port: "
                f"--address {address.rpartition(':')[0]}:{port + 1 if port < 65535 else port - 1}"
            )
        yield


@contextlib.contextmanager
def claimed_folder(folder: Path) -> Iterator[None]:
    """No other emulated field of this computer has its files in `folder` meanwhile. Raises `ConfigError`."""
    with _locked(str(folder.resolve()), (0,)) as taken:
        if taken:
            raise ConfigError(
                f"{folder} is taken: it has the mission file of another emulated field that still runs. End it, or "
                f"give this one another folder: --out {folder}-2"
            )
        yield


@contextlib.contextmanager
def _locked(name: str, numbers: tuple[int, ...]) -> Iterator[list[int]]:
    """Lock these numbers under `name`; those that another process has."""
    try:
        import fcntl

        folder = Path(tempfile.gettempdir()) / f"fieldkit-claims-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        file = (folder / hashlib.sha256(name.encode()).hexdigest()[:16]).open("wb")
    except (ImportError, OSError):  # Windows; nowhere to write
        yield []
        return
    taken = []
    with file:
        for number in numbers:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, number)
            except BlockingIOError:
                taken.append(number)
        yield taken
