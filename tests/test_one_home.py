"""No limit or default stands in two places: what has a home in fieldkit.settings is not written out again."""

import ast
from collections import defaultdict
from collections.abc import Iterator

from test_layout import ROOT, files

from fieldkit import settings
from fieldkit.settings import Quantity

HOME = {name.lower(): value for name, value in vars(settings).items() if name.isupper()}
WRITTEN_AGAIN = {
    "fieldkit/engine/settings.py": "awaits its turn",
    "fieldkit/engine/association/detections.py": "awaits its turn",
}
"""Files that may, and why."""
ALIKE = {
    "GOES_ON_WITH_PILOT": "the emulator is written against the manual, not against the driver it tests",
    "ROBOTS": "each bench says how large its own fleet is",
    "SCHEMA": "each file format counts its own versions",
    "STEP_S": "each emulated thing has its own step of time",
}


def sources() -> Iterator[tuple[str, ast.Module]]:
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith("tests/"):
            yield name, ast.parse(path.read_text(encoding="utf-8"))


def defaults(tree: ast.Module) -> Iterator[tuple[str, float]]:
    """Numbers that fields and arguments are by default, by name."""
    for node in ast.walk(tree):
        pairs: list[tuple[str, ast.expr | None]] = []
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            pairs = [(node.target.id, node.value)]
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            places = [*given.posonlyargs, *given.args]
            pairs = [
                (place.arg, value)
                for place, value in zip(reversed(places), reversed(given.defaults), strict=False)
            ]
            pairs += [(a.arg, v) for a, v in zip(given.kwonlyargs, given.kw_defaults, strict=True)]
        for name, value in pairs:
            if isinstance(value, ast.Constant) and type(value.value) in (int, float):
                yield name, float(value.value)


def test_no_default_of_settings_is_written_out_again() -> None:
    again = [
        (path, name)
        for path, tree in sources()
        for name, value in defaults(tree)
        # Nothing at all (0 m high, 0 dB more) is the origin of a scale, and no choice of anybody's.
        if isinstance(home := HOME.get(name), Quantity) and value == home.default != 0.0
    ]
    assert [f"{path} {name}" for path, name in again if path not in WRITTEN_AGAIN] == []


def test_no_two_files_have_the_same_constant() -> None:
    homes: dict[tuple[str, str], list[str]] = defaultdict(list)
    for path, tree in sources():
        for node in tree.body:
            match node:
                case ast.Assign(
                    targets=[ast.Name(id=name)], value=ast.Constant(value=int() | float()) as value
                ):
                    homes[name, repr(value.value)].append(path)
    twice = {name: paths for (name, _), paths in homes.items() if len(paths) > 1 and name not in ALIKE}
    assert twice == {}


def test_the_defaults_are_seen() -> None:
    tree = ast.parse("class A:\n    x_m: float = 2.0\ndef f(a, y_m=3, *, z_m=4.0, w=None): ...")
    assert sorted(defaults(tree)) == [("x_m", 2.0), ("y_m", 3.0), ("z_m", 4.0)]
