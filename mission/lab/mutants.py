"""How much the tests notice: single random changes to pure code, each run against its tests. A survivor is a gap.

A mutant is a copy of one module in which one comparison, sign, number, condition or command is another. It is killed
when a test fails. Run from a checkout with the development tools: the tests are not part of the wheel.
"""

import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fieldkit.errors import ConfigError

SHORT_CUT = "# a short cut"
"""Marks an `if` that only saves time. Never to take it gives the same answers; all other changes to it are drawn."""
TIMEOUT_S = 240.0
"""A mutant that hangs its tests is noticed as well."""
TARGETS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "safety": (
        ("mission/safety/rules.py", "mission/safety/limits.py", "mission/safety/monitor.py",
         "mission/safety/separation.py", "mission/safety/return_sequence.py", "fieldkit/geometry/turns.py"),
        ("tests/mission/test_safety.py", "tests/mission/test_escalation.py", "tests/mission/test_separation.py",
         "tests/mission/test_return_sequence.py", "tests/mission/test_monitor.py",
         "tests/mission/test_watched.py", "tests/mission/test_safety_rules.py",
         "tests/mission/test_separation_turns.py", "tests/mission/test_stopped_on_the_way_home.py",
         "tests/mission/test_released.py", "tests/geometry/test_turns.py"),
    ),
    "kernel": (
        ("mission/core/kernel.py", "mission/core/fleet.py", "mission/core/tasks.py", "mission/core/turns.py",
         "mission/core/endings.py"),
        ("tests/mission/test_kernel_parts.py", "tests/mission/test_kernel_belief.py",
         "tests/mission/test_kernel_rules.py", "tests/mission/test_kernel.py"),
    ),
    "association": (
        ("fieldkit/engine/association/detections.py",),
        ("tests/engine/test_association_rules.py", "tests/engine/test_detections.py"),
    ),
}  # fmt: skip
"""What is changed, and by which tests it is judged."""
_COMPARE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_BINARY: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip

Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Mutant:
    """One change."""

    path: str
    line: int
    before: str
    after: str
    source: str
    """The whole module, changed."""


