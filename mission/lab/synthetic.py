"""A small mission in virtual time, recorded: for tests, benchmarks and examples that need a recording at once."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from fieldkit.channel.antenna_file import AntennaFile, dump_antenna
from fieldkit.channel.model import Antenna
from fieldkit.clock import ScaledClock
from fieldkit.files import write_whole
from fieldkit.plugins import load
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.mission_file import Mission, read_mission
from mission.core.template import TemplateRobot, mission_text
from mission.lab.simulate import Truth
from mission.lab.simulated import fly_simulated
from mission.shell.setups import free_udp_port, radio_of, start_places

ANTENNA = Antenna(2.53, -62.0, 3.3, -70.0, -36.0)
LEVELS_DB = (-8.0, -6.0, -4.0, -2.0, 0.0)
ROBOTS, DURATION_S = 4, 120.0


def small_mission(
    folder: Path,
    *,
    seed: int = 1,
    duration_s: float = DURATION_S,
    robots: int = ROBOTS,
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
    duration_s: float = DURATION_S,
    robots: int = ROBOTS,
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
    return record(mission, folder / "mission.mcap", seed)


def record(mission: Mission, path: Path, seed: int) -> Path:
    """The same of a mission that is made already; `path`."""
    truth = Truth(radio_of(mission), hidden_sources(seed), tuple(start_places(mission).values()))
    fly_simulated(mission, truth, seed, path, {"mission": "synthetic", "seed": seed})
    return path


@contextmanager
def emulated_pair(mission: Mission) -> Iterator[tuple[Any, str]]:
    """Two emulated rovers with radios and a transmitter near them, on real wires in a mission's field.

    The field, whose `receiver_ports` are by robot, and the address to which the rovers' telemetry goes.
    """
    address = f"127.0.0.1:{free_udp_port()}"
    emulate = load("fieldkit.emulators", "field")
    with emulate(
        clock=ScaledClock(1.0),
        frame=mission.frame,
        antenna=radio_of(mission),
        sources=(TransientSource(3.0, 3.0, 0.0, 1.0),),
        robots=(("r1", 1, 3.0, 2.0, 0.0, "rover"), ("r2", 2, 6.0, 2.0, 0.0, "rover")),
        vehicle_address=address,
        seed=1,
    ) as field:
        yield field, address
