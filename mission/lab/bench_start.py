"""`fieldkit bench start`: how long a notebook and a command line wait before anything happens."""

import os
import subprocess
import sys
from typing import Any

from fieldkit.clock import wall_s

TIMES = 9


def start() -> dict[str, Any]:
    """Seconds of `import fieldkit` (beyond Python's own start) and of `fieldkit --help`, the least and the median.

    Wall time, and processor time, which other work on the machine lengthens less (0 on Windows, where it is not known).
    """
    bare, imported, helped = (
        _timed(*command)
        for command in (("-c", "pass"), ("-c", "import fieldkit"), ("-m", "fieldkit", "--help"))
    )
    result: dict[str, Any] = {}
    for kind, of in (("", 0), ("cpu_", 1)):
        result |= {
            f"python_{kind}s": _least_and_median(bare[of], 0.0),
            f"import_{kind}s": _least_and_median(imported[of], bare[of][0]),
            f"help_{kind}s": _least_and_median(helped[of], 0.0),
        }
    return result


def _least_and_median(seconds: list[float], beyond_s: float) -> list[float]:
    return [round(seconds[0] - beyond_s, 3), round(seconds[TIMES // 2] - beyond_s, 3)]


def _timed(*arguments: str) -> tuple[list[float], list[float]]:
    """Wall and processor seconds of a Python process, each sorted."""
    wall, cpu = [], []
    for _ in range(TIMES):
        before_s, before = wall_s(), os.times()
        subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
        after = os.times()
        wall.append(wall_s() - before_s)
        cpu.append(
            after.children_user - before.children_user + after.children_system - before.children_system
        )
    return sorted(wall), sorted(cpu)
