"""The page's JavaScript against the types of what it is sent and sends, by TypeScript's compiler. Nothing is built."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest

from mission.page.server import STATIC

HERE = Path(__file__).parent
COMPILER = HERE / "node_modules" / ".bin" / "tsc"
needs_compiler = pytest.mark.skipif(
    shutil.which("node") is None or not COMPILER.exists(),
    reason="no TypeScript on this machine: make page-types",
)


def faults(folder: Path) -> str:
    """What the compiler says of a folder with a tsconfig.json; empty where nothing is wrong."""
    done = subprocess.run([COMPILER, "-p", folder], capture_output=True, text=True)
    assert bool(done.returncode) == bool(done.stdout), done.stderr
    return done.stdout


@pytest.mark.parametrize("module", sorted(path.name for path in STATIC.glob("*.js")))
def test_each_module_is_checked_in_an_editor_too(module: str) -> None:
    assert (STATIC / module).read_text(encoding="utf-8").startswith("// @ts-check\n")


@needs_compiler
def test_the_pages_javascript_is_of_the_types_of_the_protocol() -> None:
    assert faults(HERE) == ""


@needs_compiler
@pytest.mark.parametrize(
    ("module", "right", "wrong"),
    [
        ("panels.js", "robot.reserve_pct", "robot.reserve"),
        ("model.js", "message.may_command", "message.mayCommand"),
        ("timeline.js", '{ kind: "look", t_s }', '{ kind: "look", time_s: t_s }'),
        ("turn.js", 'action: "bearing"', 'action: "bearings"'),
        ("walk.js", "goal[0] - here[0]", "goal[0] - mine.east_m"),
        ("plan.js", "found.verdict", "found.worst"),
        ("recorded.js", "data.hello.duration_s", "data.duration_s"),
    ],
)
def test_a_misspelt_field_is_found(tmp_path: Path, module: str, right: str, wrong: str) -> None:
    shutil.copytree(STATIC, tmp_path / "static")
    path = tmp_path / "static" / module
    text = path.read_text(encoding="utf-8")
    assert right in text
    path.write_text(text.replace(right, wrong), encoding="utf-8")
    config = {"extends": str(HERE / "tsconfig.json"), "include": ["static/*.js", "static/*.d.ts"]}
    (tmp_path / "tsconfig.json").write_text(json.dumps(config), encoding="utf-8")
    assert f"{module}(" in faults(tmp_path)
