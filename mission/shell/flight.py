"""One mission from start to end in this process: event loop, recording, keyboard, page."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fieldkit.recording.reader import Recording
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import Mission
from mission.shell import setups
from mission.shell.keyboard import keyboard
from mission.shell.progress import Progress
from mission.shell.recorder import Follower, recording_of
from mission.shell.runner import Runner

if TYPE_CHECKING:
    from mission.page.serve import LivePage


def fly(
    mission: Mission,
    setup: setups.Setup,
    recording: Path,
    on_progress: Callable[[Progress], None] = lambda _: None,
    *,
    truth: tuple[TransientSource, ...] = (),
    extra: dict[str, Any] | None = None,
    page: "LivePage | None" = None,
    override: str = "",
    past: Recording | None = None,
    others: tuple[Follower, ...] = (),
    on_start: Callable[[Runner], None] = lambda _: None,
) -> Runner:
    """Run a mission on a setup with a recording; the runner, ended. The recording is closed whatever happens.

    `others` are given everything that is recorded, beside the page. `on_start` is given the runner before it runs.
    With `past`, the recording of a mission that was interrupted, it goes on from there; the new recording holds all.
    """
    more = dict(extra or {})
    if truth:
        more["truth"] = [
            {"east_m": s.east_m, "north_m": s.north_m, "power_db": s.power_db, "rate_hz": s.rate_hz}
            for s in truth
        ]
    start_ns = setup.clock.now_ns() if past is None else 0
    rotate_mb = mission.file.recording.rotate_mb
    with recording_of(mission, recording, more, start_ns, rotate_mb) as recorder:
        followers = others if page is None else (page.follower, *others)
        runner = Runner(mission, setup, recorder, on_progress, followers, override)

        if past is not None:
            runner.rebuild(past.steps())
            runner.fences.remember(note.text for _, note in past.notes())

        async def run() -> None:
            if setup.tap is not None:
                setup.tap.listen(lambda robot, data: recorder.raw(setup.clock.now_ns(), robot, data))
            if page is not None:
                page.attach(runner)
            on_start(runner)
            with keyboard(runner):
                await runner.run()

        asyncio.run(run())
    return runner
