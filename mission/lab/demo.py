"""The demo: the PRWA paper's physical experiment on emulated radios and rovers, through the real drivers.

Four robots in two pairs look for three transmitters in a field of 10 m x 10 m with 50 x 50 cells. Each sends 0.1
packets a second at one of five power levels; robots drive at most 0.4 m/s (PRWA section VII.B). The radio channel
is the one that calibrating the example's readings log gives.
"""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fieldkit.errors import ConfigError, DataError
from fieldkit.files import write_whole
from fieldkit.messages import Operator
from fieldkit.world.sources import TransientSource, random_sources
from mission.core.mission_file import Mission, read_mission
from mission.core.template import TemplateRobot, mission_text
from mission.shell import setups
from mission.shell.flight import fly
from mission.shell.progress import Progress
from mission.shell.runner import Runner
from mission.shell.warm_up import warm_up

if TYPE_CHECKING:
    from mission.page.serve import LivePage

N_SOURCES = 3
FIELD_M = 10.0
CELL_M = 0.2
RATE_HZ = 0.1
POWER_LEVELS_DB = (-8.0, -6.0, -4.0, -2.0, 0.0)
"""The XBee-PRO's 10 to 18 dBm in steps of 2 dB, relative to the strongest, which the calibration used."""
SOURCE_SEPARATION_M = 1.0
CLOCK_RATE = 10.0
RESUMES_S = 5.0
"""Mission seconds that the demo's operator takes."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the demo found, against the truth it hid."""

    mission: Mission
    runner: Runner
    sources: tuple[TransientSource, ...]
    folder: Path

    def plain(self, seed: int) -> dict[str, Any]:
        """The result for `--json`."""
        return {
            "seed": seed,
            **compare(self.runner, self.sources),
            "recording": str(self.folder / "mission.mcap"),
        }


@dataclass
class PlayedOperator:
    """Resumes what its own failsafe has stopped, as an operator would.

    Under a fast clock a machine that is busy for a moment is silent for seconds, and vehicles stop by themselves.
    """

    runner: Runner | None = None
    heard_s: dict[str, float] = field(default_factory=dict)
    """Robot that waits for the operator to since when it is heard again."""

    def attach(self, runner: Runner) -> None:
        """The mission that it looks after."""
        self.runner = runner

    def look(self) -> None:
        """Resume who has been heard for a while, and waits."""
        if self.runner is None:
            return
        now_s = self.runner.setup.clock.elapsed_s()
        for name, robot in self.runner.safety.robots.items():
            heard = robot.vehicle is not None and robot.vehicle.link_up
            waits = robot.ordered == "withdraw" or (robot.called and not robot.ordered)
            if not (waits and heard):
                self.heard_s.pop(name, None)
            elif now_s - self.heard_s.setdefault(name, now_s) >= RESUMES_S:
                del self.heard_s[name]
                reason = "the demo's operator: it is heard again"
                self.runner.put(Operator(self.runner.setup.clock.now_ns(), "resume", name, reason=reason))


def example_readings() -> Path:
    """The readings log shipped with the examples, in a checkout or an installed package."""
    for path in (
        Path(__file__).parents[2] / "examples" / "readings.csv",
        Path(str(resources.files("fieldkit"))) / "_examples" / "readings.csv",
    ):
        if path.exists():
            return path
    raise ConfigError("examples/readings.csv is missing: is the installation complete?")


def calibrate(readings: Path, out: Path, how: tuple[str, ...] = ()) -> str:
    """Run `fieldkit calibrate fit` as a user would; what it said. The mission only ever sees the file."""
    command = [sys.executable, "-m", "fieldkit", "calibrate", "fit", str(readings), "-o", str(out), *how]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0 or not out.exists():
        raise DataError(f"calibrating {readings} failed:\n{done.stderr or done.stdout}")
    return done.stdout + done.stderr


