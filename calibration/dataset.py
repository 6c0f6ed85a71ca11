"""Readings as arrays: what was heard where, which packets were missed, what belongs to one place.

A place is what the standard errors are clustered by: readings taken there share its shadowing. It is the
`place` column (with `transmitter` where there is one), else a cell of positions, else the distance.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry import alternatives, climb, geometry
from calibration.table import Table, read_table
from fieldkit.errors import DataError
from fieldkit.messages import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """n packets: `rss_dbm` (n,) with nan where the packet was sent and not received."""

    name: str
    distance_m: FloatArray
    rss_dbm: FloatArray
    place: IntArray
    """(n,) index into `places`."""
    places: tuple[str, ...]
    heading_deg: FloatArray | None = None
    """(n,) direction to the other radio as the antenna sees it, clockwise from its front; None: not known."""
    gain_db: FloatArray | None = None
    """(n,) known gain towards the other radio, from a pattern; None: the same all round."""
    receiver: IntArray | None = None
    receivers: tuple[str, ...] = ()
    order: FloatArray | None = None
    """(n,) time in seconds, or the sample number: only for plots and for finding runs."""
    tx_m: FloatArray | None = None
    """(n, 2) east, north; None where only distances were given."""
    rx_m: FloatArray | None = None
    climb_m: FloatArray | None = None
    """(n,) how much higher the receiver was than the transmitter; None where the file gives no heights."""
    warnings: tuple[str, ...] = ()
    sha256: str = ""
    alternatives: dict[str, FloatArray] = field(default_factory=dict)
    """What may be wrong with the coordinates, in words, to the distances (n,) there would be without it."""

    @property
    def missed(self) -> NDArray[np.bool_]:
        """(n,) True where a packet was sent and not received."""
        return np.isnan(self.rss_dbm)

    @property
    def n_places(self) -> int:
        return len(np.unique(self.place))

    def keep(self, rows: NDArray[np.bool_]) -> "Readings":
        """Only some rows, (n,) True where kept."""

        def cut(array: NDArray[Any] | None) -> NDArray[Any] | None:
            return None if array is None else array[rows]

        return replace(
            self,
            distance_m=self.distance_m[rows],
            rss_dbm=self.rss_dbm[rows],
            place=self.place[rows],
            heading_deg=cut(self.heading_deg),
            gain_db=cut(self.gain_db),
            receiver=cut(self.receiver),
            order=cut(self.order),
            tx_m=cut(self.tx_m),
            rx_m=cut(self.rx_m),
            climb_m=cut(self.climb_m),
            alternatives={name: distance[rows] for name, distance in self.alternatives.items()},
        )


def from_arrays(
    distance_m: FloatArray,
    rss_dbm: FloatArray,
    place: NDArray[Any] | None = None,
    *,
    name: str = "arrays",
    **more: object,
) -> Readings:
    """Readings from arrays (n,); without `place` each distance is one."""
    keys = np.asarray(distance_m if place is None else place)
    names, index = np.unique(keys, return_inverse=True)
    return Readings(
        name,
        np.asarray(distance_m, dtype=float),
        np.asarray(rss_dbm, dtype=float),
        index.reshape(-1),
        tuple(map(str, names)),
        **more,  # type: ignore[arg-type]
    )


def read_readings(
    path: Path,
    *,
    names: Mapping[str, str] | None = None,
    where: Mapping[str, str] | None = None,
    place_cell_m: float | None = None,
    negate: bool = False,
    relative: bool = False,
    text: str | None = None,
) -> Readings:
    """Read and check a CSV, or `text` that was made of one. Raises `DataError` naming file, line and remedy."""
    from calibration import sanity

    table = read_table(path, names=names, where=where, text=text)
    if "rss_dbm" not in table.columns:
        raise DataError(
            f"{path}: no column of readings; name one rss_dbm, or map yours: --column rss_dbm=NAME. "
            f"There are {', '.join(table.others)}"
        )
    if not len(table):
        raise DataError(f"{path}: has a header and no rows")
    rss = table.numbers("rss_dbm", empty=float("nan"))
    rss = -rss if negate else rss
    if not relative:
        sanity.check_levels(table, rss)
    elif np.isnan(rss).all():
        raise table.error(0, "no packet was received in the whole file: there is nothing to fit")
    distance, tx, rx, notes = geometry(table)
    place, places = _places(table, distance, tx, rx, place_cell_m)
    receiver, receivers = _codes(table.columns["receiver"]) if "receiver" in table.columns else (None, ())
    heading = table.numbers("heading_deg") if "heading_deg" in table.columns else None
    readings = Readings(
        name=path.name,
        distance_m=distance,
        rss_dbm=rss,
        place=place,
        places=places,
        heading_deg=heading,
        receiver=receiver,
        receivers=receivers,
        order=_order(table),
        tx_m=tx,
        rx_m=rx,
        climb_m=climb(table),
        warnings=tuple(notes),
        alternatives=alternatives(table, tx, rx),
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
    )
    readings, more = sanity.check_rows(table, readings)
    return replace(readings, warnings=(*readings.warnings, *more, *sanity.check_clocks(table, readings)))


def _places(
    table: Table, distance: FloatArray, tx: FloatArray | None, rx: FloatArray | None, cell_m: float | None
) -> tuple[IntArray, tuple[str, ...]]:
    have = table.columns
    if "place" in have and cell_m is None:
        keys = have["place"]
        if "transmitter" in have:
            keys = [f"{place} {tx_name}" for place, tx_name in zip(keys, have["transmitter"], strict=True)]
        return _codes(keys)
    if tx is not None and rx is not None:
        cell = cell_m if cell_m is not None else (10.0 if "rx_lat_deg" in have else 0.01)
        cells = np.floor(np.column_stack([tx, rx]) / cell + 0.5).astype(np.int64)
        return _codes([" ".join(map(str, row)) for row in cells.tolist()])
    return _codes([f"{d:g} m" for d in distance.tolist()])


def _codes(texts: list[str]) -> tuple[IntArray, tuple[str, ...]]:
    """(n,) index and the distinct texts in the order of their first row."""
    index: dict[str, int] = {}
    codes = [index.setdefault(text, len(index)) for text in texts]
    return np.array(codes, dtype=np.int64), tuple(index)


def _order(table: Table) -> FloatArray | None:
    for name in ("time", "sample"):
        if name not in table.columns:
            continue
        texts = table.columns[name]
        try:
            values = np.array([seconds(text) for text in texts])
        except ValueError:
            continue
        return values * 1e-9 if np.nanmax(np.abs(values)) > 1e15 else values
    return None


def seconds(text: str) -> float:
    """A number, or hh:mm:ss as seconds of the day."""
    parts = text.split(":")
    if len(parts) == 3:
        return float(parts[0]) * 3600.0 + float(parts[1]) * 60.0 + float(parts[2])
    return float(text)
