"""For the tests of the kernel: a mission whose belief and planner a test replaces cost nothing before it does."""

from dataclasses import replace
from pathlib import Path

from fieldkit.engine.grid import Grid
from mission.core.kernel_settings import KernelSettings
from mission.lab.synthetic import small_mission

S = 1_000_000_000


def light_settings(folder: Path) -> KernelSettings:
    """A coarse grid and a light belief, and pairs; it plans rarely and never ends by itself."""
    kernel = small_mission(folder).kernel
    rarely = replace(kernel.engine, planning_period_s=1000.0, grid=Grid(10.0, 10.0, 1.0), keep_teams=True)
    return replace(kernel, engine=rarely, belief="spog", max_duration_s=1e6, stop_probability_left=None)
