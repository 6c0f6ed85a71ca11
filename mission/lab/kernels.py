"""`python -m mission.lab.kernels`: compile the engine's loops once, before many processes would each do it.

They are kept where numba keeps compiled code. A short mission of each system calls what that system needs.
"""

import tempfile
from pathlib import Path

from mission.lab.synthetic import record_simulated

SYSTEMS: tuple[tuple[int, dict[str, str | float | bool]], ...] = (
    (4, {}),
    (4, {"belief": "spog", "sensing": "pairwise", "planner": "prwa"}),
    (4, {"belief": "spog", "sensing": "pairwise", "planner": "dprwa"}),
    (3, {"belief": "spog", "planner": "rwa"}),
    (1, {"belief": "csma-pf", "planner": "probable"}),
)
"""Robots and the `[engine]` table of each."""
DURATION_S = 60.0
"""Long enough for a few transmissions to be heard and for a few plans."""


def compile_all() -> None:
    for robots, engine in SYSTEMS:
        with tempfile.TemporaryDirectory() as folder:
            record_simulated(Path(folder), robots=robots, engine=engine, duration_s=DURATION_S)


if __name__ == "__main__":
    compile_all()
