"""An agent's logs on its own disk, written before anything of them is said: what others may have, it has itself.

A record is its length, its CRC and what it holds; a kill cuts the last one at the most. A robot whose agent was killed
goes on with its log where the journal ends, so that no number of it is ever given twice.
"""

import errno
import json
import logging
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import astuple, dataclass, field
from enum import Enum
from pathlib import Path

from fieldkit.engine.decentralised import packing
from fieldkit.engine.decentralised.logs import Key, Logs, Part
from fieldkit.errors import RecordingError

logger = logging.getLogger(__name__)

NAME = "observations.log"
BEGUN = ".begun"
"""Behind the name of one that does not hold yet what was known when it began."""
_HEAD = struct.Struct("<II")
HEADER, PART, CLOSED, END = range(4)
LEFT = b"left"
"""What the end of a journal says where its mission may have gone on without its robot."""
LARGEST_RECORD = 1_000_000
ENTRIES = 200
"""Of a record at the most."""
RESUME_WITHIN_S = 7_200.0
"""A journal that was left longer ago belongs to a mission that is over."""


class Ending(Enum):
    """How a journal ends."""

    CUT = "its agent was killed, or still runs"
    LEFT = "its agent was ended before the mission was over"
    OVER = "the mission was over, or it cannot be gone on with"


@dataclass(frozen=True, slots=True)
class Head:
    """Whose journal it is. What two journals have in common may be laid together."""

    robot: str
    mission_hash: str
    made: str = ""
    """Version and code that wrote it; empty in journals of before they said so."""
    team: str = ""
    """A hash of the mission's key, from which nobody learns the key."""


