"""Data sets of real surveys: a folder with a transmitter's survey in two CSV files and the truth in a third.

    truth.json                    {"NAME": [east_m, north_m] or [east_m, north_m, up_m], ...}
    NAME_readings.csv             time_s, rss_dbm (dBm, or dB against anything)
    NAME_positions.csv            time_s, east_m, north_m and, where heights are known, up_m
    calibration_without_NAME.csv  rss_dbm, tx_east_m, tx_north_m, rx_east_m, rx_north_m (and tx_up_m, rx_up_m)

Without a calibration file the other surveys of the folder are one: those whose transmitter stood elsewhere. A folder
of flights (`flight_TEAM_PLACE.csv`, with the places in SOURCE.md) is read as two such data sets, at 3 and 10 minutes.
"""

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fieldkit.channel.reml import Transmitter
from fieldkit.errors import DataError
from fieldkit.geo import FieldFrame
from fieldkit.messages import FloatArray

SAME_PLACE_M = 1.0
FLIGHT_AVERAGE_S = 2.0
FLIGHT_QUALITY_DB = 20.0
"""Rows of less are not the signal (the challenge's own rule)."""
FLIGHT_CUTS_S = (180.0, 600.0)
ROVER_UP_M = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """One transmitter's survey: where (n, 3) and how strongly (n,) it was heard, and the truth (3,)."""

    name: str
    t_s: FloatArray
    place_m: FloatArray
    level_db: FloatArray
    truth_m: FloatArray
    path_t_s: FloatArray
    path_m: FloatArray
    """(k, 3) all positions."""
    calibration: tuple[Transmitter, ...]


@dataclass(frozen=True, slots=True, eq=False)
class DataSet:
    """Surveys of one campaign."""

    name: str
    surveys: tuple[Survey, ...]


def read_all(folder: Path) -> list[DataSet]:
    """All data sets in a folder, by name. Raises `DataError` where there is none or one cannot be read."""
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; --data names one with data sets in it")
    found: list[DataSet] = []
    for each in [folder, *sorted(path for path in folder.rglob("*") if path.is_dir())]:
        if (each / "truth.json").is_file():
            found.append(_campaign(each))
        elif any(each.glob("flight_*.csv")):
            found += flights(each)
    if not found:
        raise DataError(
            f"{folder}: no data set: expected a truth.json beside NAME_readings.csv and NAME_positions.csv"
        )
    return found


