"""A receiver whose device is read in a thread of its own, from when readings are wanted until the device is closed."""

import logging
import threading
from collections.abc import Callable

from drivers.reconnecting import ReconnectingReceiver
from fieldkit.ports import DriverContext

logger = logging.getLogger(__name__)


class ThreadedReceiver(ReconnectingReceiver):
    """A `ReconnectingReceiver` that reads by itself.

    A subclass ends `_open_device` with `_read_by(function)` and begins `_close_device` with `_stop_reading()`. The
    function reads for as long as `_running` is set.
    """

    def __init__(self, robot: str, name: str, around: DriverContext) -> None:
        super().__init__(robot, name, around)
        self._thread: threading.Thread | None = None
        self._running = threading.Event()

    def _read_by(self, read: Callable[..., None], *arguments: object) -> None:
        """What the thread runs, once readings are wanted."""
        self._running.set()

        def read_or_say_why_not() -> None:
            try:
                read(*arguments)
            except Exception as error:  # a reader that is gone without a word would pass for silence
                logger.exception("%s: its reader failed", self._name)
                self._on_lost(f"its reader failed ({type(error).__name__}: {error})")

        self._thread = threading.Thread(target=read_or_say_why_not, name=self._name, daemon=True)

    def _start(self) -> None:
        if self._thread is not None:
            self._thread.start()

    def _stop_reading(self) -> None:
        """Wait until the thread is over, if it ever ran."""
        self._running.clear()
        if self._thread is not None and self._thread.is_alive():
            self._thread.join()
        self._thread = None
