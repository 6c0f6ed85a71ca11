"""How a line of text becomes a reading: JSON, a regular expression or columns, and what its numbers mean. Pure."""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any

import regex

from fieldkit.errors import ConfigError

FORMATS = ("json", "regex", "csv")
UNITS = ("dBm", "-dBm", "relative dB")
TIME_UNITS = ("s", "ms", "us", "iso")
STRONGEST_DBM = 0.0
"""No receiver reads more: a larger number has another sign or another unit. A mission leaves out what is outside."""
WEAKEST_DBM = -150.0
NUMBER = re.compile(r"[+-]?\d+(?:[.,]\d+)?")
MATCHED_WITHIN_S = 0.05
"""Some expressions think for ever on some lines (the library `regex` gives up where `re` cannot)."""
FALSE_WORDS = frozenset(("", "0", "false", "no", "none", "null"))


class NoReadingError(ValueError):
    """A line that cannot be a reading under its map; the text says what is missing or wrong."""


@dataclass(frozen=True, slots=True)
class Heard:
    """What one line says."""

    rss_dbm: float
    """Received power; of a relative scale, decibels over its own reference."""
    source: str | None = None
    channel: int | None = None
    time_s: float | None = None
    """By the radio's own clock."""
    number: int | None = None
    """Of the packet, by its sender."""

    def frame_id(self) -> str | None:
        """The packet's name, the same at every receiver where its sender numbers its packets."""
        if self.source is None or self.number is None:
            return self.source
        return f"{self.source}/{self.number & 0xFF:02x}"


