"""A watcher from start to end in this process: its files, its journal."""

import asyncio
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from fieldkit.clock import Clock
from fieldkit.engine.decentralised.card import Card
from fieldkit.engine.decentralised.logs import Logs
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import Talk
from fieldkit.ports import Network
from mission.core.mission_file import Mission
from mission.core.watcher import Watcher
from mission.shell import journal as journals
from mission.shell.agent_flight import card_named, head_of
from mission.shell.chronicle import common_of
from mission.shell.keyboard import keyboard
from mission.shell.progress import Progress
from mission.shell.recorder import recording_of
from mission.shell.watching import Watching, draw_number, watcher_name

if TYPE_CHECKING:
    from mission.page.serve import LivePage


def make_watcher(mission: Mission, clock: Clock, key: bytes, bytes_s: float) -> tuple[Watcher, Card]:
    """The watcher, which knows nothing yet, and its card. Raises `ConfigError` for a clock that was never set."""
    number = draw_number()
    card = card_named(mission, watcher_name(number), clock)
    logs = Logs("", mission.kernel.engine.robots)
    talk = Talk(logs, Seal(session_key(key, card.common), number), bytes_s)
    return Watcher(mission.kernel, talk), card


def watch_team(
    mission: Mission,
    network: Network,
    clock: Clock,
    key: bytes,
    folder: Path,
    *,
    bytes_s: float,
    on_progress: Callable[[Progress], None] = lambda _: None,
    page: "LivePage | None" = None,
    on_start: Callable[[Watching], None] = lambda _: None,
) -> Watching:
    """Watch the robots' agents until the operator ends it; what watched, ended. Files are closed whatever happens.

    `on_start` is given what watches before it runs.
    """
    watcher, card = make_watcher(mission, clock, key, bytes_s)
    with ExitStack() as stack:
        journal = stack.enter_context(closing(journals.Journal(folder / journals.NAME)))
        journal.begin(replace(head_of(card, key), robot=""))
        recorder = stack.enter_context(recording_of(mission, folder / "common.mcap", {"common": True}))
        common = common_of(mission, watcher.lines.common, recorder)
        watching = Watching(
            mission, clock, network, key, card, watcher, journal, common, recorder, on_progress, page
        )
        on_start(watching)

        async def run() -> None:
            if page is not None:
                page.attach(watching, "the laptop's page")
            with keyboard(watching, "page", "the laptop's terminal"):
                await watching.run()

        asyncio.run(run())
    return watching
