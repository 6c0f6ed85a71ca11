"""What commands say on standard error while they work: lines, logs and progress. `--quiet` silences all but trouble."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

_quiet = False


def be_quiet(wanted: bool) -> None:
    """Whether only trouble is said from now on."""
    global _quiet
    _quiet = wanted


def is_quiet() -> bool:
    """Whether only trouble is said."""
    return _quiet


class StderrHandler(logging.StreamHandler[TextIO]):
    """Logs to what standard error is at that moment: a live table takes its place, and puts lines above itself.

    A handler that keeps the stream it began with writes into the table.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line."""
        self.stream = sys.stderr
        super().emit(record)


Report = Callable[[float, str], None]
"""Takes the share that is done, and a few words."""


@contextmanager
def progress(words: str) -> Iterator[Report]:
    """A bar with the time left, on a terminal, for as long as this lasts.

    Given no share it only shows that work goes on.
    """
    if _quiet or not sys.stderr.isatty():
        yield lambda share, text: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(bar_width=24),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(words, total=None)

        def report(share: float, text: str) -> None:
            bar.update(task, total=1.0, completed=share, description=text or words)

        yield report
