"""What holds for every test: no claim about time, since machines are slow and busy, and nothing is left running."""

import asyncio
import os
import threading
from asyncio import runners
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from sizes import size

from fieldkit.cli import BLAS_THREADS

for _name in BLAS_THREADS:  # as the command does, and before anything loads numpy
    os.environ.setdefault(_name, "1")

# The same examples in each run: a commit passes or fails, and does not do both. HYPOTHESIS=explore draws others.
settings.register_profile("fieldkit", deadline=None, derandomize=True, max_examples=size(50, 100))
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS", "fieldkit"))

KEPT_BY_LIBRARIES = (
    "asyncio_",
    "ThreadPoolExecutor",
    "QueueFeederThread",
    "QueueManagerThread",
    "Dask",
    "IO loop",
)
"""Beginnings of the names of threads that libraries keep in pools for their next use."""
LONG = tuple(
    f"test_{name}"
    for name in (
        "campaign_of_missions", "campaigns", "commands", "compare_beliefs", "fault_study", "pairs_apart", "placed",
        "reality_study", "refit", "replay", "report", "resume", "study_command", "systems", "walk", "what_if",
        "bench_agents",
    )
)  # fmt: skip
"""Tests that fly whole missions, or do one thing hundreds of times. What they reach, others reach too."""
ENDING_S = 5.0
"""How long threads may take that were told to end: they poll a port or a socket."""

_left_tasks: list[str] = []
_cancel_all_tasks = runners._cancel_all_tasks  # type: ignore[attr-defined]


def _note_left_tasks(loop: asyncio.AbstractEventLoop) -> None:
    """An event loop that closes cancels what is left on it: that is a leak, unless the test itself was cancelled."""
    _left_tasks.extend(
        repr(task) for task in asyncio.all_tasks(loop) if not (task.cancelling() or _closes_a_generator(task))
    )
    _cancel_all_tasks(loop)


def _closes_a_generator(task: "asyncio.Task[object]") -> bool:
    """The loop itself makes a task that closes an asynchronous generator nobody iterates any more."""
    return type(task.get_coro()).__name__ == "async_generator_athrow"


runners._cancel_all_tasks = _note_left_tasks  # type: ignore[attr-defined]


@pytest.fixture(autouse=True)
def nothing_is_left_running() -> Iterator[None]:
    """Fail a test that leaves a thread; those that fixtures of a wider scope have started are theirs."""
    before = set(threading.enumerate())
    yield
    left = [
        thread
        for thread in threading.enumerate()
        if thread not in before and not thread.name.startswith(KEPT_BY_LIBRARIES)
    ]
    for thread in left:
        thread.join(ENDING_S / len(left))
    alive = [repr(thread) for thread in left if thread.is_alive()]
    if alive:
        pytest.fail(f"the test leaves threads running: {', '.join(alive)}")


def _rooms_by_turns(items: list[pytest.Item]) -> None:
    """A file of each room, then the next of each: what waits for wires and browsers runs beside what is short.

    All at once they would starve each other, and all at the end one process would be waited for.
    """
    places: dict[Path, int] = {}
    of_room: Counter[str] = Counter()
    for item in items:
        if item.path not in places:
            room = item.path.parent.name
            places[item.path] = of_room[room]
            of_room[room] += 1
    items.sort(key=lambda item: places[item.path])


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The order of the tests, and which of them coverage is counted in."""
    _rooms_by_turns(items)
    _count_coverage(items)


def _count_coverage(items: list[pytest.Item]) -> None:
    """Count coverage only in short tests of the rooms it is stated for: traced, tests take up to half as long again."""
    if os.environ.get("FIELDKIT_COVERAGE") == "all":
        return
    for item in items:
        if item.path.parent.name != "mission" or item.path.stem in LONG:
            item.add_marker(pytest.mark.no_cover)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    """Fail a test whose event loop was closed with tasks on it."""
    result = yield
    left, _left_tasks[:] = list(_left_tasks), []
    if left:
        pytest.fail(f"the test leaves tasks running: {'; '.join(left)}")
    return result  # type: ignore[return-value]
