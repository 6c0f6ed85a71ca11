"""Distances out of a readings file: given, or from positions in metres or in latitude and longitude."""

from collections.abc import Mapping

import numpy as np

from calibration.table import Table
from fieldkit.errors import DataError
from fieldkit.messages import FloatArray

_TX_RX = ("tx_east_m", "tx_north_m", "rx_east_m", "rx_north_m")
_LAT_LON = ("tx_lat_deg", "tx_lon_deg", "rx_lat_deg", "rx_lon_deg")


def geometry(table: Table) -> tuple[FloatArray, FloatArray | None, FloatArray | None, list[str]]:
    """Distances (n,), and positions (n, 2) where the file gives them."""
    have = table.columns
    tx = rx = None
    higher = climb(table)
    _check_heights(table)
    if all(name in have for name in _TX_RX):
        east0, north0, east1, north1 = (table.numbers(name) for name in _TX_RX)
        tx, rx = np.column_stack([east0, north0]), np.column_stack([east1, north1])
    elif all(name in have for name in _LAT_LON):
        tx, rx = _local(table)
    between = (
        None
        if tx is None or rx is None
        else np.hypot(np.hypot(*(rx - tx).T), 0.0 if higher is None else higher)
    )
    if "distance_m" not in have and between is None:
        raise DataError(
            f"{table.path}: no distances; give distance_m, or {', '.join(_TX_RX)}, or {', '.join(_LAT_LON)}"
        )
    notes: list[str] = []
    if "distance_m" in have:
        distance = table.numbers("distance_m")
        if between is not None:
            far_off = np.abs(distance - between) > 0.05 + 0.05 * distance
            if far_off.any():
                row = int(np.argmax(far_off))
                factor = float(np.median(distance[far_off] / np.maximum(between[far_off], 1e-9)))
                if far_off.mean() > 0.5 and not 0.5 < factor < 2.0:
                    raise table.error(
                        row,
                        f"distance_m is {distance[row]:g} m and the positions are {between[row]:.3g} m apart, and so "
                        f"in {far_off.sum()} rows: a factor of {factor:.3g} between them; correct the unit of one, or "
                        "leave out the wrong columns",
                    )
                notes.append(
                    f"{far_off.sum()} rows have a distance_m that their positions contradict, first in "
                    f"line {table.lines[row]} ({distance[row]:g} m against {between[row]:.3g} m); "
                    "distance_m was used"
                )
    else:
        assert between is not None
        distance = between
    if np.any(distance <= 0.0):
        row = int(np.argmax(distance <= 0.0))
        raise table.error(
            row,
            f"the distance is {distance[row]:g} m ({(distance <= 0.0).sum()} such rows); it must be above zero: "
            "correct the positions, or delete the row",
        )
    return distance, tx, rx, notes


def climb(table: Table) -> FloatArray | None:
    """(n,) how much higher the receiver was; None without heights of both ends."""
    if "tx_up_m" not in table.columns or "rx_up_m" not in table.columns:
        return None
    return table.numbers("rx_up_m") - table.numbers("tx_up_m")


def _check_heights(table: Table) -> None:
    """Heights of one end only cannot be used, and leaving them out in silence would be two dimensions for three."""
    given = [name for name in ("tx_up_m", "rx_up_m") if name in table.columns]
    if len(given) != 1:
        return
    heights = table.numbers(given[0])
    if np.ptp(heights) > 0.0 or heights[0] != 0.0:
        other = "rx_up_m" if given[0] == "tx_up_m" else "tx_up_m"
        raise DataError(f"{table.path}: has {given[0]} and no {other}: give both heights, or neither")


def _local(table: Table) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude as metres east and north of the first receiver."""
    values = {name: table.numbers(name) for name in _LAT_LON}
    for name in ("tx_lat_deg", "rx_lat_deg"):
        wrong = np.abs(values[name]) > 90.0
        if wrong.any():
            row = int(np.argmax(wrong))
            raise table.error(
                row,
                f"{name} is {values[name][row]:g}: a latitude is -90 to 90; latitude and longitude look swapped: "
                "exchange the two columns' names",
            )
    for end in ("tx", "rx"):
        nowhere = (values[f"{end}_lat_deg"] == 0.0) & (values[f"{end}_lon_deg"] == 0.0)
        if nowhere.any() and not nowhere.all():
            row = int(np.argmax(nowhere))
            raise table.error(
                row,
                f"{end}_lat_deg and {end}_lon_deg are 0 ({nowhere.sum()} such rows): the receiver of positions "
                "had no fix yet; delete these rows",
            )
    return _metres(values)


def _metres(values: Mapping[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
    import pymap3d

    lat0, lon0 = values["rx_lat_deg"][0], values["rx_lon_deg"][0]

    def metres(which: str) -> FloatArray:
        lat, lon = values[f"{which}_lat_deg"], values[f"{which}_lon_deg"]
        east, north, _ = pymap3d.geodetic2enu(lat, lon, 0.0, lat0, lon0, 0.0)
        return np.column_stack([east, north])

    return metres("tx"), metres("rx")


def alternatives(table: Table, tx: FloatArray | None, rx: FloatArray | None) -> dict[str, FloatArray]:
    """Distances if coordinates were exchanged by mistake: for finding out whether they were."""
    if tx is None or rx is None:
        return {}
    if "rx_lat_deg" in table.columns:
        lat, lon, other = "lat_deg", "lon_deg", "latitude and longitude"
        value = {name: table.numbers(name) for name in _LAT_LON}
        swapped = {}
        for whose, ends in (
            ("the transmitter", ("tx",)),
            ("the receiver", ("rx",)),
            ("both ends", ("tx", "rx")),
        ):
            got = dict(value)
            for end in ends:
                got[f"{end}_{lat}"], got[f"{end}_{lon}"] = value[f"{end}_{lon}"], value[f"{end}_{lat}"]
            if all(np.all(np.abs(got[f"{end}_{lat}"]) <= 90.0) for end in ends):
                swapped[f"{other} of {whose} are exchanged"] = np.hypot(*np.subtract(*_metres(got)).T)
        return swapped
    return {
        "east and north of the receiver are exchanged": np.hypot(*(rx[:, ::-1] - tx).T),
        "east and north of the transmitter are exchanged": np.hypot(*(rx - tx[:, ::-1]).T),
    }
