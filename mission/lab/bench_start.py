"""`fieldkit bench start`: how long a notebook and a command line wait before anything happens."""

import subprocess
import sys
from typing import Any

from fieldkit.clock import wall_s

TIMES = 9


def start() -> dict[str, Any]:
    """Least and median wall seconds of `import fieldkit` (beyond Python's own start) and of `fieldkit --help`."""
    bare = _timed("-c", "pass")
    imported = _timed("-c", "import fieldkit")
    helped = _timed("-m", "fieldkit", "--help")
    middle = TIMES // 2
    return {
        "python_s": [round(bare[0], 3), round(bare[middle], 3)],
        "import_s": [round(imported[0] - bare[0], 3), round(imported[middle] - bare[middle], 3)],
        "help_s": [round(helped[0], 3), round(helped[middle], 3)],
    }


def _timed(*arguments: str) -> list[float]:
    """Wall seconds of a Python process, sorted."""
    seconds = []
    for _ in range(TIMES):
        before = wall_s()
        subprocess.run([sys.executable, *arguments], stdout=subprocess.DEVNULL, check=True)
        seconds.append(wall_s() - before)
    return sorted(seconds)
