"""Rovers and copters in one mission, on emulated wires: the whole program but the operator."""

from pathlib import Path

import pytest
from test_sitl_missions import HIDDEN_M, judge, mission_file

from fieldkit.messages import Pose
from fieldkit.recording.reader import open_recording
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import read_mission
from mission.lab.demo import fly
from mission.shell import setups
from mission.shell.warm_up import warm_up

RATE = 3.0


@pytest.mark.timeout(400)
def test_two_rovers_and_two_copters_find_what_is_hidden_on_emulated_wires(tmp_path: Path) -> None:
    kinds = ["rover", "rover", "copter", "copter"]
    # On a busy machine a step of the kernel takes seconds of the wall, each three of the mission.
    mission = read_mission(mission_file(tmp_path, kinds, 14550, 14560, overrun_s=30.0))
    sources = tuple(TransientSource(east_m, north_m, 0.0, 0.2) for east_m, north_m in HIDDEN_M)
    warm_up(
        mission
    )  # as every real mission does: loading the compiled loops stops the heartbeats for seconds
    with setups.emulated(mission, sources, seed=3, rate=RATE) as setup:
        runner = fly(mission, setup, tmp_path / "mission.mcap", lambda _: None)
        up_m = setup.emulator.altitude()
    recording = open_recording(tmp_path / "mission.mcap")
    finds = [
        {"state": source.state, "east_m": source.east_m, "north_m": source.north_m}
        for source in runner.kernel.sources()
    ]
    judge(runner.result() | {"sources": finds}, recording, "two rovers and two copters, emulated")
    heights = [
        step.event.up_m
        for step in recording.steps()
        if isinstance(step.event, Pose) and step.event.robot in ("r3", "r4")
    ]
    assert max(heights) > 2.0, "copters fly"
    assert max(up_m.values()) < 0.5, "and are down again at the end"
