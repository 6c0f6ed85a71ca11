"""One recording gives the same belief on every Python it is asked for: FIELDKIT_PYTHONS=/a/bin/python:/b/bin/python.

Each must have fieldkit installed. Without the variable there is nothing to compare with, and the test is skipped.
"""

import os
import subprocess
from pathlib import Path

import pytest

from fieldkit.recording import open_recording
from mission.lab.synthetic import record_simulated

PYTHONS = [path for path in os.environ.get("FIELDKIT_PYTHONS", "").split(os.pathsep) if path]
CODE = """
import sys
from pathlib import Path
from mission.replay.replay import replay
done = replay(Path(sys.argv[1]))
print(done.kernel.digest(), done.compared)
"""


SYSTEMS: dict[str, dict[str, str | float | bool]] = {
    "default": {},
    "prwa": {"belief": "spog", "sensing": "pairwise", "prior_rule": "dirichlet", "planner": "prwa"},
    "dprwa": {"belief": "spog", "sensing": "pairwise", "prior_rule": "em", "planner": "dprwa"},
    "csma-pf": {"belief": "csma-pf", "planner": "probable"},
}


@pytest.mark.skipif(not PYTHONS, reason="FIELDKIT_PYTHONS names no other Python")
@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("python", PYTHONS)
def test_another_python_comes_to_the_same_belief(python: str, system: str, tmp_path: Path) -> None:
    log = record_simulated(tmp_path, seed=3, duration_s=200.0, sources_found=99, engine=SYSTEMS[system])
    result = open_recording(log).result()
    assert result is not None
    done = subprocess.run([python, "-c", CODE, str(log)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [result["belief_hash"], str(result["events"])]
