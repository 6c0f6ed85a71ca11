"""A folder of hundreds of missions: each once into Parquet, then questions in SQL. What is done is not done again.

The folder of results holds `missions`, `sources`, `readings` and `detections`, a Parquet file for each recording in
each; a recording counts as done when its `missions` file is there, which is written last. Work goes to this machine's
cores or to a Dask cluster that sees the same folders.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fieldkit.errors import DataError, FieldkitError
from fieldkit.extras import need
from fieldkit.files import write_whole
from fieldkit.recording.reader import is_later_part
from mission.analysis.pool import each_done

VIEWS = ("missions", "sources", "readings", "detections")
SUMMARY = """
select planner, belief, count(*) as missions, round(median(localised_all_s), 0) as median_time_s,
       sum(case when true_sources is not null and localised_all_s is null then 1 else 0 end) as not_all_found,
       sum(false_finds) as false_finds, round(avg(mean_error_m), 3) as mean_error_m,
       round(avg(duration_s), 0) as mean_duration_s, sum(case when identical = false then 1 else 0 end) as differing
from missions group by all order by all
"""
"""What is asked where nothing else is."""

Progress = Callable[[int, int, str], None]
"""Called with how many of how many are done, and the one just done."""


@dataclass(frozen=True, slots=True)
class Job:
    """One recording to be taken in. Paths as text: jobs travel."""

    log: str
    results: str
    key: str
    replay: bool
    keys: tuple[str, ...]
    """What-if changes for the replay, as `--set`."""


def jobs_of(folder: Path, results: Path, *, replay: bool, keys: tuple[str, ...] = ()) -> list[Job]:
    """A job for every recording under `folder`. Raises `DataError` where there is none."""
    if not folder.is_dir():
        why = "is a file; expected the folder it is in" if folder.exists() else "no such folder"
        raise DataError(f"{folder}: {why}")
    logs = [log for log in sorted(folder.rglob("*.mcap")) if not is_later_part(log)]
    if not logs:
        raise DataError(f"{folder}: no recordings (*.mcap) in it")
    return [Job(str(log), str(results), _key(log, folder, replay, keys), replay, keys) for log in logs]


def _key(log: Path, folder: Path, replay: bool, keys: tuple[str, ...]) -> str:
    """Changes when the recording or the question does: then it is taken in anew."""
    stat = log.stat()
    identity = json.dumps([str(log.relative_to(folder)), stat.st_size, stat.st_mtime_ns, replay, keys])
    return hashlib.sha256(identity.encode()).hexdigest()[:20]


def take_in(job: Job) -> dict[str, Any]:
    """Do one job: write its Parquet files; what there is to say of it. A recording that is none is an `error`."""
    try:
        return _take_in(job)
    except FieldkitError as error:
        return {"recording": job.log, "error": str(error)}


def _take_in(job: Job) -> dict[str, Any]:
    import fieldkit
    from mission.analysis.figures import figures
    from mission.replay.command import Changes, replay_one

    log_path, results = Path(job.log), Path(job.results)
    row = figures(log_path)
    sources = row.pop("sources")
    replayed: dict[str, Any] = {"identical": None, "replay_found": None, "times_real_time": None}
    if job.replay:
        try:
            said = replay_one(log_path, Changes(keys=job.keys))
        except DataError as error:
            replayed |= {"identical": False, "replay_found": None}
            row["end_reason"] += f" (replay: {error})"
        else:
            found = sum(source["state"] == "found" for source in said["sources"])
            replayed = {
                "identical": said["identical"],
                "replay_found": found,
                "times_real_time": said["times_real_time"],
            }
    log = fieldkit.open_log(log_path)
    log.load("readings", "detections")
    for name in ("readings", "detections"):
        rows = log.table(name)
        if len(rows):
            columns = {key: rows[key].tolist() for key in rows.dtype.names or ()}
            _write(results / name / f"{job.key}.parquet", {"mission": [job.key] * len(rows), **columns})
    if sources:
        columns = {key: [source[key] for source in sources] for key in sources[0]}
        _write(results / "sources" / f"{job.key}.parquet", {"mission": [job.key] * len(sources), **columns})
    _write(
        results / "missions" / f"{job.key}.parquet",
        {key: [value] for key, value in {"mission": job.key, **row, **replayed}.items()},
    )
    return {"recording": job.log, **row, **replayed}


#: Columns that may be all None in one file: their type is said, so that all files agree.
_TYPES = {
    "true_sources": "int64",
    "false_finds": "int64",
    "localised_all_s": "double",
    "mean_error_m": "double",
    "worst_error_m": "double",
    "probability_left": "double",
    "identical": "bool",
    "replay_found": "int64",
    "times_real_time": "double",
    "error_m": "double",
    "found_after_s": "double",
    "east_m": "double",
    "north_m": "double",
    "sigma_m": "double",
}


def _write(path: Path, columns: dict[str, list[Any]]) -> None:
    pyarrow = need("pyarrow", "post")
    parquet = need("pyarrow.parquet", "post")
    known = {"int64": pyarrow.int64(), "double": pyarrow.float64(), "bool": pyarrow.bool_()}
    table = pyarrow.table(
        {
            name: pyarrow.array(values, type=known.get(_TYPES.get(name, "")))
            for name, values in columns.items()
        }
    )
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(table, sink, compression="zstd")
    write_whole(path, bytes(sink.getvalue().to_pybytes()))


def run(
    jobs: Sequence[Job],
    progress: Progress = lambda done, of, text: None,
    *,
    workers: int | None = None,
    dask: str | None = None,
) -> tuple[int, list[dict[str, Any]]]:
    """Do all jobs not done yet; how many that were, and what could not be taken in.

    Raises `ConfigError` where no Dask scheduler answers at `dask`, `DataError` where workers are killed repeatedly.
    """
    left = [job for job in jobs if not (Path(job.results) / "missions" / f"{job.key}.parquet").exists()]
    refused = []
    finished = len(jobs) - len(left)
    for _, outcome in each_done(take_in, left, workers=workers, dask=dask):
        finished += 1
        if "error" in outcome:
            refused.append(outcome)
        progress(finished, len(jobs), str(outcome["recording"]))
    return len(left), refused


def ask(results: Path, jobs: Sequence[Job], sql: str = "") -> tuple[list[str], list[tuple[Any, ...]]]:
    """Column names and rows of a question in SQL over the `VIEWS`, of these jobs' recordings only.

    Raises `DataError` for SQL that DuckDB does not understand, naming what it said.
    """
    duckdb = need("duckdb", "post")
    keys = {job.key for job in jobs}
    with duckdb.connect() as connection:
        for view in VIEWS:
            files = [str(f) for f in sorted((results / view).glob("*.parquet")) if f.stem in keys]
            if files:
                listed = ", ".join("'" + name.replace("'", "''") + "'" for name in files)
                connection.execute(
                    f"create view {view} as select * from read_parquet([{listed}], union_by_name = true)"
                )
        try:
            found = connection.execute(sql if sql and sql.strip() else SUMMARY)
            if found is None or found.description is None:
                raise DataError("the SQL asks for nothing: expected a select")
            return [column[0] for column in found.description], found.fetchall()
        except duckdb.Error as error:
            raise DataError(f"the question cannot be answered: {error}") from error
