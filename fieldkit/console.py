"""What commands say: lines, logs and progress on standard error, tables on standard output.

`--quiet` silences all of the former but trouble.
"""

import logging
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from textwrap import wrap
from typing import Any, TextIO

COLUMNS = 80
"""Of a terminal that nobody has made wider."""

NEWS = 25
"""The level of a log line that is no trouble, and to be said all the same: between information and a warning."""
logging.addLevelName(NEWS, "NEWS")

_quiet = False


def be_quiet(wanted: bool) -> None:
    """Whether only trouble is said from now on."""
    global _quiet
    _quiet = wanted


def is_quiet() -> bool:
    """Whether only trouble is said."""
    return _quiet


def folded(text: str) -> str:
    """Lines that are longer than a narrow terminal's, at their spaces; what follows stands further in."""
    lines = []
    for line in text.splitlines():
        further = " " * (len(line) - len(line.lstrip()) + 2)
        lines += wrap(
            line, COLUMNS, subsequent_indent=further, break_long_words=False, break_on_hyphens=False
        ) or [""]
    return "\n".join(lines)


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


def show_table(rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows with one set of names, on standard output: side by side where they fit, else each as a block of its own."""
    from rich import box
    from rich.console import Console
    from rich.measure import Measurement
    from rich.table import Table
    from rich.text import Text

    if not rows:
        return
    console = Console()
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for number, name in enumerate(rows[0]):
        side: Any = "left" if number == 0 else "right"
        table.add_column(Text(name.replace("_", " ")), no_wrap=True, justify=side)
    for row in rows:
        table.add_row(*(Text(_plain(value)) for value in row.values()))
    room = console.options.update(max_width=10_000)
    if Measurement.get(console, room, table).maximum <= console.width:
        console.print(table)
        return
    for row in rows:
        console.print()
        for name, value in row.items():
            console.print(
                Text(f"{' '.join(name.replace('_', ' ').split())}: {_plain(value)}"), soft_wrap=True
            )


def _plain(value: Any) -> str:
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
