"""A recording for notebooks: `fieldkit.open_log(path)`, tables as numpy arrays, beliefs by time."""

import tomllib
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.errors import DataError, RecordingError
from fieldkit.geo import FieldFrame
from fieldkit.recording.reader import BeliefGrid, Recording, open_recording
from fieldkit.recording.tables import TABLES, joined, placed, read_tables

NAMES = (*TABLES, "belief")


class Log:
    """A mission after the fact. Each table is read on first use and kept.

    A table is a numpy structured array: `log.readings["rss_dbm"]`, `pandas.DataFrame(log.readings)`. See
    `fieldkit.recording.tables` for columns.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self._tables: dict[str, np.ndarray] = {}
        self._start_ns: int | None = None

    @property
    def path(self) -> Path:
        return self.recording.path

    @cached_property
    def field(self) -> dict[str, Any]:
        """The `[field]` table of the mission file; empty where the recording holds none."""
        try:
            return dict(tomllib.loads(self.recording.mission_toml).get("field", {}))
        except tomllib.TOMLDecodeError:
            return {}

    @cached_property
    def frame(self) -> FieldFrame | None:
        """The field's place on Earth; None where the recording does not say."""
        keys = ("origin_lat_deg", "origin_lon_deg")
        if not all(key in self.field for key in keys):
            return None
        lat_deg, lon_deg = (float(self.field[key]) for key in keys)
        return FieldFrame(lat_deg, lon_deg, float(self.field.get("origin_alt_m", 0.0)))

    @property
    def start_ns(self) -> int:
        """UTC time of the first tick: where `t_s` is zero."""
        if self._start_ns is None:
            self.load("notes")
        assert self._start_ns is not None
        return self._start_ns

    @property
    def readings(self) -> np.ndarray:
        """Every reading, with `east_m` and `north_m` of its robot at that moment (nan where not known)."""
        return self.table("readings")

    @property
    def poses(self) -> np.ndarray:
        """Every pose."""
        return self.table("poses")

    @property
    def detections(self) -> np.ndarray:
        """Each transmission by each robot that listened; rows of one transmission share `number`."""
        return self.table("detections")

    @property
    def sources(self) -> np.ndarray:
        """All estimates as time went on; `log.final_sources` are the last."""
        return self.table("sources")

    @property
    def final_sources(self) -> np.ndarray:
        """The estimates at the end, one row a source."""
        rows = self.sources
        return rows[rows["t_ns"] == rows["t_ns"].max()] if len(rows) else rows

    def table(self, name: str) -> np.ndarray:
        """A table by name. Raises `DataError` for a name there is not; an empty table is an empty array."""
        if name not in self._tables:
            self.load(name)
        return self._tables[name]

    def load(self, *names: str) -> None:
        """Read several tables in one pass."""
        wanted = [name for name in names if name not in self._tables]
        if "readings" in wanted and "poses" not in self._tables:
            wanted.append("poses")
        plain = tuple(dict.fromkeys(name for name in wanted if name != "belief"))
        if plain:
            read, self._start_ns = read_tables(self.recording, plain)
            if "readings" in read:
                poses = read["poses"] if "poses" in read else self._tables["poses"]
                read["readings"] = placed(read["readings"], poses)
            self._tables |= read
        if "belief" in wanted:
            self._tables["belief"] = self._belief_table()

    @cached_property
    def beliefs(self) -> list[BeliefGrid]:
        """The belief over the field as time went on."""
        return list(self.recording.beliefs())

    def belief_at(self, t_s: float) -> BeliefGrid:
        """The belief as last kept at mission time `t_s`. Raises `RecordingError` where none was kept by then."""
        kept = [grid for grid in self.beliefs if (grid.log_time_ns - self.start_ns) * 1e-9 <= t_s]
        if not kept:
            raise RecordingError(f"{self.path}: no belief had been kept by {t_s:g} s")
        return kept[-1]

    def between(self, name: str, from_s: float | None, to_s: float | None) -> np.ndarray:
        """The rows of a table from `from_s` to `to_s`. Raises `DataError` for a range outside the log."""
        if from_s is not None and to_s is not None and from_s > to_s:
            raise DataError(
                f"{self.path}: from {from_s:g} s is later than to {to_s:g} s; give the earlier one first"
            )
        rows = self.table(name)
        if from_s is None and to_s is None:
            return rows
        first_s, last_s = self.span_s
        low, high = first_s if from_s is None else from_s, last_s if to_s is None else to_s
        if not low < high or low > last_s or high < first_s:
            asked = " ".join(
                f"{word} {value:g} s" for word, value in (("from", from_s), ("to", to_s)) if value is not None
            )
            raise DataError(
                f"{self.path}: nothing {asked}: the log goes from {first_s:.1f} s to {last_s:.1f} s of the mission"
            )
        return rows[(rows["t_s"] >= low) & (rows["t_s"] <= high)]

    @cached_property
    def span_s(self) -> tuple[float, float]:
        """First and last moment of the log, counted as `t_s`."""
        said = self.recording.summary()
        first_s = ((said["start_ns"] or 0) - self.start_ns) * 1e-9
        return first_s, first_s + said["duration_s"]

    def _belief_table(self) -> np.ndarray:
        """A row for each cell of each belief kept: its centre and the probability that it holds a source."""
        parts: dict[str, list[np.ndarray]] = {name: [] for name in ("t_ns", "t_s", "east_m", "north_m", "p")}
        for grid in self.beliefs:
            north, east = np.indices(grid.values.shape)
            parts["t_ns"].append(np.full(grid.values.size, grid.log_time_ns, dtype=np.int64))
            parts["t_s"].append(np.full(grid.values.size, (grid.log_time_ns - self.start_ns) * 1e-9))
            parts["east_m"].append(grid.origin_m[0] + (east.ravel() + 0.5) * grid.cell_m)
            parts["north_m"].append(grid.origin_m[1] + (north.ravel() + 0.5) * grid.cell_m)
            parts["p"].append(grid.values.ravel())
        return joined({name: np.concatenate(p) if p else np.zeros(0) for name, p in parts.items()})


def open_log(path: Path | str) -> Log:
    """Open a recording for analysis, whole or cut. Raises `RecordingError` for what is not one."""
    return Log(open_recording(path))
