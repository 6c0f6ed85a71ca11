"""CSV logs of positions or readings: columns found by name, times in several forms, bad rows counted and skipped.

| meaning | columns |
|---|---|
| when | `t_ns`, or `time_s`, or `time`: seconds, ISO 8601 (UTC where no zone is given), or HH:MM:SS |
| where | `lat_deg`, `lon_deg` (or `lat`, `lon`; `rx_lat_deg`, ...), or `east_m`, `north_m` (or `rx_east_m`, ...) |
| who | `robot` or `receiver`; without one the only robot |
| also | `heading_deg`, `sigma_m`; `rss_dbm` (empty: nothing was heard), `frame_id`, `channel` |
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
    "lat_deg": ("lat_deg", "lat", "latitude", "rx_lat_deg"),
    "lon_deg": ("lon_deg", "lon", "lng", "longitude", "rx_lon_deg"),
    "east_m": ("east_m", "rx_east_m"),
    "north_m": ("north_m", "rx_north_m"),
    "robot": ("robot", "receiver"),
    "rss_dbm": ("rss_dbm", "rssi_dbm"),
    "heading_deg": ("heading_deg",),
    "sigma_m": ("sigma_m",),
    "frame_id": ("frame_id",),
    "channel": ("channel",),
}
_DAY_NS = 86_400_000_000_000


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

    def bad(self, number: int, why: str) -> None:
        """Count a row that cannot be read."""
        self.skipped += 1
        self.first_bad = self.first_bad or f"line {number}: {why}"


def read_table(path: Path) -> Table:
    """Read a CSV file. Raises `DataError` where it is missing, empty or has no column that says when."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text: {error}") from error
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) < 2:
        raise DataError(f"{path}: expected a line of column names and rows, got {len(lines)} lines")
    reader = csv.DictReader(lines)
    found = {each.strip().lower(): each for each in reader.fieldnames or ()}
    columns = {
        meaning: found[alias]
        for meaning, aliases in _ALIASES.items()
        for alias in reversed(aliases)
        if alias in found
    }
    when = next((name for name in ("t_ns", "time_s", "time") if name in found), None)
    if when is None:
        raise DataError(
            f"{path}: no column says when: expected t_ns, time_s or time; columns are: {', '.join(found)}"
        )
    columns[when] = found[when]
    rows = [{name: (row[column] or "").strip() for name, column in columns.items()} for row in reader]
    return Table(path, rows, set(columns))


def timed(table: Table) -> Iterator[tuple[int, int, dict[str, str]]]:
    """(line, t_ns, row) for each row whose time can be read; midnights are counted where times have no date."""
    days, last_ns = 0, -1
    for number, row in enumerate(table.rows, start=2):
        t_ns = _time(row)
        if t_ns is None:
            table.bad(number, f"no time in {row}")
            continue
        if re.fullmatch(r"\d{1,2}:\d{2}:\d{2}(\.\d*)?", row.get("time", "")):
            if t_ns + days * _DAY_NS < last_ns - _DAY_NS // 2:
                days += 1
            t_ns += days * _DAY_NS
        last_ns = t_ns
        yield number, t_ns, row


def number(row: dict[str, str], name: str) -> float | None:
    """A cell as a finite number; None where it is empty or no number."""
    try:
        value = float(row.get(name, ""))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _time(row: dict[str, str]) -> int | None:
    if (whole := row.get("t_ns", "")).lstrip("-").isdigit():
        return int(whole)
    text = row.get("time_s") or row.get("time") or ""
    try:
        return round(float(text) * 1e9)
    except (ValueError, OverflowError):
        pass
    return instant_ns(text)


def instant_ns(text: str) -> int | None:
    """ISO 8601 or HH:MM:SS as nanoseconds; None where it is neither."""
    if clock := re.fullmatch(r"(\d{1,2}):(\d{2}):(\d{2}(?:\.\d*)?)", text):
        return round((int(clock[1]) * 3600 + int(clock[2]) * 60 + float(clock[3])) * 1e9)
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    whole = int((moment - datetime(1970, 1, 1, tzinfo=UTC)).total_seconds() // 1)
    return whole * 1_000_000_000 + moment.microsecond * 1000
