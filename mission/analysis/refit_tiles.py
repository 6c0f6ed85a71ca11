"""A wide ground in tiles: each a belief of its own over the tile and one longest range around it.

A source in a tile is heard by nobody further away than that range, and its rivals just outside the tile are believed in
as well. So a tile needs what robots heard and where they listened while within two such ranges, and says of its own
ground what one belief over everything would say.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fieldkit.engine.belief.intensity.mixture import ears_of, model_of
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import FloatArray, SourceEstimate

MOST_CELLS = 250_000
"""A tile's cells grow until there are no more: the belief's memory goes with them."""
GROWTH = 1.4
"""A belief's work grows as this power of its ground: with what was heard there, and each update with the sources there
(`fieldkit bench scale`: slope 0.35 of an update over sources, 0.05 over cells)."""
SIGMAS = 3.0
"""Two tiles' estimates of one source lie no further apart than so many of its deviations."""


@dataclass(frozen=True, slots=True)
class Tile:
    """Part of the ground: from its south-west corner on, up to its other borders and without them."""

    number: int
    west_m: float
    south_m: float
    east_m: float
    north_m: float
    """Tiles at the ground's border go on for ever: what is found outside the ground belongs to them."""
    grid: Grid
    """Of its belief: the tile and one longest range around it, as far as the ground goes."""
    heard: Grid
    """Of robots in here it needs to know: another longest range wider; one cell."""
    share: float
    """Of its belief's ground that is the tile's own."""

    def holds(self, east_m: float, north_m: float) -> bool:
        """Whether a place is in the tile; of any place that is true of one tile."""
        return self.west_m <= east_m < self.east_m and self.south_m <= north_m < self.north_m

    def beyond_m(self, east_m: float, north_m: float) -> float:
        """How far a place is outside the tile."""
        return float(
            np.hypot(
                max(self.west_m - east_m, 0.0, east_m - self.east_m),
                max(self.south_m - north_m, 0.0, north_m - self.north_m),
            )
        )


def longest_range_m(engine: EngineSettings) -> float:
    """Beyond this not one packet in 500 of the strongest source is heard."""
    return model_of(engine, ears_of(engine)).reach_m


def tiles_of(ground: Grid, reach_m: float, wanted: tuple[int, int] | None = None) -> tuple[Tile, ...]:
    """The ground in tiles: as many as make the least work, or `wanted` from west to east and from south to north."""
    sizes_m = (ground.size_east_m, ground.size_north_m)
    columns, rows = wanted or tuple(_best_count(size_m, reach_m) for size_m in sizes_m)
    cells_east, cells_north = (
        _borders(n, count) for n, count in ((ground.n_east, columns), (ground.n_north, rows))
    )
    tiles: list[Tile] = []
    for south, north in pairwise(cells_north):
        for west, east in pairwise(cells_east):
            tiles.append(_tile(len(tiles), ground, (west, south, east, north), reach_m))
    return tuple(tiles)


def _best_count(size_m: float, reach_m: float) -> int:
    """Tiles along one side with the least work: that of a tile is of the tile and up to two ranges on either side."""

    def work(count: int) -> float:
        borders = np.linspace(0.0, size_m, count + 1)
        low, high = (
            np.maximum(borders[:-1] - 2.0 * reach_m, 0.0),
            np.minimum(borders[1:] + 2.0 * reach_m, size_m),
        )
        return float(((high - low) ** GROWTH).sum())

    return min(range(1, max(1, int(size_m / reach_m)) + 1), key=work)


def _borders(cells: int, count: int) -> list[int]:
    return [round(border) for border in np.linspace(0, cells, min(count, cells) + 1).tolist()]


def _tile(number: int, ground: Grid, cells: tuple[int, int, int, int], reach_m: float) -> Tile:
    west, south, east, north = cells
    margin = int(np.ceil(reach_m / ground.cell_m))
    low = max(0, west - margin), max(0, south - margin)
    high = min(ground.n_east, east + margin), min(ground.n_north, north + margin)
    grid = _grown(_part(ground, *low, *high))
    heard = Grid(
        grid.size_east_m + 2.0 * reach_m,
        grid.size_north_m + 2.0 * reach_m,
        max(grid.size_east_m, grid.size_north_m) + 2.0 * reach_m,
        grid.west_m - reach_m,
        grid.south_m - reach_m,
    )
    return Tile(
        number,
        west * ground.cell_m if west else -np.inf,
        south * ground.cell_m if south else -np.inf,
        east * ground.cell_m if east < ground.n_east else np.inf,
        north * ground.cell_m if north < ground.n_north else np.inf,
        grid,
        heard,
        (east - west) * (north - south) / ((high[0] - low[0]) * (high[1] - low[1])),
    )