@dataclass
class Journal:
    """An open journal. `write` adds what is new in the logs.

    It has its name once all is in it that was known when it began: one that was cut before would be gone on with
    instead of the whole one before it.
    """

    path: Path
    failure: str = ""
    """Why nothing is written any more; empty while it is."""
    _file: int = -1
    _is_named: bool = False
    _counts: dict[Key, int] = field(default_factory=dict)
    _closed: dict[Key, int] = field(default_factory=dict)

    def begin(self, head: Head) -> None:
        """Start the file."""
        if self.path.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(self.path))
        self._file = os.open(self._begun_as, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        self._add(HEADER, json.dumps(astuple(head)).encode())

    def write(self, logs: Logs) -> None:
        """What has come to be known, then up to where logs are closed. With the operating system when this returns."""
        for key, log in logs.entries.items():
            count = len(log)
            for first in range(self._counts.get(key, 0), count, ENTRIES):
                out = packing.Bytes()
                part = Part(*key, first, tuple(log[first : min(count, first + ENTRIES)]))
                packing.pack_part(out, part, logs.robots, 0)
                self._add(PART, bytes(out.data))
            self._counts[key] = count
        changed = {key: tick for key, tick in logs.closed.items() if tick != self._closed.get(key)}
        if changed:
            self._closed |= changed
            rows = [[*key, tick] for key, tick in changed.items()]
            self._add(CLOSED, json.dumps(rows, separators=(",", ":")).encode())
        self._name()

    def end(self, *, left: bool = False) -> None:
        """Its agent has come to its end; `left`: the mission was not over by then, as far as is known here."""
        self._add(END, LEFT if left else b"")
        self._name()

    def close(self) -> None:
        """Closing twice is harmless."""
        if self._file >= 0:
            self._file = self._closed_file()
            self._name()

    @property
    def _begun_as(self) -> Path:
        return self.path.with_name(self.path.name + BEGUN)

    def _name(self) -> None:
        if self.failure or self._is_named:
            return
        is_open, self._file = self._file >= 0, self._closed_file()
        try:
            self._begun_as.rename(self.path)  # Windows names no file that is open
            self._is_named = True
            if is_open:
                self._file = os.open(self.path, os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            self._fail(error)

    def _closed_file(self) -> int:
        if self._file >= 0:
            os.close(self._file)
        return -1

    def _add(self, kind: int, data: bytes) -> None:
        if self.failure or self._file < 0:
            return
        body = bytes((kind,)) + data
        record = _HEAD.pack(len(body), zlib.crc32(body)) + body
        try:
            # A disk with little left takes a part and says nothing: the next write then says why it cannot go on.
            while record:
                record = record[os.write(self._file, record) :]
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        self.failure = f"{self.path}: cannot be written: {error.strerror or error}"
        logger.error(
            "%s. The mission goes on; what this robot observes is with the others alone", self.failure
        )


def load(path: Path, logs: Logs) -> tuple[int, str]:
    """Take a journal into logs that have not begun; how many observations it held, and what is damaged in words.

    A cut end is left out.
    """
    count, damage = 0, ""
    try:
        for kind, data in _records(path):
            if kind == PART:
                count += len(logs.take(packing.unpack_part(packing.Reader(data), logs.robots, 0)))
            elif kind == CLOSED:
                for robot, stream, tick in json.loads(data):
                    key = next(key for key in logs.closed if key == (robot, stream))
                    logs.closed[key] = max(logs.closed[key], int(tick))
    except (RecordingError, ValueError, StopIteration) as error:
        damage = f"is damaged after {count} observations: {error}"
        logger.warning("%s: %s", path, damage)
    return count, damage


def head_of(path: Path) -> Head:
    """Whose journal it is. Raises `RecordingError` where it is none."""
    try:
        kind, data = next(_records(path), (END, b""))
        values = json.loads(data) if kind == HEADER else None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError:
        values = None
    if (
        not isinstance(values, list)
        or not 2 <= len(values) <= 4
        or not all(isinstance(v, str) for v in values)
    ):
        raise RecordingError(
            f"{path}: expected an agent's {NAME}, got something else, or one cut at its beginning"
        )
    return Head(*values)


def is_ended(path: Path) -> bool:
    """Whether its agent came to its end; else it was killed, still runs, or the file is cut."""
    return _ending(path)[0] is not Ending.CUT


def _ending(path: Path) -> tuple[Ending, bool]:
    """How it ends, and whether there is an observation in it."""
    last, holds = (END - 1, b""), False
    for record in _records(path):
        last, holds = record, holds or record[0] == PART
    if last[0] != END:
        return Ending.CUT, holds
    return Ending.LEFT if last[1] == LEFT else Ending.OVER, holds


def latest(out: Path, head: Head, now_s: float) -> tuple[Path, Ending] | None:
    """The latest journal below `out` of this robot, mission and key with an observation in it, and how it ends.

    One that was left long ago belongs to a mission that is over: None. One without observations is of an agent that
    ended before it had begun, and the one before that is still to be gone on with.
    """
    found = []
    for path in out.glob(f"*/{NAME}"):
        written_s = path.stat().st_mtime
        if abs(now_s - written_s) > RESUME_WITHIN_S:
            continue
        try:
            its = head_of(path)
        except RecordingError:
            continue
        is_ours = (its.robot, its.mission_hash) == (head.robot, head.mission_hash)
        ending, holds = _ending(path)
        if is_ours and its.team in ("", head.team) and holds:
            found.append((written_s, path, ending))
    if not found:
        return None
    _, path, ending = max(found, key=lambda each: each[:2])
    return path, ending


def _records(path: Path) -> Iterator[tuple[int, bytes]]:
    """Kind and content of every whole record."""
    data, at = path.read_bytes(), 0
    while at + _HEAD.size <= len(data):
        size, crc = _HEAD.unpack_from(data, at)
        body = data[at + _HEAD.size : at + _HEAD.size + size]
        if not 0 < size <= LARGEST_RECORD or len(body) < size or zlib.crc32(body) != crc:
            return
        yield body[0], body[1:]
        at += _HEAD.size + size
