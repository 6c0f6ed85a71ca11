"""Jobs whose worker is killed are done again: here, and on a Dask cluster."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from fieldkit.errors import DataError, NotWritten
from mission.analysis.pool import each_done


def twice(job: tuple[int, str]) -> int:
    """Twice a number; where a file of that name is not there, its worker makes it and is killed."""
    number, fatal = job
    if fatal and not Path(fatal).exists():
        Path(fatal).write_text("killed")
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def always_killed(number: int) -> int:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def out_of_memory(number: int) -> int:
    raise MemoryError


def nowhere_to_write(number: int) -> int:
    raise NotWritten("here", OSError(28, "No space left on device"))


@pytest.mark.parametrize("workers", [1, 2])
def test_each_job_is_done_once(workers: int) -> None:
    assert sorted(each_done(twice, [(3, ""), (4, ""), (5, "")], workers=workers)) == [(0, 6), (1, 8), (2, 10)]
    assert list(each_done(twice, [], workers=workers)) == []


def test_the_job_of_a_killed_worker_is_done_again(tmp_path: Path) -> None:
    jobs = [(number, str(tmp_path / "marked") if number == 2 else "") for number in range(6)]
    assert sorted(each_done(twice, jobs, workers=2)) == [(number, 2 * number) for number in range(6)]
    assert (tmp_path / "marked").exists()


def test_a_job_that_always_kills_its_worker_is_given_up_in_clear_words() -> None:
    with pytest.raises(DataError, match=r"killed again and again.*too little memory"):
        list(each_done(always_killed, [0, 1, 2], workers=2))


@pytest.mark.parametrize("workers", [1, 2])
def test_too_little_memory_is_said(workers: int) -> None:
    with pytest.raises(DataError, match="too little memory"):
        list(each_done(out_of_memory, [1, 2], workers=workers))


def test_an_error_keeps_its_words_on_the_way_from_a_worker() -> None:
    with pytest.raises(NotWritten, match=r"here: cannot be written.*make room"):
        list(each_done(nowhere_to_write, [1, 2], workers=2))


def test_a_cluster_gives_the_job_of_a_killed_worker_to_another(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    begun = tmp_path / "begun"
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        with distributed.Client(cluster) as client:
            pids = list(client.run(os.getpid).values())
        jobs = [f"echo {number} >> {begun}; sleep 2" for number in range(3)]
        done: list[tuple[int, int]] = []
        waiting = threading.Thread(
            target=lambda: done.extend(each_done(os.system, jobs, dask=cluster.scheduler_address))
        )
        waiting.start()
        while not begun.exists() or len(begun.read_text().split()) < 2:  # each of both has one
            time.sleep(0.01)
        os.kill(pids[0], signal.SIGKILL)
        waiting.join()
    assert sorted(done) == [(number, 0) for number in range(3)]
    assert len(begun.read_text().split()) == 4, "one of them was begun twice"
