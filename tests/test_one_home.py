"""No limit or default stands in two places: what has a home in fieldkit.settings is not written out again."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import MISSING, fields

from test_layout import ROOT, files

from fieldkit import settings
from fieldkit.engine.settings import EngineSettings
from fieldkit.settings import Quantity
from mission.core.kernel_settings import KernelSettings
from mission.core.tables import AssociationTable, EndTable, EngineTable, SafetyTable, SourcesTable

HOME = {name.lower(): value for name, value in vars(settings).items() if name.isupper()}
ALIKE = {
    "GOES_ON_WITH_PILOT": "the emulator is written against the manual, not against the driver it tests",
    "ROBOTS": "each bench says how large its own fleet is",
    "SCHEMA": "each file format counts its own versions",
    "STEP_S": "each emulated thing has its own step of time",
}
NO_CHOICE = (None, "", 0, 1, -1)
"""Nothing, none or one of it: True and False among them."""
OTHER_THINGS = {
    "name": "of a grid's colours, and of other things",
    "origin": "who gave a command, in the words of the recording",
    "size_m": "of a whole field, or of what a camera sees",
}
"""Names under which different things happen to have one default."""


def sources() -> Iterator[tuple[str, ast.Module]]:
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith("tests/"):
            yield name, ast.parse(path.read_text(encoding="utf-8"))


def constants(tree: ast.Module) -> Iterator[tuple[str, object]]:
    """What fields and arguments are by default where that is written out, by name."""
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
            if isinstance(value, ast.Constant):
                yield name, value.value


def defaults(tree: ast.Module) -> Iterator[tuple[str, float]]:
    """The numbers among these."""
    for name, value in constants(tree):
        if type(value) in (int, float):
            yield name, float(value)  # type: ignore[arg-type]


def test_no_default_of_settings_is_written_out_again() -> None:
    again = [
        (path, name)
        for path, tree in sources()
        for name, value in defaults(tree)
        # Nothing at all (0 m high, 0 dB more) is the origin of a scale, and no choice of anybody's.
        if isinstance(home := HOME.get(name), Quantity) and value == home.default != 0.0
    ]
    assert again == []


def test_an_engine_and_a_mission_file_that_say_nothing_mean_the_same() -> None:
    """Names differ between the two, so the test above would not see a number that stands in both."""
    table = {**dict(EngineTable()), **dict(SafetyTable()), **{f"sources.{k}": v for k, v in SourcesTable()}}
    names = {
        "reference_rate_hz": "sources.rate_hz",
        "expected_sources": "sources.expected",
        "source_up_m": "sources.up_m",
        "power_levels_db": "sources.power_levels_db",
        "identity": "sources.identity",
    }
    engine = {each.name: each.default for each in fields(EngineSettings) if each.default is not MISSING}
    no_choice = {"keep_out", "spread", "seed"}
    assert {name: table[names.get(name, name)] for name in engine.keys() - no_choice} == {
        name: value for name, value in engine.items() if name not in no_choice
    }
    kernel = {each.name: each.default for each in fields(KernelSettings)}
    association = AssociationTable()
    assert (
        kernel["association_window_s"],
        kernel["association_lateness_s"],
        kernel["max_pose_gap_s"],
        kernel["belief"],
        kernel["planner"],
        kernel["max_duration_s"],
    ) == (
        association.window_s,
        association.lateness_s,
        association.max_pose_gap_s,
        EngineTable().belief,
        EngineTable().planner,
        EndTable().max_duration_s,
    )


def test_no_default_of_one_name_is_written_out_twice() -> None:
    homes: dict[tuple[str, object], list[str]] = defaultdict(list)
    for path, tree in sources():
        for name, value in constants(tree):
            if value not in NO_CHOICE and name not in OTHER_THINGS:
                homes[name, value].append(path)
    assert {each: paths for each, paths in homes.items() if len(paths) > 1} == {}


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