@dataclass(frozen=True, slots=True)
class LineMap:
    """Where a line has what. Keys are JSON paths (`payload.rssi`), names of groups, or names of columns."""

    format: str
    rss: str = "rss"
    pattern: str = ""
    """`regex`: searched for in each line, with named groups."""
    columns: tuple[str, ...] = ()
    """`csv`: names in order; one that ends in `*` takes all that follow, and counts with the largest."""
    unit: str = "dBm"
    offset_db: float = 0.0
    """Added to each strength: it brings a relative scale below 0."""
    source: str = ""
    channel: str = ""
    time: str = ""
    time_unit: str = "s"
    number: str = ""
    heard: str = ""
    """A line whose value here is false, 0 or empty says that the radio listens and hears nothing."""
    about: str = ""
    example: str = ""
    """A line as the device's documents show it."""

    def check(self, where: str) -> None:
        """Raises `ConfigError`: what was expected."""
        if self.format not in FORMATS:
            raise ConfigError(f"{where}: option 'format': expected {', '.join(FORMATS)}, got {self.format!r}")
        if self.unit not in UNITS:
            raise ConfigError(f"{where}: option 'unit': expected {', '.join(UNITS)}, got {self.unit!r}")
        if self.time_unit not in TIME_UNITS:
            raise ConfigError(
                f"{where}: option 'time_unit': expected {', '.join(TIME_UNITS)}, got {self.time_unit!r}"
            )
        keys = [
            key for key in (self.rss, self.source, self.channel, self.time, self.number, self.heard) if key
        ]
        if self.format == "regex":
            try:
                groups = list(_compiled(self.pattern).groupindex)
            except (regex.error, RecursionError) as error:
                raise ConfigError(f"{where}: option 'pattern': not a regular expression: {error}") from error
            self._all_known(keys, groups, f"{where}: option 'pattern' has the named groups", "(?P<rss>...)")
        if self.format == "csv":
            names = [name.rstrip("*") for name in self.columns]
            self._all_known(keys, names, f"{where}: option 'columns' names", "in the order they are printed")

    @staticmethod
    def _all_known(keys: list[str], known: list[str], words: str, remedy: str) -> None:
        missing = [key for key in keys if key not in known]
        if missing:
            raise ConfigError(
                f"{words} {', '.join(known) or 'none'}; {', '.join(missing)} is missing ({remedy})"
            )

    def read(self, line: str) -> Heard | None:
        """What a line says; None where it says that nothing was heard. Raises `NoReadingError`."""
        return self.read_values(self._values(line))

    def read_values(self, values: Any) -> Heard | None:
        """The same of what was parsed already: nested dictionaries and lists."""
        if self.heard and _is_false(_at(values, self.heard)):
            return None
        return Heard(
            self._rss_dbm(_at(values, self.rss)),
            _text(_at(values, self.source)) if self.source else None,
            _whole(_at(values, self.channel)) if self.channel else None,
            self._time_s(_at(values, self.time)) if self.time else None,
            _whole(_at(values, self.number)) if self.number else None,
        )

    def _values(self, line: str) -> Any:
        if self.format == "json":
            try:
                values = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise NoReadingError("is not JSON") from error
            if not isinstance(values, dict):
                raise NoReadingError("is JSON, but not an object {...}")
            return values
        if self.format == "regex":
            try:
                found = _compiled(self.pattern).search(line, timeout=MATCHED_WITHIN_S, concurrent=True)
            except TimeoutError as error:
                raise NoReadingError(
                    f"takes the pattern over {MATCHED_WITHIN_S:g} s: has it a repeat within a repeat, as (\\w+)*?"
                ) from error
            if found is None:
                raise NoReadingError("does not match the pattern")
            return found.groupdict()
        parts = [part.strip().strip('"') for part in line.split(",")]
        if self.columns[-1].endswith("*"):
            last = len(self.columns) - 1
            return dict(zip(self.columns[:-1], parts, strict=False)) | {self.columns[-1][:-1]: parts[last:]}
        return dict(zip(self.columns, parts, strict=False))

    def _rss_dbm(self, value: Any) -> float:
        values = value if isinstance(value, list) else [value]
        numbers = [number for number in map(_number, values) if number is not None]
        if not numbers:
            raise NoReadingError(f"has no number at '{self.rss}'")
        sign = -1.0 if self.unit == "-dBm" else 1.0
        rss = max(sign * number for number in numbers) + self.offset_db
        if not WEAKEST_DBM <= rss <= STRONGEST_DBM:
            raise NoReadingError(f"reads {rss:g} {self._remedy(rss)}")
        return rss

    def _remedy(self, rss: float) -> str:
        if self.unit == "relative dB":
            shift = -100 if rss > STRONGEST_DBM else 100
            return f"dB, and {WEAKEST_DBM:g} to 0 can be used: shift the scale, as with offset_db = {shift}"
        other = '"-dBm" or "relative dB"' if self.unit == "dBm" else '"dBm"'
        return f"dBm, which no radio receives: is the unit {other}?"

    def _time_s(self, value: Any) -> float | None:
        """None also for whole seconds: such a stamp says less than the line's arrival."""
        if self.time_unit != "ms" and self.time_unit != "us" and not re.search(r"\d[.,]\d", str(value)):
            return None
        if self.time_unit == "iso":
            return _iso_s(str(value))
        number = _number(value)
        return None if number is None else number * {"s": 1.0, "ms": 1e-3, "us": 1e-6}[self.time_unit]


@lru_cache(maxsize=64)
def _compiled(pattern: str) -> "regex.Pattern[str]":
    return regex.compile(pattern)


def _at(values: Any, key: str) -> Any:
    """The value at a dotted path; None where there is none."""
    for part in [key] if isinstance(values, Mapping) and key in values else key.split("."):
        if isinstance(values, Mapping):
            values = values.get(part)
        elif isinstance(values, list) and part.isdigit() and int(part) < len(values):
            values = values[int(part)]
        else:
            return None
    return values


def _number(value: Any) -> float | None:
    """A finite number, also as text and with a decimal comma."""
    if isinstance(value, bool) or value is None:
        return None
    if isinstance(value, str):
        if not NUMBER.fullmatch(value.strip()):
            return None
        value = value.strip().replace(",", ".")
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _whole(value: Any) -> int | None:
    number = _number(value)
    return None if number is None else int(number)


def _text(value: Any) -> str | None:
    """A short printable name; None for nothing."""
    if value is None or isinstance(value, dict | list):
        return None
    words = "".join(letter for letter in str(value).strip() if letter.isprintable())[:64]
    return words or None


def _is_false(value: Any) -> bool:
    return value is None or str(value).strip().lower() in FALSE_WORDS


def _iso_s(text: str) -> float | None:
    try:
        moment = datetime.fromisoformat(text.strip().replace("Z", "+00:00"))
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
