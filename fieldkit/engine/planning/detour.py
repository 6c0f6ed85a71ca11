"""Shortest ways round ground that must not be entered (RWA section VI.D: non-traversable cells).

On the grid: 8-connected cells whose centres are free and whose steps cross nothing, Dijkstra by scipy; corners that
can be cut without crossing anything are cut.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from fieldkit.engine.grid import Grid
from fieldkit.engine.keepout import KeepOut
from fieldkit.messages import FloatArray


class Detours:
    """Ways on one grid round one set of polygons; the graph is made once."""

    def __init__(self, grid: Grid, keep_out: KeepOut) -> None:
        self.grid, self.keep_out = grid, keep_out
        self._graph = None if not keep_out.polygons else _graph(grid, keep_out)

    def way(self, start_m: FloatArray, end_m: FloatArray) -> FloatArray | None:
        """(k, 2) corners from `start_m` (left out) to `end_m`; None where no way leads there."""
        if self._graph is None or not self.keep_out.blocks(start_m[None], end_m[None])[0]:
            return end_m[None].copy()
        if self.keep_out.contains(end_m[None])[0]:
            return None
        source, target = self._nearest_free(start_m), self._nearest_free(end_m)
        if source is None or target is None:
            return None
        _, before = dijkstra(self._graph, indices=source, return_predecessors=True)
        cells = [target]
        while cells[-1] != source:
            previous = int(before[cells[-1]])
            if previous < 0:
                return None
            cells.append(previous)
        centres = self.grid.centres_m[cells[::-1]]
        return self._cut_corners(np.concatenate([start_m[None], centres, end_m[None]]))

    def _nearest_free(self, place_m: FloatArray) -> int | None:
        """The nearest cell that can be reached from the place in a straight line."""
        centres = self.grid.centres_m
        for index in np.argsort(np.hypot(*(centres - place_m).T), kind="stable")[:25]:
            if not self.keep_out.blocks(place_m[None], centres[index][None])[0]:
                return int(index)
        return None

    def _cut_corners(self, corners_m: FloatArray) -> FloatArray:
        kept, at = [], 0
        while at < len(corners_m) - 1:
            ahead = np.arange(len(corners_m) - 1, at, -1)
            blocked: NDArray[np.bool_] = self.keep_out.blocks(
                np.repeat(corners_m[at][None], len(ahead), axis=0), corners_m[ahead]
            )
            free = ahead[~blocked]
            at = int(free[0]) if len(free) else at + 1
            kept.append(corners_m[at])
        return np.array(kept)


def _graph(grid: Grid, keep_out: KeepOut) -> coo_matrix:
    index = np.arange(grid.n_cells).reshape(grid.shape)
    rows, columns, lengths = [], [], []
    centres = grid.centres_m
    for dn, de in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = index[: grid.n_north - dn, max(0, -de) : grid.n_east - max(0, de)].ravel()
        b = index[dn:, max(0, de) : grid.n_east + min(0, de)].ravel()
        free = ~(keep_out.blocks(centres[a], centres[b]) | keep_out.contains(centres[a]))
        rows.append(a[free])
        columns.append(b[free])
        lengths.append(np.full(int(free.sum()), grid.cell_m * np.hypot(dn, de)))
    row, column, length = np.concatenate(rows), np.concatenate(columns), np.concatenate(lengths)
    both = (np.concatenate([row, column]), np.concatenate([column, row]))
    return coo_matrix((np.concatenate([length, length]), both), shape=(grid.n_cells,) * 2).tocsr()
