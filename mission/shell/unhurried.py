"""Standard error that never waits for its reader: Ctrl-S, a stalled ssh or a full pipe must not stop the steering.

What is written is handed to a thread, which may wait as long as it likes. What does not fit is left out, the oldest
first: of a terminal that goes on again the operator wants the present.
"""

import contextlib
import io
import logging
import os
import sys
import threading
from collections import deque
from collections.abc import Iterator
from typing import TextIO

MOST_WAITING = 65_536
"""Characters that wait for a reader; some ten pictures of the live panel."""
LEFT_OUT = "\n... what came while nothing was taken here has been left out ...\n"


class Unhurried(io.TextIOBase):
    """A stream before another, which must have a descriptor. `write` returns at once, `close` when all is out."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._waiting: deque[str] = deque()
        self._size = 0
        self._lost = False
        self._ends = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._write_all, name="standard error", daemon=True)
        self._thread.start()

    @property
    def encoding(self) -> str:  # type: ignore[override]  # an attribute there
        return self._stream.encoding or "utf-8"

    def fileno(self) -> int:
        return self._stream.fileno()

    def isatty(self) -> bool:
        return self._stream.isatty()

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        """Hand it over. Never waits; where too much waits already, the oldest of it goes."""
        with self._changed:
            self._waiting.append(text)
            self._size += len(text)
            while self._size > MOST_WAITING and len(self._waiting) > 1:
                self._size -= len(self._waiting.popleft())
                self._lost = True
            self._changed.notify_all()
        return len(text)

    def close(self) -> None:
        """Wait until everything is out, or the reader has gone."""
        with self._changed:
            self._ends = True
            self._changed.notify_all()
        while self._thread.is_alive():
            self._thread.join(0.2)  # in pieces: a signal is answered in between

    def _write_all(self) -> None:
        gone = False
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._ends)
                if not self._waiting:
                    return
                text = (LEFT_OUT if self._lost else "") + "".join(self._waiting)
                self._waiting.clear()
                self._size, self._lost = 0, False
            data = text.encode(self.encoding, "backslashreplace")
            try:
                while data and not gone:
                    # By the descriptor: a lock of the stream's, held by a thread that waits, outlives the program.
                    data = data[os.write(self._stream.fileno(), data) :]
            except OSError:
                gone = True  # nobody reads any more; the mission goes on


@contextlib.contextmanager
def unhurried_standard_error() -> Iterator[None]:
    """Whoever writes to `sys.stderr` in here waits for nobody, the log included."""
    before = sys.stderr
    try:
        before.fileno()
    except (AttributeError, OSError, ValueError):  # none, or one in memory: it waits for nobody as it is
        yield
        return
    before.flush()
    stream = Unhurried(before)
    logs = [
        handler
        for handler in logging.getLogger().handlers
        if isinstance(handler, logging.StreamHandler) and handler.stream is before
    ]
    sys.stderr = stream
    for handler in logs:
        handler.setStream(stream)
    try:
        yield
    finally:
        sys.stderr = before
        for handler in logs:
            handler.setStream(before)
        stream.close()
