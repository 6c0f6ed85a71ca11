"""fieldkit plan: the mission editor in a browser."""

import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from fieldkit import settings as given
from mission.cli.options import HostOption, PortOption, print_code, say


def plan(
    mission_file: Annotated[
        Path, typer.Argument(metavar="MISSION.TOML", help="The mission file; made where there is none.")
    ] = Path("mission.toml"),
    page_host: HostOption = given.PAGE_HOST,
    page_port: PortOption = 8323,
    show: Annotated[bool, typer.Option("--open/--no-open", help="Open it in the browser.")] = True,
) -> None:
    """Draw the field, add robots, and see what is wrong with a mission file, in the browser. Nothing is sent to robots.

    The file is written when you press Store, and only then; its comments stay.

    Example: fieldkit plan mission.toml
    """
    from fieldkit.clock import wall_sleep
    from mission.plan.serve import plan as serve

    with serve(mission_file, host=page_host, port=page_port) as page:
        say(f"to edit {mission_file}, open  {page.command_address}   (Ctrl-C ends it)", always=True)
        if not (folder := mission_file.absolute().parent).is_dir():
            say(f"there is no folder {folder} yet: Store makes it", always=True)
        if page.is_reached_by_others and sys.stderr.isatty():
            print_code(page.command_address)
        if show and sys.stdin is not None and sys.stdin.isatty():
            webbrowser.open(page.command_address)
        try:
            while True:
                wall_sleep(0.5)
        except KeyboardInterrupt:
            say("ended")
