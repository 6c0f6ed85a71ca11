"""`fieldkit.simulate`: a checked mission flown in virtual time over sources that are known, recorded if wanted."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.engine.belief.base import Belief
from fieldkit.errors import ConfigError
from fieldkit.messages import Command, Event, SourceEstimate
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.kernel import Kernel, Outcome
from mission.core.mission_file import Mission
from mission.lab.simulate import Result, Truth
from mission.lab.simulate import simulate as run_loop
from mission.safety.rules import Safety
from mission.shell.chronicle import Chronicle
from mission.shell.setups import radio_of, start_places


@dataclass(frozen=True, slots=True)
class SimulatedMission:
    """How a simulated mission went. Times count from its start, in seconds of the mission."""

    sources: tuple[TransientSource, ...]
    """The truth."""
    estimates: tuple[SourceEstimate, ...]
    """What the belief says at the end: candidates and finds."""
    belief: Belief
    """The belief itself, as at the end."""
    elapsed_s: float
    end_reason: str
    time_to_all_s: float | None
    """When every true source had a find within one cell, for good; None if never."""
    false_finds: int
    """Finds further than two cells from every true source."""
    recording: Path | None
    """The recording; None where none was asked for."""

    @property
    def found(self) -> tuple[SourceEstimate, ...]:
        """The estimates that count as found."""
        return tuple(estimate for estimate in self.estimates if estimate.state == "found")


def simulate(
    mission: Mission,
    sources: int | Sequence[TransientSource | tuple[float, float]] = 3,
    *,
    seed: int | None = None,
    recording: Path | str | None = None,
    packet_loss: float = 0.0,
) -> SimulatedMission:
    """Fly a mission in virtual time, thousands of seconds a second, with the live mission's kernel and safety.

    Parameters
    ----------
    mission
        From `read_mission`. Drivers and ports named in it are not opened.
    sources
        The truth: transmitters, or (east, north) in metres for one at the calibrated power that sends at the
        mission's typical rate, or how many of those to put anywhere in the field, at the mission's power levels.
    seed
        Everything random derives from it: the same seed gives the same mission, bit for bit. None: the mission's.
    recording
        Where to write a recording (MCAP), as a live mission does. An existing file is an error.
    packet_loss
        Probability that a radio misses a packet that is strong enough, from 0 to below 1.

    Raises
    ------
    ConfigError
        For a source outside the field, a packet loss out of bounds, or a belief and a planner that do not go together.
    RecordingError
        Where the recording cannot be written.
    """
    if not 0.0 <= packet_loss < 1.0:
        raise ConfigError(f"packet_loss: expected a number from 0 to below 1, got {packet_loss}")
    seed = mission.file.seed if seed is None else seed
    placed = _placed(mission, sources, seed)
    truth = Truth(
        radio_of(mission),
        placed,
        tuple(start_places(mission).values()),
        packet_loss=packet_loss,
        max_speed_m_s=mission.safety.max_speed_m_s,
    )
    path = None if recording is None else Path(recording)
    result = fly_simulated(mission, truth, seed, path, {"mission": mission.file.name, "seed": seed})
    return SimulatedMission(
        placed,
        tuple(result.kernel.sources()),
        result.kernel.belief,
        result.elapsed_s,
        result.end_reason,
        result.time_to_all_s,
        result.false_finds,
        path,
    )


def _placed(
    mission: Mission, sources: int | Sequence[TransientSource | tuple[float, float]], seed: int
) -> tuple[TransientSource, ...]:
    grid, said = mission.kernel.engine.grid, mission.file.sources
    if isinstance(sources, int):
        rng = np.random.default_rng([seed, 7])
        return tuple(
            random_sources(
                sources, grid.size_east_m, grid.size_north_m, said.power_levels_db, said.rate_hz, rng
            )
        )
    placed = tuple(
        each if isinstance(each, TransientSource) else TransientSource(each[0], each[1], 0.0, said.rate_hz)
        for each in sources
    )
    for source in placed:
        if not grid.contains(source.east_m, source.north_m):
            raise ConfigError(
                f"sources: expected places in the field of {grid.size_east_m:g} m x {grid.size_north_m:g} m, "
                f"got one at {source.east_m:g} m east, {source.north_m:g} m north"
            )
    return placed


def fly_simulated(
    mission: Mission, truth: Truth, seed: int, recording: Path | None, metadata: dict[str, Any]
) -> Result:
    """The loop with the mission's safety between kernel and robots, and a recorder where `recording` says."""
    safety = Safety(mission.safety)
    if recording is None:
        return run_loop(mission.kernel, truth, seed, on_step=_safely(safety))
    with ExitStack() as stack:
        writer = stack.enter_context(
            RecordingWriter(
                recording,
                mission_toml=mission.text,
                antenna_toml=mission.antenna_text,
                metadata={
                    **metadata,
                    **mission.recorded_settings,
                    "truth": [_plain(source) for source in truth.sources],
                },
                frame=mission.frame,
            )
        )
        steps = _Recorded(safety, writer)
        result = run_loop(mission.kernel, truth, seed, on_step=steps)
        steps.end(result)
    return result


def _plain(source: TransientSource) -> dict[str, float]:
    return {
        "east_m": source.east_m,
        "north_m": source.north_m,
        "power_db": source.power_db,
        "rate_hz": source.rate_hz,
    }


def _safely(safety: Safety) -> Callable[[Kernel, Event, Outcome], Iterable[Command]]:
    return lambda kernel, event, outcome: [*safety.observe(event), *safety.judge(outcome.commands)]


class _Recorded:
    """Sees every step, has safety judge it, and writes both down."""

    def __init__(self, safety: Safety, writer: RecordingWriter) -> None:
        self._safety, self._writer = safety, writer
        self._chronicle: Chronicle | None = None

    def __call__(self, kernel: Kernel, event: Event, outcome: Outcome) -> list[Command]:
        if self._chronicle is None:
            self._chronicle = Chronicle(kernel, self._safety, self._writer)
        return self._chronicle.step(event.t_ns, event, outcome)

    def end(self, result: Result) -> None:
        """Write how it went."""
        assert self._chronicle is not None  # a mission has events
        self._chronicle.end(round(result.elapsed_s * 1e9), result.end_reason)
