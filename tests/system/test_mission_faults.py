"""Faults on the emulated wires of a running mission: the others go on, and the recording says what happened."""

import asyncio
from pathlib import Path

from fieldkit.messages import GoTo, Hold, ReceiverState, Return, VehicleState
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.sources import TransientSource
from mission.lab.synthetic import small_mission
from mission.replay.replay import replay
from mission.shell import setups
from mission.shell.runner import Runner
from mission.shell.setups import Setup
from mission.shell.warm_up import warm_up


def test_an_unplugged_radio_and_a_lost_link_stop_neither_mission_nor_record(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, duration_s=110.0)
    warm_up(mission)
    sources = (TransientSource(5.0, 4.0, 0.0, 0.3),)

    async def go(runner: Runner, setup: Setup) -> None:
        async def faults() -> None:
            while runner.kernel.started_ns is None:  # a busy machine is long at its preflight
                await setup.clock.sleep(0.5)
            await setup.clock.sleep(15.0)
            await asyncio.to_thread(setup.emulator.unplug, "r1")
            await setup.clock.sleep(15.0)
            await asyncio.to_thread(setup.emulator.silence_vehicle, "r3")

        async with asyncio.TaskGroup() as group:
            group.create_task(runner.run())
            group.create_task(faults())

    path = tmp_path / "mission.mcap"
    with (
        setups.emulated(mission, sources, seed=1, rate=5.0) as setup,
        RecordingWriter(path, mission_toml=mission.text, antenna_toml=mission.antenna_text) as recorder,
    ):
        runner = Runner(mission, setup, recorder)
        asyncio.run(go(runner, setup))
    recording = open_recording(path)
    assert recording.complete
    events = [event for _, _, event in recording.events()]
    assert any(isinstance(e, ReceiverState) and e.robot == "r1" and not e.up for e in events)
    assert any(isinstance(e, VehicleState) and e.robot == "r3" and not e.link_up for e in events)
    allowed = [(number, c) for number, _, origin, c in recording.commands() if origin == "safety"]
    lost = next(
        number
        for number, _, event in recording.events()
        if isinstance(event, VehicleState) and event.robot == "r3" and not event.link_up
    )
    held = min(number for number, c in allowed if number >= lost and isinstance(c, Hold) and c.robot == "r3")
    assert not [c for number, c in allowed if number > held and isinstance(c, GoTo) and c.robot == "r3"]
    # One of the others may have to stay clear of where r3 may be; the mission goes on all the same.
    assert {c.robot for number, c in allowed if number > held and isinstance(c, GoTo)} & {"r2", "r4"}
    # A robot that already stood, for a neighbour's sake say, is not ordered once more to hold: it is just not sent on.
    down = next(e for e in events if isinstance(e, ReceiverState) and e.robot == "r1" and not e.up)
    receiver_down_ns = down.t_ns + round(mission.safety.radio.timeout_s * 1e9)
    told = [c for _, c in allowed if isinstance(c, GoTo | Hold | Return) and c.robot == "r1"]
    assert not isinstance(told[-1], GoTo)
    assert not [c for c in told if isinstance(c, GoTo) and c.t_ns > receiver_down_ns]
    assert replay(path).complete
