"""`fieldkit dashboard`: recordings on the page that the live mission had."""

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldkit import settings as given
from mission.cli.options import HostOption, PortOption, say

if TYPE_CHECKING:
    from fieldkit.recording.reader import Recording
    from mission.page.server import Page


def dashboard(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="A recording (mission.mcap), or a folder of recordings.")
    ],
    page_host: HostOption = given.PAGE_HOST,
    page_port: PortOption = 8322,
) -> None:
    """Show a recording on the page that the live mission had, with a time to go to and a speed to play at.

    Of a folder that holds several, the page lists them, and opens the one that is chosen.

    Example: fieldkit dashboard runs
    """
    from functools import partial

    from fieldkit.clock import wall_sleep
    from fieldkit.recording.reader import IN_A_RUN, open_recording
    from mission.page.shelf import shelf

    past = partial(_past, host=page_host)
    shown: AbstractContextManager[Page]
    if log.is_dir() and not (log / IN_A_RUN).is_file():
        shown = shelf(log, past, host=page_host, port=page_port)
    else:
        say(f"reading {log} ...")
        shown = past(open_recording(log), port=page_port)
    with shown as page:
        say(f"open {page.address}   (Ctrl-C ends it)", always=True)
        while True:
            wall_sleep(0.5)


def _past(recording: "Recording", *, host: str, port: int = 0) -> "AbstractContextManager[Page]":
    """The page over a recording, which writes its report where it is asked for."""
    from tempfile import TemporaryDirectory

    from mission.page import serve

    def report() -> bytes:
        from mission.analysis.report import write_report
        from mission.page.embed import embedded

        with TemporaryDirectory() as folder:
            path = Path(folder) / "report.html"
            write_report(recording, path, embedded(recording))
            return path.read_bytes()

    return serve.past(recording, host=host, port=port, report=report)
