"""A small mission in virtual time, recorded: for tests, benchmarks and examples that need a recording at once."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.files import write_whole
from fieldkit.messages import Command, Event, Tick
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.kernel import Kernel, Outcome, state_digest
from mission.core.mission_file import Mission, read_mission
from mission.core.template import TemplateRobot, mission_text
from mission.lab.simulate import Truth, simulate
from mission.safety.rules import Safety
from mission.shell.recorder import MissionRecorder
from mission.shell.setups import radio_of, start_places

ANTENNA = Antenna(2.53, -62.0, 3.3, -70.0, -36.0)
LEVELS_DB = (-8.0, -6.0, -4.0, -2.0, 0.0)


def small_mission(
    folder: Path,
    *,
    seed: int = 1,
    duration_s: float = 120.0,
    robots: int = 4,
    sources_found: int | None = None,
    engine: Mapping[str, str | float | bool] = MappingProxyType({}),
    antenna: AntennaFile = AntennaFile(ANTENNA),
) -> Mission:
    """A 10 m x 10 m mission in `folder` (mission.toml, antenna.toml), checked. `engine`: keys of that table."""
    write_whole(folder / "antenna.toml", dump_antenna(antenna))
    text = mission_text(
        name="synthetic",
        seed=seed,
        size_m=10.0,
        cell_m=0.2,
        rate_hz=0.1,
        expected=3.0,
        planning_period_s=20.0,
        max_duration_s=duration_s,
        sources_found=sources_found,
        fence_margin_m=0.2,
        min_separation_m=0.5,
        overrun_s=60.0,
        engine=engine,
        robots=[TemplateRobot(f"r{k}", f"port{k}", "udpin:127.0.0.1:14550", k) for k in range(1, robots + 1)],
    )
    write_whole(folder / "mission.toml", text)
    return read_mission(folder / "mission.toml")


def hidden_sources(seed: int) -> tuple[TransientSource, ...]:
    """Three transmitters somewhere in that field."""
    return tuple(random_sources(3, 10.0, 10.0, LEVELS_DB, 0.1, np.random.default_rng([seed, 7])))


def record_simulated(
    folder: Path,
    *,
    seed: int = 1,
    duration_s: float = 120.0,
    robots: int = 4,
    sources_found: int | None = None,
    engine: Mapping[str, str | float | bool] = MappingProxyType({}),
    antenna: AntennaFile = AntennaFile(ANTENNA),
) -> Path:
    """Simulate and record such a mission with three sources; the recording's path.

    It ends when all three are found; to have it last for `duration_s`, ask for more `sources_found` than there are.
    """
    mission = small_mission(
        folder,
        seed=seed,
        duration_s=duration_s,
        robots=robots,
        sources_found=sources_found,
        engine=engine,
        antenna=antenna,
    )
    sources = hidden_sources(seed)
    truth = Truth(radio_of(mission), sources, tuple(start_places(mission).values()))
    path = folder / "mission.mcap"
    safety = Safety(mission.safety)
    number = 0
    records: MissionRecorder | None = None
    with RecordingWriter(
        path,
        mission_toml=mission.text,
        antenna_toml=mission.antenna_text,
        metadata={
            "mission": "synthetic",
            "seed": seed,
            "truth": [
                {"east_m": s.east_m, "north_m": s.north_m, "power_db": s.power_db, "rate_hz": s.rate_hz}
                for s in sources
            ],
        },
        frame=mission.frame,
    ) as recorder:

        def note(kernel: Kernel, event: Event, outcome: Outcome) -> list[Command]:
            nonlocal number, records
            records = records or MissionRecorder(kernel, mission.kernel.engine.grid.cell_m, recorder)
            number += 1
            records.event(number, event.t_ns, event)
            allowed = safety.observe(event)
            for command in allowed:
                records.command(number, event.t_ns, command, "safety")
            for asked, passed in zip(outcome.commands, safety.judge(outcome.commands), strict=True):
                records.command(number, event.t_ns, asked, "kernel")
                records.command(number, event.t_ns, passed, "safety")
                allowed.append(passed)
            records.outcome(number, event.t_ns, outcome)
            if isinstance(event, Tick) and (look := records.look_if_due(event.t_ns)) is not None:
                records.belief(number, event.t_ns, look)
            return allowed

        result = simulate(mission.kernel, truth, seed, on_step=note)
        end_ns = round(result.elapsed_s * 1e9)
        assert records is not None  # a mission has events
        records.end(number, end_ns)
        recorder.result(
            number,
            end_ns,
            {
                "end_reason": result.end_reason,
                "belief_hash": result.kernel.digest(),
                "commands_hash": result.kernel.commands_digest(),
                "state_hash": state_digest(result.kernel),
                "events": number,
                "detections": result.kernel.detections,
                "found_at_s": {str(ident): at_s for ident, at_s in result.kernel.found_at_s.items()},
                "interventions": safety.interventions,
            },
        )
    return path
