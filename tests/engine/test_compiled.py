"""Compiled loops where nothing can be written: a fallback folder, or none; never an error."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

UNWRITABLE = """
import os, sys
from numba.core import caching
real = caching._CacheLocator.ensure_cache_path
allowed = sys.argv[1]

def ensure(self):
    if not (allowed and self.get_cache_path().startswith(allowed)):
        raise OSError(30, "Read-only file system", self.get_cache_path())
    real(self)

caching._CacheLocator.ensure_cache_path = ensure
import fieldkit.engine.by_name
from fieldkit.engine.compiled import _fallback
from fieldkit.engine import bits
from fieldkit import EngineSettings, Grid, Antenna, belief_names, planner_names, make_belief, plugins
for name in belief_names():
    plugins.load("fieldkit.beliefs", name)
for name in planner_names():
    plugins.load("fieldkit.planners", name)
belief = make_belief("spog", EngineSettings(Grid(4.0, 4.0, 1.0), Antenna(2.5, -62.0, 3.0, -70.0), (("r1", "r2"),)))
print(belief.presence().shape, _fallback())
"""


def run(tmp_path: Path, allowed: str, temporary: Path) -> str:
    """What a process says in which numba may write only below `allowed`."""
    clean = {name: value for name, value in os.environ.items() if name not in ("HOME", "NUMBA_CACHE_DIR")}
    done = subprocess.run(
        [sys.executable, "-c", UNWRITABLE, allowed],
        env={**clean, "TMPDIR": str(temporary)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_read_only_installation_without_a_home_keeps_compiled_code_in_the_temporary_folder(
    tmp_path: Path,
) -> None:
    said = run(tmp_path, str(tmp_path), tmp_path)
    folder = tmp_path / f"fieldkit-compiled-{os.getuid() if hasattr(os, 'getuid') else 0}"
    assert said.split(") ")[1].strip() == str(folder)
    assert eval(said.split(") ")[0] + ")") == (4, 4)
    assert folder.stat().st_mode & 0o077 == 0


def test_a_loop_is_compiled_anew_when_a_function_that_it_calls_has_changed(tmp_path: Path) -> None:
    """Inlined or not, at first hand or through another: numba alone would keep what it compiled before."""
    compiled = "from fieldkit.engine.compiled import njit\n"
    (tmp_path / "inner.py").write_text(
        f"{compiled}from innermost import through\n"
        "@njit(cache=True, inline='always')\ndef twice(x):\n    return through(x)\n"
    )
    (tmp_path / "loop.py").write_text(
        f"{compiled}from inner import twice\n@njit(cache=True)\ndef loop(x):\n    return twice(x)\n"
    )

    def innermost(factor: str) -> None:
        (tmp_path / "innermost.py").write_text(
            f"{compiled}@njit(cache=True)\ndef through(x):\n    return {factor} * x\n"
        )

    def said() -> list[str]:
        """What the loop makes of 3, and how often it was found compiled."""
        asked = "from loop import loop; print(loop(3.0), sum(loop.stats.cache_hits.values()))"
        done = subprocess.run(
            [sys.executable, "-c", asked],
            env={**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.split()

    innermost("2.0")
    assert said() == ["6.0", "0"]
    innermost("10.25")  # of another length: the clocks of files are coarse
    assert said() == ["30.75", "0"]
    assert said() == ["30.75", "1"]


def test_where_nothing_at_all_can_be_written_the_engine_still_works(tmp_path: Path) -> None:
    assert run(tmp_path, "", tmp_path).startswith("(4, 4)")


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners are a matter of POSIX")
def test_a_folder_that_others_may_write_to_is_not_used(tmp_path: Path) -> None:
    folder = tmp_path / f"fieldkit-compiled-{os.getuid()}"
    folder.mkdir()
    folder.chmod(0o777)
    said = run(tmp_path, str(tmp_path), tmp_path)
    assert said.strip() == "(4, 4) None"
    assert list(folder.iterdir()) == []
