"""Any log of readings as our CSV: what `fit`, `check` and `import` take."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from calibration import importing
from calibration.dataset import Readings, read_readings
from fieldkit.errors import ConfigError

REPORTS, RECORDINGS = (".html", ".htm"), (".mcap",)


@dataclass(frozen=True, slots=True)
class Reading:
    """How to read a log: the options that `fit`, `check` and `import` share."""

    names: Mapping[str, str] = field(default_factory=dict)
    where: Mapping[str, str] = field(default_factory=dict)
    place_cell_m: float | None = None
    negate: bool = False
    source: tuple[float, float] | None = None
    """The transmitter, where the log does not have it."""
    positions: Path | None = None
    """A position log that goes with a table without positions."""
    clock_offset_s: float | None = None
    relative: bool = False
    """Levels are dB against anything."""


def as_readings_csv(log: Path, how: Reading) -> tuple[str | None, list[str]]:
    """The log as a CSV of ours, and what is inconsistent about it. None: it is a table with positions of its own."""
    if log.suffix.lower() in RECORDINGS:
        return importing.csv_from_recording(log, how.source, how.clock_offset_s)
    if log.suffix.lower() in REPORTS:
        return importing.csv_from_report(log), []
    if how.positions is not None:
        from calibration.joining import csv_joined
        from calibration.table import read_table

        if how.source is None:
            raise ConfigError("--positions: where was the transmitter? give --source EAST NORTH, or LAT LON")
        table = read_table(log, names=how.names, where=how.where)
        importing.need_readings(table)
        return csv_joined(table, read_table(how.positions), how.source, how.clock_offset_s)
    return None, []


def read_log(log: Path, how: Reading) -> tuple[Readings, list[str]]:
    """Readings of any log, and what is inconsistent about it. Raises `DataError` naming file, line and remedy."""
    text, notes = as_readings_csv(log, how)
    if text is None:
        readings = read_readings(
            log,
            names=how.names,
            where=how.where,
            place_cell_m=how.place_cell_m,
            negate=how.negate,
            relative=how.relative,
        )
    else:
        readings = read_readings(
            log, text=text, place_cell_m=how.place_cell_m, negate=how.negate, relative=how.relative
        )
    return readings, notes
