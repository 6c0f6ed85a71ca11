"""CSV logs of positions or readings: columns found by name, times in several forms, bad rows counted and named.

| meaning | columns |
|---|---|
| when | `t_ns`, or `time_s`, or `time` (with `date` where that is a column of its own): see below |
| where | `lat_deg`, `lon_deg` (or `lat`, `rx_lat_deg`, ...), or `east_m`, `north_m` (or `rx_east_m`, ...); `up_m` |
| who | `robot` or `receiver`; without one the only robot |
| also | `heading_deg`, `sigma_m`; `rss_dbm` (or `rssi`; empty: nothing was heard), `frame_id`, `address`, `channel` |

A time is seconds (milli-, micro- or nanoseconds since 1970 by their size), ISO 8601 (UTC where no zone is given), or
HH:MM:SS. Commas, semicolons and tabs separate; where they are not commas a decimal comma is a decimal point. Cells
may carry their unit (`-70 dBm`) or hemisphere (`5.2 W`). Rows that say the same again count once.
"""

import csv
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from fieldkit.errors import DataError

_ALIASES = {
    "lat_deg": ("lat_deg", "lat", "latitude", "latitude_deg", "rx_lat_deg", "rx_latitude"),
    "lon_deg": ("lon_deg", "lon", "lng", "long", "longitude", "longitude_deg", "rx_lon_deg", "rx_longitude"),
    "east_m": ("east_m", "x_m", "rx_east_m", "rx_x_m"),
    "north_m": ("north_m", "y_m", "rx_north_m", "rx_y_m"),
    "up_m": ("up_m", "alt_m", "height_m", "altitude_m", "rel_alt_m", "rx_up_m", "rx_alt_m"),
    "north_south": ("n/s", "ns", "lat_ref"),
    "east_west": ("e/w", "ew", "lon_ref"),
    "robot": ("robot", "receiver", "radio"),
    "rss_dbm": ("rss_dbm", "rssi_dbm", "rssi", "rss"),
    "heading_deg": ("heading_deg", "yaw_deg"),
    "sigma_m": ("sigma_m",),
    "frame_id": ("frame_id",),
    "address": ("address", "source_id", "transmitter"),
    "channel": ("channel",),
}
_DAY_NS = 86_400_000_000_000
_HOUR = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d*)?)")
NAMED = 3
"""So many rejected rows or spots are named; the others are counted."""


@dataclass
class Table:
    """A CSV file's rows as texts by meaning; see the module."""

    path: Path
    rows: list[dict[str, str]]
    names: set[str]
    """Meanings there is a column for."""
    skipped: int = 0
    """Rows that could not be read."""
    first_bad: str = field(default="")
    bad_rows: list[str] = field(default_factory=list)
    """The first of them, with their lines."""
    repeated: int = 0
    """Rows that say what another has said."""
    lines: list[int] = field(default_factory=list)

    def bad(self, number: int, why: str) -> None:
        """Count a row that cannot be read."""
        self.skipped += 1
        self.first_bad = self.first_bad or f"line {number}: {why}"
        if len(self.bad_rows) < NAMED:
            self.bad_rows.append(f"line {number}: {why}")

    def notes(self) -> list[str]:
        """What was left out, in words."""
        found = []
        if self.skipped:
            more = f" and {self.skipped - NAMED} more" if self.skipped > NAMED else ""
            found.append(f"{self.path.name}: {self.skipped} rows left out: {'; '.join(self.bad_rows)}{more}")
        if self.repeated:
            found.append(f"{self.path.name}: {self.repeated} rows repeat another one and count once")
        return found


