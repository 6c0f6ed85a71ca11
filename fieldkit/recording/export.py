"""A recording's tables as files other programs read: CSV, Parquet, GeoJSON, KML, GPX, TAK packages. Whole or none."""

import csv
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fieldkit.errors import ConfigError, RecordingError
from fieldkit.extras import need
from fieldkit.files import write_whole
from fieldkit.recording.log import NAMES, Log
from fieldkit.recording.shapes import geojson, gpx, kml
from fieldkit.recording.tables import TABLES
from fieldkit.recording.tak import tak_package

TABULAR = ("csv", "parquet")
MAPS = ("geojson", "kml", "gpx", "zip")
ON_MAPS = ("poses", "readings", "detections", "sources", "belief")


def export(
    log: Log,
    out: Path,
    names: tuple[str, ...] = (),
    *,
    form: str = "",
    from_s: float | None = None,
    to_s: float | None = None,
) -> list[Path]:
    """Write tables of a log to `out`; the files written.

    The form is the file's ending, or `form` with a folder. CSV and Parquet hold one table a file, so several go to
    a folder. Without `names`, all that have rows but the belief (on maps: poses and sources). Raises `ConfigError`
    for a form or table there is not, `RecordingError` for a table without rows: then nothing is written.
    """
    form = form or out.suffix.lower().lstrip(".")
    if form not in (*TABULAR, *MAPS):
        known = ", ".join((*TABULAR, *MAPS))
        raise ConfigError(f"{out}: expected a file ending in, or --format, one of {known}; got '{form}'")
    for name in names:
        if name not in NAMES:
            raise ConfigError(f"no table '{name}'; tables are: {', '.join(NAMES)}")
    if form in MAPS:
        return [_map(log, out, names or ("poses", "sources"), form, from_s, to_s)]
    rows = {name: log.between(name, from_s, to_s) for name in _loaded(log, names or tuple(TABLES))}
    for name in names:
        if not len(rows[name]):
            raise RecordingError(_empty(log, name, from_s, to_s))
    rows = {name: table for name, table in rows.items() if len(table)}
    if not rows:
        raise RecordingError(f"{log.path}: holds nothing to export")
    to_folder = not out.suffix
    if not to_folder and len(rows) > 1:
        raise ConfigError(
            f"{out}: a {form} file holds one table; name one with --what, or a folder with --format {form}"
        )
    encode = _csv if form == "csv" else _parquet
    contents = {out / f"{name}.{form}" if to_folder else out: encode(table) for name, table in rows.items()}
    for path, content in contents.items():
        write_whole(path, content)
    return list(contents)


def _loaded(log: Log, names: tuple[str, ...]) -> tuple[str, ...]:
    log.load(*names)
    return names


def _empty(log: Log, name: str, from_s: float | None, to_s: float | None) -> str:
    counts = log.recording.summary()["counts"]
    held = ", ".join(
        f"{count} on {topic}" for topic, count in counts.items() if topic.startswith(("/in", "/engine"))
    )
    within = "" if from_s is None and to_s is None else " in that time"
    return f"{log.path}: holds no {name}{within}; it holds {held or 'nothing'}"


def _map(
    log: Log, out: Path, names: tuple[str, ...], form: str, from_s: float | None, to_s: float | None
) -> Path:
    for name in names:
        if name not in ON_MAPS:
            raise ConfigError(f"{name} cannot be put on a map; what can is: {', '.join(ON_MAPS)}")
    if log.frame is None:
        raise RecordingError(
            f"{log.path}: does not say where on Earth its field is, so {form} cannot be written"
        )
    rows = {name: log.between(name, from_s, to_s) for name in _loaded(log, names)}
    for name in names:
        if not len(rows[name]):
            raise RecordingError(_empty(log, name, from_s, to_s))
    makers: dict[str, Callable[..., str | bytes]] = {
        "geojson": geojson,
        "kml": kml,
        "gpx": gpx,
        "zip": tak_package,
    }
    write_whole(out, makers[form](log.frame, rows, log.path.stem))
    return out


def _csv(rows: np.ndarray) -> str:
    """With a header; numbers as the shortest text that reads back the same, missing ones empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = rows.dtype.names or ()
    writer.writerow(names)
    plain = [_texts(rows[name]) for name in names]
    writer.writerows(zip(*plain, strict=True))
    return text.getvalue()


def _texts(values: np.ndarray) -> list[object]:
    if values.dtype.kind == "f":
        return ["" if value != value else value for value in values.tolist()]
    if values.dtype.kind == "b":
        return [int(value) for value in values.tolist()]
    return list(values.tolist())


def _parquet(rows: np.ndarray) -> bytes:
    """Columns with their types; nan stays nan; `units` are in the names."""
    pyarrow = need("pyarrow", "post")
    parquet = need("pyarrow.parquet", "post")
    columns = {
        name: pyarrow.array(
            rows[name].tolist() if rows[name].dtype.kind == "U" else np.ascontiguousarray(rows[name])
        )
        for name in rows.dtype.names or ()
    }
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns), sink, compression="zstd")
    return bytes(sink.getvalue().to_pybytes())