def _part(ground: Grid, west: int, south: int, east: int, north: int) -> Grid:
    """Those cells of the ground; the last row and column are cut as the ground's are."""
    cell_m = ground.cell_m
    return Grid(
        ground.size_east_m - west * cell_m if east == ground.n_east else (east - west) * cell_m,
        ground.size_north_m - south * cell_m if north == ground.n_north else (north - south) * cell_m,
        cell_m,
        ground.west_m + west * cell_m,
        ground.south_m + south * cell_m,
    )


def _grown(grid: Grid) -> Grid:
    return replace(
        grid, cell_m=max(grid.cell_m, float(np.sqrt(grid.size_east_m * grid.size_north_m / MOST_CELLS)))
    )


def engine_of(tile: Tile, engine: EngineSettings) -> EngineSettings:
    """The settings of a tile's belief: as many sources a square metre are expected as on the whole ground."""
    part_m2 = tile.grid.size_east_m * tile.grid.size_north_m
    whole_m2 = engine.grid.size_east_m * engine.grid.size_north_m
    expected = (
        engine.expected_sources if part_m2 == whole_m2 else engine.expected_sources * part_m2 / whole_m2
    )
    return replace(engine, grid=tile.grid, expected_sources=expected)


def owned(tiles: Sequence[Tile], believed: Sequence[Sequence[SourceEstimate]]) -> list[SourceEstimate]:
    """Each source once, numbered from 1, from what each tile's belief believes; as they are where there is one tile.

    A tile has the sources whose estimate lies in it. Near a border two tiles may each see a source just inside, or just
    outside: those that are the nearest to each other, and within their deviations, are one. It belongs to the tile
    that the mean of their places lies in.
    """
    if len(tiles) == 1:
        return list(believed[0])
    taken = []
    for same in _same_sources(tiles, believed):
        mean = np.mean([(source.east_m, source.north_m) for _, source in same], axis=0)
        owner = next(tile for tile in tiles if tile.holds(*mean.tolist()))
        its = [source for tile, source in same if tile is owner]
        if not its and len(same) > 1:
            its = [min(same, key=lambda each: each[0].beyond_m(each[1].east_m, each[1].north_m))[1]]
        taken += its[:1]
    return [_renumbered(source, number) for number, source in enumerate(taken, start=1)]


def _same_sources(
    tiles: Sequence[Tile], believed: Sequence[Sequence[SourceEstimate]]
) -> list[list[tuple[Tile, SourceEstimate]]]:
    """What each source is to the tiles that believe in it, in order of the first of these."""
    groups = {
        (tile.number, k): [(tile, source)] for tile in tiles for k, source in enumerate(believed[tile.number])
    }
    for first in tiles:
        for second in tiles[first.number + 1 :]:
            for k, m in _twins(first, believed[first.number], second, believed[second.number]):
                group, other = groups[first.number, k], groups[second.number, m]
                if group is not other:
                    group += other
                    groups |= {key: group for key, each in groups.items() if each is other}
    return list({id(group): group for group in groups.values()}.values())


def _twins(
    first: Tile, here: Sequence[SourceEstimate], second: Tile, there: Sequence[SourceEstimate]
) -> list[tuple[int, int]]:
    """Pairs of numbers: sources of two tiles' beliefs that are the nearest to each other, and near enough to be one."""
    if not here or not there:
        return []
    one, two = (np.array([(each.east_m, each.north_m) for each in its]) for its in (here, there))
    apart_m = np.hypot(*(one[:, None] - two).transpose(2, 0, 1))
    near_m = np.maximum(_near_m(first, here)[:, None], _near_m(second, there))
    apart_m = np.where(apart_m <= near_m, apart_m, np.inf)
    nearest, back = apart_m.argmin(axis=1), apart_m.argmin(axis=0)
    return [(k, int(m)) for k, m in enumerate(nearest) if np.isfinite(apart_m[k, m]) and back[m] == k]


def _near_m(tile: Tile, sources: Sequence[SourceEstimate]) -> FloatArray:
    """(n,) how far another estimate of the same source may be."""
    sigma_m = np.sqrt([float(np.trace(each.cov_m2)) / 2.0 for each in sources])
    return np.maximum(SIGMAS * sigma_m, 2.0 * tile.grid.cell_m)


def _renumbered(source: SourceEstimate, number: int) -> SourceEstimate:
    """Numbers that its note has for others hold in its own tile only, and go; the places beside them stay."""
    return replace(source, ident=number, note=re.sub(r"\bsource \d+ at\b", "a source at", source.note))


def probability_left(tiles: Sequence[Tile], left: Sequence[float]) -> float:
    """Probability that a source is left anywhere, from that of each tile's belief.

    What a belief expects to be left counts by the share of its ground that is the tile's own; tiles are independent.
    """
    if len(tiles) == 1:
        return left[0]
    expected = sum(
        -np.log1p(-min(each, 1.0 - 1e-12)) * tile.share for tile, each in zip(tiles, left, strict=True)
    )
    return float(-np.expm1(-expected))
