"""Trials over processes and a cluster: each counts once, whatever is killed on the way."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from fieldkit.errors import ConfigError
from mission.lab.study.options import supported
from mission.lab.study.pool import read_kept, run_trials

DASK = [sys.executable, "-m", "dask"]


@dataclass(frozen=True)
class Task:
    folder: str
    number: int


def trial(task: Task) -> dict[str, int]:
    """Says in a file of its own each time it is begun."""
    begun = Path(task.folder) / f"{task.number}-{time.monotonic_ns()}"
    begun.write_text(str(os.getpid()))
    time.sleep(0.05)
    return {"value": task.number**2, "process": os.getpid()}


def tasks(folder: Path, count: int) -> list[Task]:
    (folder / "begun").mkdir(exist_ok=True)
    return [Task(str(folder / "begun"), number) for number in range(count)]


def begun(folder: Path) -> int:
    return len(list((folder / "begun").iterdir()))


def test_what_was_kept_is_not_done_again(tmp_path: Path) -> None:
    jobs, kept = tasks(tmp_path, 6), tmp_path / "trials.jsonl"
    run_trials(trial, jobs[:4], workers=2, kept=kept)
    rows = run_trials(trial, jobs, workers=2, kept=kept)
    assert [row["value"] for row in rows] == [0, 1, 4, 9, 16, 25]
    assert begun(tmp_path) == 6
    assert len(kept.read_text().splitlines()) == 6


def test_a_line_cut_short_by_a_kill_costs_one_trial_only(tmp_path: Path) -> None:
    jobs, kept = tasks(tmp_path, 3), tmp_path / "trials.jsonl"
    run_trials(trial, jobs, workers=1, kept=kept)
    kept.write_bytes(kept.read_bytes()[:-20])
    assert len(read_kept(kept)) == 2
    run_trials(trial, jobs, workers=1, kept=kept)
    assert begun(tmp_path) == 4
    assert len(read_kept(kept)) == 3, "the trial done again must not run into the line that was cut"


def test_a_study_that_was_killed_goes_on(tmp_path: Path) -> None:
    jobs, kept = tasks(tmp_path, 40), tmp_path / "trials.jsonl"
    code = (
        "from test_study_pool import *\nfrom mission.lab.study.pool import run_trials\n"
        f"run_trials(trial, tasks(Path({str(tmp_path)!r}), 40), workers=1, kept=Path({str(kept)!r}))"
    )
    study = subprocess.Popen([sys.executable, "-c", code], env=environment(), start_new_session=True)
    while not kept.exists() or len(kept.read_text().splitlines()) < 5:
        assert study.poll() is None, "it ended before it could be killed"
        time.sleep(0.01)
    os.killpg(study.pid, signal.SIGKILL)
    study.wait()
    had = len(read_kept(kept))
    assert 5 <= had < 40
    before = begun(tmp_path)
    rows = run_trials(trial, jobs, workers=1, kept=kept)
    assert [row["value"] for row in rows] == [n**2 for n in range(40)]
    assert begun(tmp_path) - before == 40 - had


def environment() -> dict[str, str]:
    """Workers must be able to import this module."""
    return {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, dict[int, subprocess.Popen[bytes]]]]:
    """A scheduler and two workers, each a process of its own: the address, and the workers by process id."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    quiet = {
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
        "env": environment(),
        "cwd": tmp_path,
    }
    at = ["--scheduler-file", str(file)]
    scheduler = subprocess.Popen(
        [*DASK, "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", *at], **quiet
    )
    processes = [scheduler]
    try:
        while not file.exists() or not file.read_text().endswith("}"):
            assert scheduler.poll() is None, "no scheduler"
            time.sleep(0.05)
        worker = [*DASK, "worker", "--no-nanny", "--nthreads", "1", "--no-dashboard", *at]
        workers = {(process := subprocess.Popen(worker, **quiet)).pid: process for _ in range(2)}
        processes += workers.values()
        yield json.loads(file.read_text())["address"], workers
    finally:
        for process in processes:
            process.kill()
            process.wait()


def test_a_worker_killed_half_way_loses_no_trial_and_doubles_none(tmp_path: Path, cluster) -> None:  # type: ignore[no-untyped-def]
    address, workers = cluster
    killed: list[int] = []

    def watch(share: float, text: str) -> None:
        at_work = {row["process"] for row in read_kept(tmp_path / "kept.jsonl").values()} & workers.keys()
        if share >= 0.4 and not killed and len(at_work) == 2:
            killed.append(min(at_work))
            os.kill(killed[0], signal.SIGKILL)

    rows = run_trials(trial, tasks(tmp_path, 80), watch, kept=tmp_path / "kept.jsonl", dask=address)
    assert killed, "no worker was killed: the test tested nothing"
    assert workers[killed[0]].wait() == -signal.SIGKILL
    assert [row["value"] for row in rows] == [n**2 for n in range(80)]
    lines = [json.loads(line)["job"] for line in (tmp_path / "kept.jsonl").read_text().splitlines()]
    assert len(lines) == len(set(lines)) == 80
    assert {row["process"] for row in rows} == set(workers)


def test_a_cluster_that_is_not_there_is_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("mission.lab.study.pool.CONNECT_S", 0.3)
    with pytest.raises(ConfigError, match=r"no scheduler answers.*dask scheduler"):
        run_trials(trial, tasks(tmp_path, 1), dask="tcp://127.0.0.1:9")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"spog-fieldkit\[fleet\]"):
        run_trials(trial, tasks(tmp_path, 1), dask="tcp://127.0.0.1:9")


def test_a_trial_that_fails_ends_the_study_with_its_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        run_trials(trial, [Task(str(tmp_path / "nowhere"), 1)], workers=1)


def test_a_study_is_given_only_what_it_takes() -> None:
    def plain(trials: int, seed: int, progress: object) -> None: ...
    def any_way(trials: int, seed: int, progress: object, **how: object) -> None: ...

    assert supported(plain, "x", workers=None, dask=None, kept=Path("y")) == {}
    assert supported(any_way, "x", workers=2, dask=None, kept=Path("y")) == {"workers": 2, "kept": Path("y")}
    with pytest.raises(ConfigError, match="study x: takes no --dask"):
        supported(plain, "x", workers=None, dask="tcp://a:1", kept=None)
