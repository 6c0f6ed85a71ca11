"""Shortest ways round ground that must not be entered (RWA section VI.D: non-traversable cells).

On the grid: 8-connected cells whose centres are free and whose steps cross nothing, Dijkstra by scipy; corners that
can be cut without crossing anything are cut. Large fields are walked on larger cells.
"""

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from fieldkit.engine.grid import Grid
from fieldkit.engine.keepout import KeepOut
from fieldkit.messages import FloatArray

MOST_CELLS = 40_000
NEAREST = 25
"""Cells tried for the first and the last step of a way."""


class Detours:
    """Ways on one grid round one set of polygons, `margin_m` inside the field's border; the graph is made once."""

    def __init__(self, grid: Grid, keep_out: KeepOut, margin_m: float = 0.0) -> None:
        coarser = max(1.0, math.sqrt(grid.n_cells / MOST_CELLS))
        self.grid = Grid(grid.size_east_m, grid.size_north_m, grid.cell_m * coarser) if coarser > 1 else grid
        self.keep_out, self.margin_m = keep_out, margin_m

    def way(self, start_m: FloatArray, end_m: FloatArray) -> FloatArray | None:
        """(k, 2) corners from `start_m` (left out) to `end_m`; None where no way leads there."""
        if not self.keep_out.polygons or not self.keep_out.blocks(start_m[None], end_m[None])[0]:
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

    def ways(self, places_m: FloatArray, start_m: FloatArray) -> FloatArray:
        """Places (legs, m, 2) of m robots from `start_m` (m, 2), with the corners of detours put in between.

        A robot with fewer corners than the others waits at its last; one that cannot reach its place stays where it
        is; a leg on which nobody can move is left out.
        """
        if not self.keep_out.polygons:
            return places_m
        here, legs = start_m, []
        for place in places_m:
            ways = [self.way(a, b) for a, b in zip(here, place, strict=True)]
            steps = max((len(way) for way in ways if way is not None), default=0)
            leg = np.repeat(here[None], steps, axis=0)
            for robot, way in enumerate(ways):
                if way is not None:
                    leg[:, robot] = way[np.minimum(np.arange(steps), len(way) - 1)]
            if steps:
                legs.append(leg)
                here = leg[-1]
        return np.concatenate(legs) if legs else np.empty((0, *start_m.shape))

    def timed(self, t_s: FloatArray, places_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """When (k,) one robot is at which places (k, 2), with detours put in between; it is at the first already.

        Between two places it goes evenly. Places that cannot be reached are left out.
        """
        if not self.keep_out.polygons:
            return t_s, places_m
        times, places = [t_s[:1]], [places_m[:1]]
        for moment, place in zip(t_s[1:], places_m[1:], strict=True):
            way = self.way(places[-1][-1], place)
            if way is not None:
                share = shares_of_length(np.concatenate([places[-1][-1:], way]))
                begin = times[-1][-1]
                times.append(begin + np.cumsum(share) * (moment - begin))
                places.append(way)
        return np.concatenate(times), np.concatenate(places)

    def nearest(self, place_m: FloatArray) -> FloatArray:
        """(2,) the middle of the free cell nearest to a place; the place itself where no cell is free."""
        if len(self._free) == 0:
            return place_m
        return np.asarray(self._free_m[np.argmin(np.hypot(*(self._free_m - place_m).T))])

    def _nearest_free(self, place_m: FloatArray) -> int | None:
        """The nearest cell on some way that can be reached from the place in a straight line."""
        cells = self._free[np.argsort(np.hypot(*(self._free_m - place_m).T), kind="stable")[:NEAREST]]
        centres = self.grid.centres_m[cells]
        blocked = self.keep_out.blocks(np.repeat(place_m[None], len(cells), axis=0), centres)
        return None if len(cells) == 0 or blocked.all() else int(cells[np.argmin(blocked)])

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

    @cached_property
    def _free(self) -> NDArray[np.intp]:
        """Cells a robot may stand in the middle of."""
        east, north = self.grid.centres_m.T
        low, high_east = self.margin_m, self.grid.size_east_m - self.margin_m
        inside = (low <= east) & (east <= high_east)
        inside &= (low <= north) & (north <= self.grid.size_north_m - self.margin_m)
        return np.flatnonzero(inside & ~self.keep_out.contains(self.grid.centres_m))

    @cached_property
    def _free_m(self) -> FloatArray:
        return self.grid.centres_m[self._free]

    @cached_property
    def _graph(self) -> coo_matrix:
        """Distances between free cells that are neighbours."""
        grid, centres = self.grid, self.grid.centres_m
        index = np.arange(grid.n_cells).reshape(grid.shape)
        usable = np.zeros(grid.n_cells, dtype=bool)
        usable[self._free] = True
        rows, columns, lengths = [], [], []
        for dn, de in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = index[: grid.n_north - dn, max(0, -de) : grid.n_east - max(0, de)].ravel()
            b = index[dn:, max(0, de) : grid.n_east + min(0, de)].ravel()
            both = usable[a] & usable[b]
            a, b = a[both], b[both]
            free = ~self.keep_out.blocks(centres[a], centres[b])
            rows.append(a[free])
            columns.append(b[free])
            lengths.append(np.full(int(free.sum()), grid.cell_m * np.hypot(dn, de)))
        row, column, length = np.concatenate(rows), np.concatenate(columns), np.concatenate(lengths)
        there_and_back = (np.concatenate([row, column]), np.concatenate([column, row]))
        size = (grid.n_cells, grid.n_cells)
        return coo_matrix((np.concatenate([length, length]), there_and_back), shape=size).tocsr()


def shares_of_length(corners_m: FloatArray) -> FloatArray:
    """(k,) what each leg between corners (k + 1, 2) is of the whole length; even where there is none."""
    length = np.hypot(*np.diff(corners_m, axis=0).T)
    total = float(length.sum())
    return np.asarray(length / total) if total > 0.0 else np.full(len(length), 1.0 / len(length))