def prepare(folder: Path, seed: int) -> tuple[Mission, tuple[TransientSource, ...]]:
    """Calibrate, write mission.toml and antenna.toml into the folder, and hide the sources."""
    calibrate(example_readings(), folder / "antenna.toml")
    robots = [TemplateRobot(f"r{number}", f"emulated-{number}", "emulated", number) for number in range(1, 5)]
    text = mission_text(
        name="demo",
        seed=seed,
        size_m=FIELD_M,
        cell_m=CELL_M,
        power_levels_db=POWER_LEVELS_DB,
        rate_hz=RATE_HZ,
        expected=float(N_SOURCES),
        planning_period_s=20.0,
        window_s=0.25,
        found_probability=0.95,  # the paper's 0.9 for each would leave a tenth of three-source missions one cell off
        engine={"found_within_m": CELL_M},
        max_duration_s=1500.0,
        sources_found=N_SOURCES,
        fence_margin_m=0.2,
        min_separation_m=0.5,
        overrun_s=3.0 * CLOCK_RATE,  # of the wall's 3 s: emulated time runs faster than the steering loop
        robots=robots,
    )
    write_whole(folder / "mission.toml", text)
    rng = np.random.default_rng([seed, 0xDE30])
    sources = random_sources(
        N_SOURCES, FIELD_M, FIELD_M, POWER_LEVELS_DB, RATE_HZ, rng, min_separation_m=SOURCE_SEPARATION_M
    )
    return read_mission(folder / "mission.toml"), tuple(sources)


def run(
    folder: Path,
    seed: int,
    *,
    rate: float = CLOCK_RATE,
    on_progress: Callable[[Progress], None] = lambda _: None,
    page: "LivePage | None" = None,
    prepared: tuple[Mission, tuple[TransientSource, ...]] | None = None,
) -> DemoResult:
    """One whole mission; its files are in `folder` afterwards. A `page` must be of the mission `prepared`."""
    mission, sources = prepared or prepare(folder, seed)
    warm_up(mission)
    operator = PlayedOperator()

    def look(progress: Progress) -> None:
        operator.look()
        on_progress(progress)

    with setups.emulated(mission, sources, seed=seed, rate=rate) as setup:
        runner = fly(
            mission,
            setup,
            folder / "mission.mcap",
            look,
            truth=sources,
            extra={"demo": True, "seed": seed},
            page=page,
            on_start=operator.attach,
        )
    return DemoResult(mission, runner, sources, folder)


def compare(runner: Runner, truth: tuple[TransientSource, ...]) -> dict[str, Any]:
    """Found against true: each source with its nearest find, finds that belong to none, digests.

    A source counts as found when a find lies within one cell of it (in each coordinate).
    """
    cell = runner.kernel.settings.engine.grid.cell_m
    finds = [s for s in runner.kernel.sources() if s.state == "found"]
    rows = []
    for source in truth:
        offsets = [(abs(f.east_m - source.east_m), abs(f.north_m - source.north_m), f) for f in finds]
        nearest = min(offsets, key=lambda o: max(o[0], o[1]), default=None)
        near = nearest is not None and max(nearest[0], nearest[1]) <= cell
        row: dict[str, Any] = {
            "true_east_m": round(source.east_m, 3),
            "true_north_m": round(source.north_m, 3),
            "true_power_db": source.power_db,
            "found": near,
            "east_m": None,
            "north_m": None,
            "error_m": None,
            "error_cells": None,
            "found_after_s": None,
        }
        if near and nearest is not None:
            find = nearest[2]
            row |= {
                "east_m": round(find.east_m, 3),
                "north_m": round(find.north_m, 3),
                "error_m": round(float(np.hypot(nearest[0], nearest[1])), 3),
                "error_cells": round(max(nearest[0], nearest[1]) / cell, 2),
                "found_after_s": round(runner.kernel.found_at_s.get(find.ident, float("nan")), 1),
            }
        rows.append(row)
    stray = [
        {"east_m": round(f.east_m, 3), "north_m": round(f.north_m, 3)}
        for f in finds
        if all(max(abs(f.east_m - s.east_m), abs(f.north_m - s.north_m)) > cell for s in truth)
    ]
    return {
        "sources": rows,
        "false_finds": len(stray),
        "false_positions": stray,
        "duration_s": round(max(runner.kernel.found_at_s.values(), default=0.0), 1),
        **runner.result(),
    }
