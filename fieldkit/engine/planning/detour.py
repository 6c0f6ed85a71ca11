"""Shortest ways round ground that must not be entered (RWA section VI.D: non-traversable cells).

On the grid: 8-connected cells whose centres are free and whose steps cross nothing, Dijkstra by scipy; corners that
can be cut without crossing anything are cut. Large fields are walked on larger cells. Where there is room, ways keep
`self.clearance_m` off: a robot counts as arrived a little before a corner, and then cuts it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import dijkstra

from fieldkit.engine.grid import Grid
from fieldkit.geometry.polygons import KeepOut
from fieldkit.messages import FloatArray

MOST_CELLS = 10_000
NEAREST = 25
"""Cells tried for the first and the last step of a way."""


class Detours:
    """Ways on one grid round one set of polygons, `margin_m` inside the field's border; the graph is made once."""

    def __init__(self, grid: Grid, keep_out: KeepOut, margin_m: float, clearance_m: float) -> None:
        coarser = max(1.0, math.sqrt(grid.n_cells / MOST_CELLS))
        self.grid = Grid(grid.size_east_m, grid.size_north_m, grid.cell_m * coarser) if coarser > 1 else grid
        self.keep_out, self.margin_m, self.clearance_m = keep_out, margin_m, clearance_m
        self._meshes: dict[float, _Mesh] = {}

    def way(self, start_m: FloatArray, end_m: FloatArray) -> FloatArray | None:
        """(k, 2) corners from `start_m` (left out) to `end_m`; None where no way leads there."""
        if not self.keep_out.needs_detours:
            return end_m[None].copy()
        if self.keep_out.contains(end_m[None])[0]:
            return None
        if self.keep_out.contains(start_m[None])[0]:  # out of it first, and then on
            out_m = np.array(self.keep_out.nearest_open((float(start_m[0]), float(start_m[1]))))
            onward = None if self.keep_out.contains(out_m[None])[0] else self.way(out_m, end_m)
            return None if onward is None else np.concatenate([out_m[None], onward])
        for clearance_m in (self.clearance_m, 0.0):  # the second where it is too narrow for the first
            if self._open(start_m[None], end_m[None], clearance_m)[0]:
                return end_m[None].copy()
            if (way := self._round(start_m, end_m, clearance_m)) is not None:
                return way
        return None

    def ways(self, places_m: FloatArray, start_m: FloatArray) -> FloatArray:
        """Places (legs, m, 2) of m robots from `start_m` (m, 2), with the corners of detours put in between.

        A robot with fewer corners than the others waits at its last; one that cannot reach its place stays where it
        is; a leg on which nobody can move is left out.
        """
        if not self.keep_out.needs_detours:
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
        if not self.keep_out.needs_detours:
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
        for clearance_m in (self.clearance_m, 0.0):
            centres = self.grid.centres_m[self._mesh(clearance_m).free]
            if len(centres):
                return np.asarray(centres[np.argmin(np.hypot(*(centres - place_m).T))])
        return place_m

    def _open(self, start_m: FloatArray, end_m: FloatArray, clearance_m: float) -> NDArray[np.bool_]:
        """(k,) whether straight ways (k, 2) touch nothing and come no nearer than the clearance, or than their ends."""
        if clearance_m <= 0.0:
            return ~self.keep_out.blocks(start_m, end_m)
        ends = [self.keep_out.distance_m(place, place) for place in (start_m, end_m)]
        least = np.minimum(clearance_m, np.minimum(*ends)) - 1e-9
        return ~self.keep_out.blocks(start_m, end_m) & (self.keep_out.distance_m(start_m, end_m) >= least)

    def _round(self, start_m: FloatArray, end_m: FloatArray, clearance_m: float) -> FloatArray | None:
        mesh = self._mesh(clearance_m)
        source = self._first_cell(start_m, mesh, clearance_m)
        target = self._first_cell(end_m, mesh, clearance_m)
        if source is None or target is None:
            return None
        _, before = dijkstra(mesh.graph, indices=source, return_predecessors=True)
        cells = [target]
        while cells[-1] != source:
            previous = int(before[cells[-1]])
            if previous < 0:
                return None
            cells.append(previous)
        centres = self.grid.centres_m[cells[::-1]]
        return self._cut_corners(np.concatenate([start_m[None], centres, end_m[None]]), clearance_m)

    def _first_cell(self, place_m: FloatArray, mesh: "_Mesh", clearance_m: float) -> int | None:
        """The nearest free cell that can be reached from the place in a straight line."""
        away = np.hypot(*(self.grid.centres_m[mesh.free] - place_m).T)
        cells = mesh.free[np.argsort(away, kind="stable")[:NEAREST]]
        centres = self.grid.centres_m[cells]
        free = self._open(np.repeat(place_m[None], len(cells), axis=0), centres, clearance_m)
        return int(cells[np.argmax(free)]) if free.any() else None

    def _cut_corners(self, corners_m: FloatArray, clearance_m: float) -> FloatArray:
        kept, at = [], 0
        while at < len(corners_m) - 1:
            ahead = np.arange(len(corners_m) - 1, at, -1)
            here = np.repeat(corners_m[at][None], len(ahead), axis=0)
            free = ahead[self._open(here, corners_m[ahead], clearance_m)]
            at = int(free[0]) if len(free) else at + 1
            kept.append(corners_m[at])
        return np.array(kept)

    def _mesh(self, clearance_m: float) -> "_Mesh":
        if clearance_m not in self._meshes:
            self._meshes[clearance_m] = self._make_mesh(clearance_m)
        return self._meshes[clearance_m]

    def _make_mesh(self, clearance_m: float) -> "_Mesh":
        grid, centres = self.grid, self.grid.centres_m
        high = np.array([grid.size_east_m, grid.size_north_m]) - self.margin_m
        usable = ((self.margin_m <= centres) & (centres <= high)).all(axis=1)
        away_m = self.keep_out.distance_m(centres, centres)
        usable &= (away_m > 0.0) & (away_m >= clearance_m)
        index = np.arange(grid.n_cells).reshape(grid.shape)
        rows, columns, lengths = [], [], []
        for dn, de in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = index[: grid.n_north - dn, max(0, -de) : grid.n_east - max(0, de)].ravel()
            b = index[dn:, max(0, de) : grid.n_east + min(0, de)].ravel()
            both = usable[a] & usable[b]
            a, b = a[both], b[both]
            step_m = grid.cell_m * np.hypot(dn, de)
            free = (
                away_m[a] + away_m[b] > 2.0 * clearance_m + step_m
            )  # so far off that nothing need be looked at
            free[~free] = self._open(centres[a[~free]], centres[b[~free]], clearance_m)
            rows.append(a[free])
            columns.append(b[free])
            lengths.append(np.full(int(free.sum()), step_m))
        row, column, length = np.concatenate(rows), np.concatenate(columns), np.concatenate(lengths)
        there_and_back = (np.concatenate([row, column]), np.concatenate([column, row]))
        size = (grid.n_cells, grid.n_cells)
        graph = coo_matrix((np.concatenate([length, length]), there_and_back), shape=size).tocsr()
        return _Mesh(np.flatnonzero(usable), graph)


@dataclass(frozen=True, slots=True, eq=False)
class _Mesh:
    """Cells one may stand in the middle of, and the distances between those that are neighbours."""

    free: NDArray[np.intp]
    graph: csr_matrix


def shares_of_length(corners_m: FloatArray) -> FloatArray:
    """(k,) what each leg between corners (k + 1, 2) is of the whole length; even where there is none."""
    length = np.hypot(*np.diff(corners_m, axis=0).T)
    total = float(length.sum())
    return np.asarray(length / total) if total > 0.0 else np.full(len(length), 1.0 / len(length))
