"""One mission from start to end in this process: event loop, recording, keyboard, page."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fieldkit.geo import FieldFrame
from fieldkit.recording.reader import Recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import Mission
from mission.shell import setups
from mission.shell.keyboard import keyboard
from mission.shell.progress import Progress
from mission.shell.recorder import Follower
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
    metadata: dict[str, Any] = {
        "mission": mission.file.name,
        "seed": mission.file.seed,
        **mission.recorded_settings,
        **(extra or {}),
    }
    if truth:
        metadata["truth"] = [
            {"east_m": s.east_m, "north_m": s.north_m, "power_db": s.power_db, "rate_hz": s.rate_hz}
            for s in truth
        ]
    frame = FieldFrame(mission.frame.origin_lat_deg, mission.frame.origin_lon_deg, mission.frame.origin_alt_m)
    rotate_mb = mission.file.recording.rotate_mb
    with RecordingWriter(
        recording,
        mission_toml=mission.text,
        antenna_toml=mission.antenna_text,
        metadata=metadata,
        frame=frame,
        start_ns=setup.clock.now_ns() if past is None else 0,
        rotate_bytes=None if rotate_mb is None else round(rotate_mb * 1e6),
    ) as recorder:
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
