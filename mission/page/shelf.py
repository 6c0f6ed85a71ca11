"""The recordings in a folder, on a page of their own: each a line, and one that is chosen opens on its page.

    GET  /runs/list   the recordings: when, how long, what was found, whether anything is missing
    POST /runs/open   {name}: the address of its page

A recording's page is served on a port of its own; of many that were opened, the longest open is closed.
"""

import asyncio
import os
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from starlette.requests import Request
from starlette.responses import JSONResponse, Response

from fieldkit import settings as given
from fieldkit.errors import DataError, FieldkitError, RecordingError
from fieldkit.recording.reader import Recording, is_later_part, open_recording
from mission.page.posted import posted
from mission.page.protocol import Failed, OpenedRun, Run, Runs, UnreadRun
from mission.page.server import NothingLive, Page

MOST_LISTED = 500
MOST_OPEN = 6
LONGEST_QUESTION = 16_384

Answer = Callable[[Request], Awaitable[Response]]
Opener = Callable[[Recording], AbstractContextManager[Page]]
State = tuple[int, int]
"""Of a file: bytes, time of change."""


class Shelf:
    """The recordings in `folder` and below. `opener` serves one. Raises `DataError` where there is no such folder."""

    def __init__(self, folder: Path, opener: Opener) -> None:
        if not folder.is_dir():
            raise DataError(f"{folder}: no such folder")
        self._folder, self._opener = folder, opener
        self._known: dict[Path, tuple[tuple[int, int], Run | UnreadRun]] = {}
        """What was found out of a file, and of which state of it."""
        self._open: OrderedDict[str, tuple[State, AbstractContextManager[Page], Page]] = OrderedDict()
        self.unlisted = 0
        """Recordings that `rows` had no room for."""
        self._one_at_a_time = asyncio.Lock()

    def routes(self) -> Mapping[str, Answer]:
        """Path to what answers there, asked by GET."""
        return {"/runs/list": self._list}

    def posts(self) -> Mapping[str, Answer]:
        """The same, asked by POST."""
        return {"/runs/open": self._chosen}

    async def end(self) -> None:
        """Nothing goes out that has to end."""

    def close(self) -> None:
        """Every page that was opened ends."""
        while self._open:
            self._end(next(iter(self._open)))

    def _end(self, name: str) -> None:
        self._open.pop(name)[1].__exit__(None, None, None)

    def rows(self) -> list[Run | UnreadRun]:
        """The newest first."""
        # os.walk, because it passes over folders that cannot be read or have just gone.
        files = [Path(top) / name for top, _, names in os.walk(self._folder) for name in names]
        files = [path for path in files if path.suffix == ".mcap" and not is_later_part(path)]
        rows = [self._row(path) for path in sorted(files, reverse=True)[:MOST_LISTED]]
        self.unlisted = max(0, len(files) - MOST_LISTED)
        return sorted((row for row in rows if row is not None), key=_start_ns, reverse=True)

    def _row(self, path: Path) -> Run | UnreadRun | None:
        """None where the file has gone since it was seen."""
        try:
            state = _state(path)
        except OSError:
            return None
        if path not in self._known or self._known[path][0] != state:
            self._known[path] = state, _look(path, path.relative_to(self._folder).as_posix())
        return self._known[path][1]

    def open(self, name: str) -> str:
        """The address of that recording's page. Raises `RecordingError`; `DataError` for one that is not listed."""
        if name not in {row["name"] for row in self.rows()}:
            raise DataError(f"{name}: is not in {self._folder}")
        state = _state(self._folder / name)
        if name in self._open and self._open[name][0] != state:
            self._end(name)  # the mission that writes it has gone on since
        if name not in self._open:
            served = self._opener(open_recording(self._folder / name))
            self._open[name] = state, served, served.__enter__()
            if len(self._open) > MOST_OPEN:
                self._end(next(iter(self._open)))
        self._open.move_to_end(name)
        return self._open[name][2].address

    async def _list(self, request: Request) -> Response:
        async with self._one_at_a_time:
            rows = await asyncio.to_thread(self.rows)
        runs: Runs = {"folder": str(self._folder.absolute()), "runs": rows, "unlisted": self.unlisted}
        return JSONResponse(runs)

    async def _chosen(self, request: Request) -> Response:
        try:
            asked = await posted(request, most_bytes=LONGEST_QUESTION)
            name = asked.get("name") if isinstance(asked, dict) else None
            if not isinstance(name, str):
                raise DataError("expected {name}")
            async with self._one_at_a_time:
                opened: OpenedRun = {"address": await asyncio.to_thread(self.open, name)}
        except (FieldkitError, OSError) as error:
            return _refused(str(error))
        return JSONResponse(opened)


def _refused(text: str) -> Response:
    failed: Failed = {"error": text}
    return JSONResponse(failed, 400)


def _state(path: Path) -> State:
    stat = path.stat()
    return stat.st_size, stat.st_mtime_ns


def _start_ns(row: Run | UnreadRun) -> int:
    return 0 if "error" in row else row["start_ns"] or 0


def _look(path: Path, name: str) -> Run | UnreadRun:
    """What a line says of a recording, or what is wrong with it."""
    shown = name.encode("utf-8", "replace").decode()
    if shown != name:
        return {"name": shown, "error": "its name holds bytes that are no letters: rename it"}
    try:
        recording = open_recording(path)
        said = recording.summary()
        result = recording.result() if recording.complete else None
    except (RecordingError, OSError) as error:
        return {"name": name, "error": str(error).removeprefix(f"{path}: ")}  # which one stands beside it
    return {
        "name": name,
        "start_ns": said["start_ns"],
        "duration_s": round(said["duration_s"], 1),
        "bytes": said["bytes"],
        "readings": said["counts"].get("/in/reading", 0),
        "found": None if result is None else len(result.get("found_at_s", ())),
        "ended": "" if result is None else str(result.get("end_reason", "")),
        "missing": said["missing"] if not said["complete"] else "",
    }


@contextmanager
def shelf(folder: Path, opener: Opener, *, host: str = given.PAGE_HOST, port: int = 0) -> Iterator[Page]:
    """The page of a folder's recordings. Raises `DataError`, `ConfigError` where the port is taken."""
    kept = Shelf(folder, opener)
    try:
        with Page(NothingLive(), host=host, port=port, answers=kept, front="runs.html") as page:
            yield page
    finally:
        kept.close()