def safety(trials: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Random single mutants of the safety code."""
    return run("safety", trials, seed, progress)


def kernel(trials: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Random single mutants of the mission's kernel."""
    return run("kernel", trials, seed, progress)


def association(trials: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Random single mutants of what makes detections of readings."""
    return run("association", trials, seed, progress)


def run(target: str, trials: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Draw `trials` mutants of a target without repetition, and count those that its tests kill."""
    root = Path(__file__).resolve().parents[2]
    if not (root / "tests").is_dir():
        raise ConfigError("mutants: the tests are not here; run this from a checkout")
    files, tests = TARGETS[target]
    every = [
        mutant for path in files for mutant in mutants_of(path, (root / path).read_text(encoding="utf-8"))
    ]
    drawn = random.Random(seed).sample(every, min(trials, len(every)))
    there = [str(root / test) for test in tests if (root / test).exists()]
    if is_killed(root, Mutant(files[0], 0, "", "", (root / files[0]).read_text(encoding="utf-8")), there):
        raise ConfigError(
            f"mutants: the tests fail on the code as it is, or take more than {TIMEOUT_S:.0f} s on this machine"
        )
    alive: list[Mutant] = []
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for done, (mutant, killed) in enumerate(
            zip(drawn, pool.map(lambda each: is_killed(root, each, there), drawn), strict=True), start=1
        ):
            if not killed:
                alive.append(mutant)
            progress(done / len(drawn), f"{done - len(alive)} of {done} killed")
    return {
        "study": f"mutants of {target}",
        "trials": len(drawn),
        "possible": len(every),
        "scenarios": {target: {"mutants": len(drawn), "killed": len(drawn) - len(alive)}},
        "killed_share": round(1.0 - len(alive) / max(1, len(drawn)), 4),
        "alive": [f"{m.path}:{m.line}: {m.before}  ->  {m.after}" for m in alive],
    }


def is_killed(root: Path, mutant: Mutant, tests: list[str]) -> bool:
    """Whether a test fails on a copy of the packages with this change. Tests of the changed file's name come first."""
    tests = sorted(tests, key=lambda test: Path(mutant.path).stem not in test)
    with tempfile.TemporaryDirectory(prefix="fieldkit-mutant-") as folder:
        package = mutant.path.split("/", 1)[0]
        # With the compiled files, which keep their times: only the changed module is compiled anew.
        shutil.copytree(root / package, Path(folder) / package, ignore=shutil.ignore_patterns("_manual"))
        (Path(folder) / mutant.path).write_text(mutant.source, encoding="utf-8")
        command = [
            sys.executable,
            "-P",
            "-m",
            "pytest",
            "-x",
            "-q",
            "-p",
            "no:cacheprovider",
            "-p",
            "no:xdist",
        ]
        command += ["-c", str(root / "pyproject.toml"), "--rootdir", str(root), *tests]
        environment = os.environ | {"PYTHONPATH": folder, "PYTHONDONTWRITEBYTECODE": "1"}
        try:
            ended = subprocess.run(
                command, cwd=folder, env=environment, capture_output=True, timeout=TIMEOUT_S, check=False
            )
        except subprocess.TimeoutExpired:
            return True
    return ended.returncode != 0


def mutants_of(path: str, source: str) -> Iterator[Mutant]:
    """Every single change to a module, but for its docstrings and annotations."""
    tree, lines = ast.parse(source), source.splitlines()
    spots = list(_code(tree))
    for index, node in enumerate(spots):
        for change in _changes(node):
            if change is _never and SHORT_CUT in lines[node.lineno - 1]:
                continue
            whole = copy.deepcopy(tree)
            twin = list(_code(whole))[index]
            before = ast.unparse(twin)
            changed = change(twin)
            if changed is not twin:
                _replace(whole, twin, changed)
            ast.fix_missing_locations(whole)
            yield Mutant(path, node.lineno, before, ast.unparse(changed), ast.unparse(whole))


def _code(tree: ast.Module) -> Iterator[Any]:
    """Nodes in functions that a change makes sense of, in the order of the source."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        body = function.body[1:] if ast.get_docstring(function) else function.body
        # `strict=True` of a `zip` asserts what holds for every input: no test can distinguish it from False.
        asserted = {
            id(k.value) for k in ast.walk(function) if isinstance(k, ast.keyword) and k.arg == "strict"
        }
        for statement in body:
            for node in ast.walk(statement):
                if isinstance(node, ast.FunctionDef | ast.JoinedStr) or id(node) in asserted:
                    continue
                if isinstance(
                    node, ast.Compare | ast.BoolOp | ast.BinOp | ast.UnaryOp | ast.Constant | ast.If
                ):
                    yield node


def _changes(node: Any) -> list[Callable[[Any], Any]]:
    """What may be done to one node: each takes the node's twin and gives what stands in its place."""
    match node:
        case ast.Compare(ops=[operator]) if type(operator) in _COMPARE:
            return [_with_operator]
        case ast.BoolOp():
            return [_other_connective]
        case ast.BinOp(op=operator) if type(operator) in _BINARY:
            return [_other_sign]
        case ast.UnaryOp(op=ast.Not()):
            return [lambda twin: twin.operand]
        case ast.Constant(value=bool()):
            return [_flipped]
        case ast.Constant(value=int() | float()):
            return [_another_number]
        case ast.If(orelse=[]):
            return [_never]
        case _:
            return []


def _with_operator(twin: ast.Compare) -> ast.AST:
    twin.ops = [_COMPARE[type(twin.ops[0])]()]
    return twin


def _other_connective(twin: ast.BoolOp) -> ast.AST:
    twin.op = ast.Or() if isinstance(twin.op, ast.And) else ast.And()
    return twin


def _other_sign(twin: ast.BinOp) -> ast.AST:
    twin.op = _BINARY[type(twin.op)]()
    return twin


def _flipped(twin: ast.Constant) -> ast.AST:
    twin.value = not twin.value
    return twin


def _another_number(twin: ast.Constant) -> ast.AST:
    assert isinstance(twin.value, int | float)
    twin.value = 1 if twin.value == 0 else -twin.value if abs(twin.value) < 1 else twin.value * 10
    return twin


def _never(twin: ast.If) -> ast.AST:
    twin.test = ast.Constant(False)
    return twin


def _replace(tree: ast.AST, old: ast.AST, new: Any) -> None:
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
                return
            if isinstance(value, list) and any(each is old for each in value):
                value[[each is old for each in value].index(True)] = new
                return
