"""What the mission's commands share: options, words to the terminal, the folder of a run, the live page."""

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldkit.console import is_quiet

if TYPE_CHECKING:
    from mission.core.mission_file import Mission
    from mission.page.protocol import Ends
    from mission.page.serve import LivePage
    from mission.shell.recorder import Follower
    from mission.shell.runner import Runner
    from mission.shell.watching import Watching

PageOption = Annotated[bool, typer.Option("--page/--no-page", help="Serve the live page.")]
HostOption = Annotated[
    str, typer.Option(help="Address the page is served on; 0.0.0.0 for phones in the same network.")
]
PortOption = Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any.")]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print the result alone, as JSON, on standard output.")
]


def say(text: str, *, always: bool = False) -> None:
    """A line for the person at the terminal; results alone go to standard output.

    `always`: also with --quiet, as trouble and addresses are.
    """
    if always or not is_quiet():
        typer.echo(text, err=True)


def print_json(value: Any) -> None:
    """A result on standard output."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False, default=str))


def print_code(address: str) -> None:
    """The address as a QR code on standard error: a phone's camera reads it sooner than a thumb types it."""
    import segno

    segno.make(address, error="l", micro=False).terminal(out=sys.stderr, border=2, compact=True)


@contextmanager
def before_the_start() -> Iterator[None]:
    """A signal that comes while a mission is prepared ends the command, and says that nothing has moved."""
    from mission.shell.signals import StoppedEarly, early, leave_closed_terminals

    try:
        with early():
            yield
    except StoppedEarly as stopped:
        if stopped.terminal_gone:
            leave_closed_terminals()
        say(
            f"fieldkit: {stopped.why} before the mission began: nothing was started, no vehicle was given an order",
            always=True,
        )
        raise SystemExit(128 + stopped.number) from None


def may_be_shown(wanted: bool, host: str, port: int) -> None:
    """Raises `ConfigError` where a wanted page cannot be served by now."""
    if wanted:
        from mission.page.server import may_be_served

        may_be_served(host, port)


@contextmanager
def shown_page(
    mission: "Mission", wanted: bool, host: str, port: int, ends: "Ends | None" = None
) -> "Iterator[LivePage | None]":
    """The live page, and where to find it, on standard error. `ends`: what End ends, if not the whole."""
    from mission.shell.keyboard import help_of

    hands = help_of(ends or "mission") if sys.stdin is not None and sys.stdin.isatty() else ""
    if not wanted:
        if hands:
            say(hands)
        yield None
        return
    from mission.page import serve

    with serve.live(mission, host=host, port=port) as shown:
        if ends is not None:
            shown.ends(ends)
        say(f"to look and command, open  {shown.page.command_address}", always=True)
        say(f"only to look:              {shown.page.address}", always=True)
        if shown.page.is_reached_by_others and sys.stderr.isatty():
            print_code(shown.page.command_address)
        if hands:
            say(hands)
        yield shown


def stay_open(shown: "LivePage | None", runner: "Runner") -> None:
    """Leave the page open until Ctrl-C where something was found: whoever carries the phone wants its coordinates.

    Without a terminal there is nobody to end it, and it closes.
    """
    from fieldkit.clock import wall_sleep

    found = any(source.state == "found" for source in runner.kernel.sources())
    if shown is None or not found or sys.stdin is None or not sys.stdin.isatty():
        return
    shown.follower.publish()
    say(f"the page stays open until Ctrl-C: {shown.page.address}")
    with suppress(KeyboardInterrupt):
        while True:
            wall_sleep(0.5)


@contextmanager
def informed_maps(mission: "Mission") -> "Iterator[tuple[Follower, ...]]":
    """Whoever the mission file says is to be informed by Cursor on Target."""
    table = mission.file.maps
    if not table.cot:
        yield ()
        return
    from mission.maps.cot import CotSender
    from mission.maps.present import Latest

    say(f"Cursor on Target goes to {', '.join(table.cot)}")
    with CotSender(Latest(mission), table.cot, table.cot_every_s) as sender:
        yield (sender.latest,)


@contextmanager
def begun_folder(
    out: Path, mission: "Mission"
) -> "Iterator[tuple[Path, Callable[[Runner | Watching], None]]]":
    """A folder of its own for this run, with the two files that it is flown with; and what the runner is given to.

    The folder goes again where the run ends by an error before its runner has begun.
    """
    from fieldkit.files import write_whole

    there_before = out.exists()
    folder = run_folder(out)
    runners: list[Runner | Watching] = []
    try:
        write_whole(folder / "mission.toml", mission.text)
        write_whole(folder / mission.file.antenna.file.rsplit("/", 1)[-1], mission.antenna_text)
        yield folder, runners.append
    except BaseException:
        if not any(runner.begun for runner in runners):
            shutil.rmtree(folder, ignore_errors=True)
            if not there_before:
                with suppress(OSError):
                    out.rmdir()
            say(f"nothing was begun: {folder} is taken away again")
        raise


def may_hold_runs(out: Path) -> None:
    """Raises `ConfigError` where no folder can be made in `out`; makes none."""
    from fieldkit.errors import ConfigError

    there = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        why = "nobody may write there" if there.is_dir() else f"{there} is a file"
        raise ConfigError(f"--out {out}: cannot make a folder there: {why}")


def run_folder(out: Path) -> Path:
    """A folder of its own for this run, named by the time (UTC)."""
    from fieldkit.clock import utc_stamp

    stamp = utc_stamp()
    for suffix in ("", *(f"-{n}" for n in range(2, 1000))):
        folder = out / f"{stamp}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            from fieldkit.errors import ConfigError

            raise ConfigError(f"{out}: cannot make a folder there: {error.strerror}") from error
        return folder
    raise AssertionError("a thousand runs within one second")
