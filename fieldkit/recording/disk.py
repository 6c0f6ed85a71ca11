"""Synchronising a file with the disk in a thread of its own.

`fsync` is what survives a power cut, and takes milliseconds on a good disk and seconds on a tired memory card: the
steering loop must not stand still for it.
"""

import os
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor


class DiskSync:
    """One at a time, and at most one waiting: that one covers whoever asks meanwhile. Not for several threads."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="disk")
        self._asked: deque[Future[None]] = deque()

    def ask(self, descriptor: int) -> None:
        """Have everything written so far synchronised. Raises the `OSError` of an earlier one that failed."""
        while self._asked and self._asked[0].done():
            self._asked.popleft().result()
        if len(self._asked) < 2:
            self._asked.append(self._thread.submit(os.fsync, descriptor))

    def wait(self) -> None:
        """Until all that was asked for is done. Raises as `ask`."""
        while self._asked:
            self._asked.popleft().result()

    def close(self) -> None:
        """End the thread, once it is done."""
        self._thread.shutdown()