def read_table(path: Path) -> Table:
    """Read a CSV file. Raises `DataError` where it is missing, empty or has no column that says when."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text: {error}") from error
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.startswith("#")
    ]
    if len(numbered) < 2:
        raise DataError(f"{path}: expected a line of column names and rows, got {len(numbered)} lines")
    lines = [line for _, line in numbered]
    separator = max(",;\t", key=lines[0].count)
    decimal_comma = separator != ","
    reader = csv.DictReader(lines, delimiter=separator)
    found = {each.strip().lower(): each for each in reader.fieldnames or ()}
    columns = {
        meaning: found[alias]
        for meaning, aliases in _ALIASES.items()
        for alias in reversed(aliases)
        if alias in found
    }
    when = next((name for name in ("t_ns", "time_s", "time", "timestamp") if name in found), None)
    if when is None:
        raise DataError(
            f"{path}: no column says when: expected t_ns, time_s or time; columns are: {', '.join(found)}"
        )
    columns["time" if when == "timestamp" else when] = found[when]
    if "date" in found and when == "time":
        columns["date"] = found["date"]
    rows, at, repeated = [], [], 0
    seen: set[tuple[str | None, ...]] = set()
    for (number, _), row in zip(numbered[1:], reader, strict=False):
        # What is not one of our columns may distinguish two rows.
        whole = tuple(row[name] for name in reader.fieldnames or ())
        if whole in seen:
            repeated += 1
            continue
        seen.add(whole)
        cells = {name: (row[column] or "").strip() for name, column in columns.items()}
        if decimal_comma:
            cells = {name: _point(text) for name, text in cells.items()}
        rows.append(cells)
        at.append(number)
    return Table(path, rows, set(columns), repeated=repeated, lines=at)


def _point(text: str) -> str:
    return text.replace(",", ".") if re.fullmatch(r"[-+]?\d*,\d+\s*\D*", text) else text


def timed(table: Table) -> Iterator[tuple[int, int, dict[str, str]]]:
    """(line, t_ns, row) for each row whose time can be read; midnights are counted where times have no date."""
    days, last_ns = 0, -1
    unit = _epoch_unit(table)
    for number, row in zip(table.lines or range(2, len(table.rows) + 2), table.rows, strict=True):
        t_ns = _time(row, unit)
        if t_ns is None:
            table.bad(number, f"no time in {row}")
            continue
        if not row.get("date") and re.fullmatch(r"\d{1,2}:\d{2}:\d{2}([.,]\d*)?", row.get("time", "")):
            if t_ns + days * _DAY_NS < last_ns - _DAY_NS // 2:
                days += 1
            t_ns += days * _DAY_NS
        last_ns = t_ns
        yield number, t_ns, row


def number(row: dict[str, str], name: str) -> float | None:
    """A cell as a finite number, without its unit; None where it is empty or no number."""
    text = row.get(name, "")
    # 47.5 N, 5.2 W: a hemisphere, not a unit.
    side = re.fullmatch(r"([-+]?[\d.]+)\s*°?\s*([NSEWnsew])", text)
    if side and name in ("lat_deg", "lon_deg"):
        text = side[1] if side[2].upper() in "NE" else f"-{side[1]}"
    elif unit := re.fullmatch(r"([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)\s*(dBm|dB|m|deg|°)", text):
        text = unit[1]
    try:
        value = float(text)
    except ValueError:
        return None
    if not math.isfinite(value):
        return None
    column = {"lat_deg": "north_south", "lon_deg": "east_west"}.get(name, "")
    return -abs(value) if row.get(column, "")[:1].upper() in ("S", "W") else value


def _epoch_unit(table: Table) -> float:
    """Nanoseconds of the unit in which plain numbers give the time: by their size, for the whole file."""
    for row in table.rows:
        try:
            value = abs(float(row.get("time_s") or row.get("time") or ""))
        except ValueError:
            continue
        return 1e9 if value < 1e11 else 1e6 if value < 1e14 else 1e3 if value < 1e17 else 1.0
    return 1e9


def _time(row: dict[str, str], unit: float = 1e9) -> int | None:
    if (whole := row.get("t_ns", "")).lstrip("-").isdigit():
        return int(whole)
    text = row.get("time_s") or row.get("time") or ""
    if date := row.get("date"):
        return instant_ns(f"{_iso_date(date)}T{text}")
    try:
        return round(float(text) * unit)
    except (ValueError, OverflowError):
        pass
    return instant_ns(text)


def _iso_date(text: str) -> str:
    """Day, month, year in the usual orders as ISO 8601; 20260601 and 2026/06/01 too."""
    if plain := re.fullmatch(r"(\d{4})[-/.]?(\d{2})[-/.]?(\d{2})", text):
        return "-".join(plain.groups())
    if european := re.fullmatch(r"(\d{1,2})\.(\d{1,2})\.(\d{4})", text):
        return f"{european[3]}-{int(european[2]):02d}-{int(european[1]):02d}"
    return text


def instant_ns(text: str) -> int | None:
    """ISO 8601 or HH:MM:SS as nanoseconds; None where it is neither."""
    if clock := _HOUR.fullmatch(text):
        seconds = float(clock[3].replace(",", "."))
        return round((int(clock[1]) * 3600 + int(clock[2]) * 60 + seconds) * 1e9)
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    whole = int((moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() // 1)
    return whole * 1_000_000_000 + moment.microsecond * 1000
