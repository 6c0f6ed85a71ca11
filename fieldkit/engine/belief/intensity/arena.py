"""One long array that holds many rows of unlike sizes, for loops that read many of them in one call.

A loop is handed `Arena.values` and where the rows begin. A row lives as long as somebody holds its `Row`; room that
nobody holds any more is reclaimed when the array is full. Rows are never written again.

Rows are kept in single precision: most of a belief's memory is rows, and a log-likelihood of 100 nats is right to 4e-6
then, far less than what the passes over them leave out. They are added up in double precision.
"""

import copy
import weakref
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fieldkit.messages import FloatArray, IntArray

Kept = NDArray[np.float32]
FIRST_SIZE = 4096
SPARE = 1.25
"""So many times the size of what is held an array has after it has grown, or has become too large."""
UNKNOWN = -1
"""Stands for the beginning of a row that does not exist."""


class Row:
    """A row's place in its arena."""

    __slots__ = ("__weakref__", "_arena", "shape", "size", "start")

    def __init__(self, arena: "Arena", start: int, shape: tuple[int, ...], size: int) -> None:
        self._arena, self.start, self.shape, self.size = arena, start, shape, size

    @property
    def array(self) -> FloatArray:
        """The row in double precision; a copy, not to be written to."""
        values = self._arena.values[self.start : self.start + self.size]
        row = values.astype(np.float64).reshape(self.shape)
        row.flags.writeable = False
        return row

    def at(self, *index: int) -> float:
        """One number of it."""
        return float(self._arena.values[self.start + int(np.ravel_multi_index(index, self.shape))])


class Arena:
    """Rows of float32 one after another."""

    def __init__(self) -> None:
        self.values: Kept = np.empty(FIRST_SIZE, dtype=np.float32)
        self._rows: list[weakref.ref[Row]] = []
        self._used = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> "Arena":
        """With rows of its own: the references alone would lead to the rows of the arena that was copied."""
        twin = memo[id(self)] = Arena()
        twin.values, twin._used = self.values.copy(), self._used
        held = [row for row in (each() for each in self._rows) if row is not None]
        twin._rows = [weakref.ref(copy.deepcopy(row, memo)) for row in held]
        return twin

    def put(self, array: FloatArray) -> Row:
        """A copy of `array`, of any shape, for as long as the row is held."""
        if self._used + array.size > self.values.size:
            self._make_room(array.size)
        row = Row(self, self._used, array.shape, array.size)
        self.values[row.start : row.start + row.size] = array.ravel()
        self._used += row.size
        self._rows.append(weakref.ref(row))
        return row

    def held(self) -> int:
        """Numbers in rows that somebody holds."""
        return sum(row.size for row in (each() for each in self._rows) if row is not None)

    def _make_room(self, size: int) -> None:
        """Close the gaps between rows that somebody holds, so that `size` more fit and not much besides.

        In place: at the time when most is held there is no room for a second array.
        """
        held = [row for row in (each() for each in self._rows) if row is not None]
        at = 0
        for row in held:
            self.values[at : at + row.size] = self.values[row.start : row.start + row.size]
            row.start = at
            at += row.size
        self._used = at
        self._rows = [weakref.ref(row) for row in held]
        wanted = max(FIRST_SIZE, int(SPARE * (at + size)))
        # With little room to spare it would be full again after a few rows; with very much it is given back.
        if not wanted <= self.values.size <= 2 * wanted:
            self.values.resize(wanted, refcheck=False)  # nobody keeps a view of it


def starts(rows: list[Row]) -> IntArray:
    """(k,) where each begins, good until the next row is put into the arena."""
    return np.array([row.start for row in rows], dtype=np.int64)


def starts_table(columns: list[list[Row | None]], height: int) -> NDArray[np.int64]:
    """(height, c) the same of a table, given by its columns; `UNKNOWN` where there is none."""
    table = [[UNKNOWN if row is None else row.start for row in column] for column in columns]
    return np.ascontiguousarray(np.array(table, dtype=np.int64).reshape(len(columns), height).T)
