"""Rows of unlike sizes in one array: what is held stays as it was put in, what is not held makes room."""

import copy
import gc
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st

from fieldkit.engine.belief.intensity.arena import FIRST_SIZE, SPARE, UNKNOWN, Arena, starts, starts_table


@budget(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3_000)), max_size=60), st.randoms())
def test_rows_that_are_held_stay_as_they_were_put_in(acts, random) -> None:  # type: ignore[no-untyped-def]
    arena, held = Arena(), []
    for number, (drop, size) in enumerate(acts):
        if drop and held:
            held.pop(random.randrange(len(held)))
        array = np.full((size,), float(number))
        held.append((arena.put(array), array))
    for row, array in held:
        assert (row.array == array).all()
        assert (arena.values[row.start : row.start + row.size] == array).all()
    rows = sorted((row.start, row.size) for row, _ in held if row.size)
    assert all(start + size <= following for (start, size), (following, _) in itertools.pairwise(rows))


def test_room_is_bounded_by_what_is_held() -> None:
    arena = Arena()
    for number in range(1_000):
        row = arena.put(np.full((3, 100), float(number)))
    gc.collect()
    assert arena.values.size == FIRST_SIZE
    assert row.array.shape == (3, 100)
    assert (row.array == 999.0).all()


def test_what_is_read_of_a_row_outlives_its_move() -> None:
    arena = Arena()
    dropped, row = arena.put(np.zeros(100)), arena.put(np.arange(10.0))
    read = row.array
    del dropped
    others = [arena.put(np.ones(FIRST_SIZE)) for _ in range(3)]
    assert row.start == 0
    assert (read == np.arange(10.0)).all()
    assert (row.array == read).all()
    assert len(others) == 3


def test_an_array_has_little_room_to_spare_however_it_grew_or_shrank() -> None:
    arena, held = Arena(), []
    for number in range(400):
        held.append(arena.put(np.full(1_000, float(number))))
        needed = sum(row.size for row in held)
        assert arena.held() == needed
        assert arena.values.size <= max(FIRST_SIZE, SPARE * needed)
    held = held[-20:]
    for number in range(400):
        held = [*held[1:], arena.put(np.full(1_000, float(number)))]
    assert arena.values.size <= 2 * SPARE * 21_000
    assert [float(row.array[0]) for row in held] == [float(n) for n in range(380, 400)]


def test_rows_are_right_to_single_precision_and_read_in_double() -> None:
    row = Arena().put(np.array([[np.pi, -100.0], [1e-30, 0.0]]))
    assert row.array.dtype == np.float64
    assert row.array == pytest.approx(np.array([[np.pi, -100.0], [1e-30, 0.0]]), rel=6e-8)
    assert row.at(0, 1) == -100.0 and row.at(1, 1) == 0.0


def test_a_copy_moves_its_own_rows_and_no_others() -> None:
    arena = Arena()
    dropped, row = arena.put(np.zeros(100)), arena.put(np.arange(10.0))
    twin, twins_row = copy.deepcopy((arena, row))
    del dropped
    twin.put(np.ones(FIRST_SIZE))  # no room: the copy's rows move
    assert row.start == 100 and (row.array == np.arange(10.0)).all()
    assert twins_row.start < 100 and (twins_row.array == row.array).all()
    assert (twin.values[twins_row.start : twins_row.start + 10] == row.array).all()


def test_a_row_cannot_be_written_to() -> None:
    row = Arena().put(np.arange(3.0))
    with pytest.raises(ValueError, match="read-only"):
        row.array[0] = 1.0


def test_what_is_not_known_has_no_beginning() -> None:
    arena = Arena()
    first, second = arena.put(np.zeros(5)), arena.put(np.zeros(7))
    assert starts([first, second]).tolist() == [0, 5]
    assert starts_table([[first, None], [None, second]], 2).tolist() == [[0, UNKNOWN], [UNKNOWN, 5]]
    assert starts_table([], 2).shape == (2, 0)