def _columns(path: Path) -> dict[str, list[str]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = list(csv.DictReader(stream))
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    if not rows:
        raise DataError(f"{path}: no rows")
    return {name: [row[name] or "" for row in rows] for name in rows[0]}


def _numbers(columns: dict[str, list[str]], name: str, path: Path) -> FloatArray:
    """An empty cell is nan."""
    if name not in columns:
        raise DataError(f"{path}: no column {name}; there are {', '.join(columns)}")
    try:
        return np.array([float(text) if text.strip() else np.nan for text in columns[name]])
    except ValueError as error:
        raise DataError(f"{path}: {name}: {error}") from None


def _places(columns: dict[str, list[str]], path: Path, who: str = "") -> FloatArray:
    up = f"{who}up_m"
    east = _numbers(columns, f"{who}east_m", path)
    height = _numbers(columns, up, path) if up in columns else np.zeros(east.size)
    return np.column_stack([east, _numbers(columns, f"{who}north_m", path), height])


def _campaign(folder: Path) -> DataSet:
    try:
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise DataError(f"{folder / 'truth.json'}: not valid JSON: {error}") from error
    surveys = [_survey(folder, name, place) for name, place in truth.items()]
    return DataSet(folder.name, tuple(_calibrated(folder, surveys)))


def _survey(folder: Path, name: str, truth: list[float]) -> Survey:
    readings, positions = folder / f"{name}_readings.csv", folder / f"{name}_positions.csv"
    heard, path = _columns(readings), _columns(positions)
    t_s, level = _numbers(heard, "time_s", readings), _numbers(heard, "rss_dbm", readings)
    path_t_s, path_m = _numbers(path, "time_s", positions), _places(path, positions)
    order = np.argsort(path_t_s, kind="stable")
    path_t_s, path_m = path_t_s[order], path_m[order]
    ok = np.isfinite(level) & np.isfinite(t_s)
    place = np.column_stack([np.interp(t_s[ok], path_t_s, path_m[:, axis]) for axis in range(3)])
    where = np.array([*truth, 0.0, 0.0, 0.0][:3], dtype=float)
    return Survey(name, t_s[ok], place, level[ok], where, path_t_s, path_m, ())


def _calibrated(folder: Path, surveys: list[Survey]) -> Iterator[Survey]:
    for survey in surveys:
        path = folder / f"calibration_without_{survey.name}.csv"
        if path.is_file():
            yield replace(survey, calibration=tuple(_transmitters(path)))
        else:
            yield replace(survey, calibration=others(survey, surveys))


def others(survey: Survey, surveys: list[Survey]) -> tuple[Transmitter, ...]:
    """The surveys whose transmitter stood at another place."""
    return tuple(
        Transmitter(each.place_m, each.level_db, each.truth_m)
        for each in surveys
        if np.sqrt(((each.truth_m - survey.truth_m) ** 2).sum()) > SAME_PLACE_M
    )


def _transmitters(path: Path) -> Iterator[Transmitter]:
    columns = _columns(path)
    level, source, place = (
        _numbers(columns, "rss_dbm", path),
        _places(columns, path, "tx_"),
        _places(columns, path, "rx_"),
    )
    ok = np.isfinite(level)
    _, index = np.unique(np.round(source, 3), axis=0, return_inverse=True)
    for number in range(int(index.max()) + 1):
        mine = ok & (index.ravel() == number)
        if mine.any():
            yield Transmitter(place[mine], level[mine], source[mine][0])


def flights(folder: Path) -> list[DataSet]:
    """Find A Rover flights as data sets, each cut where the challenge wanted an estimate."""
    spots = {
        number: (float(lat), float(lon))
        for number, lat, lon in re.findall(
            r"place (\d+) (-?\d+\.\d+), (-?\d+\.\d+)",
            (folder / "SOURCE.md").read_text(encoding="utf-8") if (folder / "SOURCE.md").is_file() else "",
        )
    }
    if not spots:
        raise DataError(f"{folder}: flights, and no SOURCE.md that says 'place 1 LATITUDE, LONGITUDE; ...'")
    frame = FieldFrame(*np.min(list(spots.values()), axis=0).tolist())
    whole = []
    for path in sorted(folder.glob("flight_*_*.csv")):
        _, team, place = path.stem.split("_")
        if place not in spots:
            raise DataError(f"{path}: SOURCE.md has no place {place}")
        whole.append(_flight(path, f"{team}_{place}", spots[place], frame))
    return [
        DataSet(
            f"{folder.name}_at_{cut_s:.0f}_s",
            tuple(replace(_until(each, cut_s), calibration=others(each, whole)) for each in whole),
        )
        for cut_s in FLIGHT_CUTS_S
    ]


def _flight(path: Path, name: str, spot: tuple[float, float], frame: FieldFrame) -> Survey:
    columns = _columns(path)
    value = {
        key: _numbers(columns, key, path)
        for key in ("time_s", "lat_deg", "lon_deg", "alt_m", "power_db", "quality_db")
    }
    ok = (value["quality_db"] >= FLIGHT_QUALITY_DB) & np.isfinite(value["power_db"])
    local = np.array(
        [frame.to_local(lat, lon) for lat, lon in zip(value["lat_deg"], value["lon_deg"], strict=True)]
    )
    place = np.column_stack([local[:, 0], local[:, 1], value["alt_m"]])
    _, group = np.unique(np.floor(value["time_s"][ok] / FLIGHT_AVERAGE_S), return_inverse=True)
    count = np.bincount(group)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(group, values[ok]) / count)

    east, north, _ = frame.to_local(*spot)
    return Survey(
        name,
        mean(value["time_s"]),
        np.column_stack([mean(place[:, axis]) for axis in range(3)]),
        mean(value["power_db"]),
        np.array([east, north, ROVER_UP_M]),
        value["time_s"],
        place,
        (),
    )


def _until(survey: Survey, t_s: float) -> Survey:
    use, path = survey.t_s <= t_s, survey.path_t_s <= t_s
    return replace(
        survey,
        t_s=survey.t_s[use],
        place_m=survey.place_m[use],
        level_db=survey.level_db[use],
        path_t_s=survey.path_t_s[path],
        path_m=survey.path_m[path],
    )
