"""A readings file as columns of text, and the map from its column names to ours.

Accepted names, first one preferred. `--column ours=theirs` adds to them for one run.
"""

import csv
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.errors import DataError
from fieldkit.files import is_stream
from fieldkit.messages import FloatArray

COLUMNS: dict[str, tuple[str, ...]] = {
    "rss_dbm": ("rss_dbm", "rssi_dbm", "rssi", "rss"),
    "distance_m": ("distance_m", "range_m", "distance"),
    "place": ("place", "location", "configuration"),
    "heading_deg": ("heading_deg", "bearing_deg", "angle_deg"),
    "receiver": ("receiver", "robot", "radio"),
    "transmitter": ("transmitter", "beacon"),
    "sample": ("sample", "sequence", "seq"),
    "time": ("time", "time_s", "t_ns"),
    "tx_east_m": ("tx_east_m", "tx_x_m"),
    "tx_north_m": ("tx_north_m", "tx_y_m"),
    "tx_up_m": ("tx_up_m", "tx_alt_m"),
    "rx_east_m": ("rx_east_m", "rx_x_m", "east_m"),
    "rx_north_m": ("rx_north_m", "rx_y_m", "north_m"),
    "rx_up_m": ("rx_up_m", "rx_alt_m"),
    "tx_lat_deg": ("tx_lat_deg", "tx_latitude"),
    "tx_lon_deg": ("tx_lon_deg", "tx_longitude"),
    "rx_lat_deg": ("rx_lat_deg", "rx_latitude"),
    "rx_lon_deg": ("rx_lon_deg", "rx_longitude"),
}


@dataclass(frozen=True, slots=True)
class Table:
    """Columns of text under our names, equally long; `lines` (n,) is where each row stands in the file."""

    path: Path
    columns: dict[str, list[str]]
    others: dict[str, list[str]]
    """Columns we have no use for, under their own names: for `--where`."""
    lines: list[int]

    def __len__(self) -> int:
        return len(self.lines)

    def error(self, row: int, message: str) -> DataError:
        """An error at one row, with its line in the file."""
        return DataError(f"{self.path}, line {self.lines[row]}: {message}")

    def numbers(self, name: str, *, empty: float | None = None) -> FloatArray:
        """A column as (n,) float64. `empty` stands for an empty cell; without it one is an error."""
        texts = self.columns[name]
        if empty is not None:
            texts = [text or repr(empty) for text in texts]
        try:
            values = np.array(texts, dtype=float)
        except ValueError:
            values = None
        given = np.array([bool(text) for text in self.columns[name]])
        if values is None or not np.all(np.isfinite(values[given])):
            row = next(i for i, text in enumerate(self.columns[name]) if not _is_number(text, empty))
            raise self.error(row, _explain(name, self.columns[name][row]))
        return values


def _is_number(text: str, empty: float | None) -> bool:
    if not text:
        return empty is not None
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _explain(name: str, text: str) -> str:
    if not text:
        return f"{name} is empty; give every row a value, or delete the row"
    if "," in text and _is_number(text.replace(",", "."), None):
        return f"{name} is {text!r}: a decimal comma; export with decimal points"
    if re.fullmatch(r"[-+]?[0-9.]+\s*[A-Za-zµ°%]+", text):
        return f"{name} is {text!r}: a unit in the cell; give the number alone, {_unit(name)}"
    if name == "rss_dbm":
        return f"rss_dbm is {text!r}: not a number; leave it empty where a packet was sent but not received"
    return f"{name} is {text!r}: not a finite number; correct it, or delete the row"


def _unit(name: str) -> str:
    """What a column of ours is in, by its name."""
    units = {"dbm": "in dBm", "m": "in metres", "deg": "in degrees"}
    return units.get(name.rpartition("_")[2], "without a unit")


def read_table(
    path: Path,
    *,
    names: Mapping[str, str] | None = None,
    where: Mapping[str, str] | None = None,
    text: str | None = None,
) -> Table:
    """Read a CSV (comma, semicolon or tab). `names`: ours to theirs. `where`: keep rows with these values.

    `text` is read in place of the file, which then only gives its name. Raises `DataError` naming file and line.
    """
    if text is None and is_stream(path):
        raise DataError(
            f"{path}: expected a CSV of readings, got a pipe or device; write it into a file first"
        )
    try:
        with path.open(newline="", encoding="utf-8-sig") if text is None else io.StringIO(text) as stream:
            header_line = stream.readline()
            stream.seek(0)
            rows = csv.reader(stream, delimiter=_delimiter(header_line))
            header = [name.strip() for name in next(rows, [])]
            body, lines = _body(path, rows, header)
    except FileNotFoundError:
        raise DataError(f"{path}: no such file; name a CSV of readings (see docs/calibration.md)") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}; name a CSV of readings") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: is not a text table: {error}") from error
    if not header or not any(header):
        raise DataError(f"{path}: is empty; expected a header line such as place,distance_m,sample,rss_dbm")
    columns, others = _named(path, header, body, names or {})
    table = Table(path, columns, others, lines)
    return _filter(table, where) if where else table


def as_csv(header: list[str], rows: list[Any]) -> str:
    """The text of a CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()


def _delimiter(header: str) -> str:
    return max(",;\t", key=header.count)


def _body(path: Path, rows: Any, header: list[str]) -> tuple[list[list[str]], list[int]]:
    body, lines = [], []
    for row in rows:
        if not any(row):
            continue
        if len(row) != len(header):
            hint = "; are there decimal commas?" if len(row) > len(header) else ""
            raise DataError(
                f"{path}, line {rows.line_num}: {len(row)} values under {len(header)} column names{hint}"
            )
        body.append(row)
        lines.append(rows.line_num)
    return body, lines


def _named(
    path: Path, header: list[str], body: list[list[str]], names: Mapping[str, str]
) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    for ours, theirs in names.items():
        if ours not in COLUMNS:
            raise DataError(
                f"column map: no column of ours is called '{ours}'; there are {', '.join(COLUMNS)}"
            )
        if theirs not in header:
            raise DataError(f"{path}: has no column '{theirs}'; there are {', '.join(header)}")
    texts = [[text.strip() for text in column] for column in zip(*body, strict=True)] or [[] for _ in header]
    by_name = dict(zip(header, texts, strict=True))
    lowered = {name.lower(): name for name in reversed(header)}
    columns: dict[str, list[str]] = {}
    used: set[str] = set()
    for ours, accepted in COLUMNS.items():
        wanted = (names[ours],) if ours in names else accepted
        found = next((lowered[name.lower()] for name in wanted if name.lower() in lowered), None)
        if found is not None and found not in used:
            columns[ours] = by_name[found]
            used.add(found)
    return columns, by_name


def _filter(table: Table, where: Mapping[str, str]) -> Table:
    keep = np.ones(len(table), dtype=bool)
    for name, value in where.items():
        if name not in table.others:
            raise DataError(
                f"{table.path}: --where {name}: no such column; there are {', '.join(table.others)}"
            )
        keep &= np.array([text == value for text in table.others[name]])
    if not keep.any():
        wanted = ", ".join(f"{name}={value}" for name, value in where.items())
        raise DataError(f"{table.path}: no row has {wanted}")
    chosen = np.flatnonzero(keep).tolist()

    def pick(columns: dict[str, list[str]]) -> dict[str, list[str]]:
        return {name: [column[i] for i in chosen] for name, column in columns.items()}

    return Table(table.path, pick(table.columns), pick(table.others), [table.lines[i] for i in chosen])
