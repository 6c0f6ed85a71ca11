"""A file is one idea and a function one thought: nothing grows beyond a page or two without a stated reason."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("fieldkit", "calibration", "drivers", "mission", "tests", "docs")
MOST_LINES_OF_A_FILE = 450
MOST_LINES_OF_A_FUNCTION = 60

OPTIONS = "a command: its options are declared in its signature, and its own steps are fewer"
LOOP = "one compiled loop: calls inside it cost time, and its plain twin in the tests has the parts"
LONG_FILES: dict[str, str] = {}
LONG_FUNCTIONS: dict[str, str] = {
    "calibration/cli.py fit": OPTIONS,
    "calibration/cli_collect.py collect": OPTIONS,
    "calibration/cli_update.py update": OPTIONS,
    "drivers/positions/cli.py survey": OPTIONS,
    "mission/cli/agent.py agent": OPTIONS,
    "mission/cli/missions.py replay": OPTIONS,
    "mission/cli/walk.py walk": OPTIONS,
    "mission/core/template.py mission_text": "what may be chosen, with defaults, and where each goes in the text",
    "fieldkit/engine/belief/intensity/loops.py attribute": LOOP,
    "fieldkit/engine/likelihood/correlated_loops.py log_marginal": LOOP,
    "fieldkit/engine/likelihood/levels_loops.py conditional_loglik": LOOP,
    "fieldkit/engine/likelihood/places_loops.py choose_neighbours": LOOP,
    "fieldkit/engine/planning/spacing_loops.py spacing_entropy": LOOP,
}


def files() -> list[Path]:
    """Ours; what is built from them (the manual inside the package) is none."""
    return sorted(
        path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py") if "_manual" not in path.parts
    )


def functions(source: str) -> Iterator[tuple[str, int, int]]:
    """Name, lines, and lines without signature and docstring of every function."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            steps = node.body[1:] if ast.get_docstring(node) is not None else node.body
            end = node.end_lineno or node.lineno
            yield node.name, end - node.lineno + 1, end - steps[0].lineno + 1 if steps else 0


def long_files(lines_of: dict[str, int]) -> dict[str, int]:
    return {name: lines for name, lines in lines_of.items() if lines > MOST_LINES_OF_A_FILE}


def long_functions(sources: dict[str, str]) -> dict[str, tuple[int, int]]:
    return {
        f"{path} {name}": (lines, steps)
        for path, source in sources.items()
        for name, lines, steps in functions(source)
        if lines > MOST_LINES_OF_A_FUNCTION
    }


@pytest.fixture(scope="module")
def sources() -> dict[str, str]:
    return {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in files()}


def test_no_file_is_longer_than_an_idea(sources: dict[str, str]) -> None:
    found = long_files({name: source.count("\n") for name, source in sources.items()})
    assert found.keys() <= LONG_FILES.keys(), "part it along its ideas, or give the reason here"
    assert found.keys() == LONG_FILES.keys(), "shorter by now: take it off the list"


def test_no_function_is_longer_than_a_thought(sources: dict[str, str]) -> None:
    found = long_functions(sources)
    assert found.keys() <= LONG_FUNCTIONS.keys(), "part it, or give the reason here"
    assert found.keys() == LONG_FUNCTIONS.keys(), "shorter by now: take it off the list"
    for name, (_, steps) in found.items():
        if LONG_FUNCTIONS[name] is OPTIONS:
            assert steps <= MOST_LINES_OF_A_FUNCTION, name


def test_the_count_sees_what_is_too_long() -> None:
    body = "    x = 1\n" * MOST_LINES_OF_A_FUNCTION
    assert long_functions({"a.py": f"async def f():\n{body}"}) == {"a.py f": (61, 60)}
    assert not long_functions({"a.py": f"def f():\n{body[:-10]}"})
    assert long_files({"a.py": 451, "b.py": 450}) == {"a.py": 451}
