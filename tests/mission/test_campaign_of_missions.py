"""Comparing and analysing many missions: figures against the truth, once each, resumable, here or on Dask."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from closed import close
from distributed import LocalCluster
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.errors import ConfigError, DataError, RecordingError
from fieldkit.messages import SourceEstimate, Tick
from fieldkit.recording import RecordingWriter, open_recording
from mission.analysis import campaign
from mission.analysis.compare import compare
from mission.analysis.figures import figures
from mission.lab.synthetic import record_simulated, small_mission


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    runs = tmp_path_factory.mktemp("runs")
    for seed in (2, 3):
        record_simulated(runs / f"seed-{seed}", seed=seed, duration_s=60.0)
    return runs


def find(ident: int, east: float, north: float) -> SourceEstimate:
    return SourceEstimate(ident, east, north, np.eye(2) * 0.01, 1, 5.0, 0.1, 1.0, 0.95, "found")


def test_figures_know_how_far_off_and_since_when(tmp_path: Path) -> None:
    """Two true sources, one found (lost once, then for good), and a find where nothing is."""
    mission, path = small_mission(tmp_path, robots=2), tmp_path / "mission.mcap"
    truth = [{"east_m": 2.0, "north_m": 3.0}, {"east_m": 8.0, "north_m": 8.0}]
    second = 1_000_000_000
    with RecordingWriter(
        path, mission_toml=mission.text, antenna_toml=mission.antenna_text, metadata={"truth": truth}
    ) as writer:
        for t, found in enumerate(
            ([], [find(1, 2.1, 3.0)], [], [find(1, 2.0, 3.2)], [find(1, 2.0, 3.2), find(2, 5.0, 5.0)])
        ):
            writer.event(t, t * second, Tick(t * second))
            writer.sources(t, t * second, found)
    row = figures(path)
    assert (row["found"], row["true_sources"], row["false_finds"]) == (2, 2, 1)
    assert row["localised_all_s"] is None and row["mean_error_m"] == pytest.approx(0.2)
    assert [s["found_after_s"] for s in row["sources"]] == [3.0, None]


def test_compare_writes_one_page_with_a_row_each(folder: Path, tmp_path: Path) -> None:
    logs = sorted(folder.rglob("mission.mcap"))
    said = compare(logs, tmp_path / "c.html", by="seed")
    assert [group["missions"] for group in said["groups"]] == [1, 1]
    page = (tmp_path / "c.html").read_text()
    assert (
        all(str(log) in page for log in logs)
        and page.count("<svg") >= 1
        and "http://" not in page.split("<svg")[0]
    )
    done = CliRunner().invoke(build(), ["compare", *map(str, logs), "--json"])
    assert done.exit_code == 0 and len(json.loads(done.stdout)["missions"]) == 2


def test_comparing_with_what_is_no_recording_writes_no_page(folder: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_text("no")
    with pytest.raises(RecordingError):
        compare([*folder.rglob("mission.mcap"), bad], tmp_path / "c.html")
    assert not (tmp_path / "c.html").exists()


def test_every_mission_is_taken_in_once_and_sql_agrees_with_the_recordings(
    folder: Path, tmp_path: Path
) -> None:
    jobs = campaign.jobs_of(folder, tmp_path, replay=False)
    assert campaign.run(jobs, workers=1) == (2, [])
    assert campaign.run(jobs, workers=1) == (0, [])
    columns, rows = campaign.ask(
        tmp_path, jobs, "select recording, readings from missions order by recording"
    )
    counts = [
        open_recording(log).summary()["counts"]["/in/reading"] for log in sorted(folder.rglob("*.mcap"))
    ]
    assert columns == ["recording", "readings"] and [row[1] for row in rows] == counts
    assert campaign.ask(tmp_path, jobs, "select count(*) from readings")[1] == [(sum(counts),)]


def test_what_a_kill_left_undone_is_done_later_and_a_changed_recording_again(
    folder: Path, tmp_path: Path
) -> None:
    jobs = campaign.jobs_of(folder, tmp_path, replay=False)
    campaign.run(jobs[:1], workers=1)
    assert campaign.run(jobs, workers=1)[0] == 1
    log = Path(jobs[0].log)
    os.utime(log, ns=(1, log.stat().st_mtime_ns + 1_000_000))
    again = campaign.jobs_of(folder, tmp_path, replay=False)
    assert campaign.run(again, workers=1)[0] == 1
    assert campaign.ask(tmp_path, again, "select count(*) from missions")[1] == [(2,)]


def test_replays_are_checked_also_on_dask(folder: Path, tmp_path: Path) -> None:
    jobs = campaign.jobs_of(folder, tmp_path, replay=True)
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        assert campaign.run(jobs, dask=cluster.scheduler_address) == (2, [])
    assert (
        campaign.ask(tmp_path, jobs, "select identical, times_real_time > 0 from missions")[1]
        == [(True, True)] * 2
    )


def test_no_scheduler_no_folder_no_recordings_bad_sql(folder: Path, tmp_path: Path, monkeypatch) -> None:
    jobs = campaign.jobs_of(folder, tmp_path, replay=False)
    with pytest.raises(ConfigError, match="no scheduler answers"):
        campaign.run(jobs, dask="tcp://127.0.0.1:9")
    with pytest.raises(DataError, match="no such folder"):
        campaign.jobs_of(tmp_path / "none", tmp_path, replay=False)
    with pytest.raises(DataError, match="is a file; expected the folder"):
        campaign.jobs_of(Path(jobs[0].log), tmp_path, replay=False)
    with pytest.raises(DataError, match="no recordings"):
        campaign.jobs_of(tmp_path, tmp_path, replay=False)
    campaign.run(jobs, workers=1)
    with pytest.raises(DataError, match="cannot be answered"):
        campaign.ask(tmp_path, jobs, "select nonsense from nowhere")


def test_a_file_that_is_no_recording_is_named_and_the_others_are_taken_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record_simulated(tmp_path / "good", duration_s=20.0)
    (tmp_path / "bad.mcap").write_text("no")
    shut = tmp_path / "closed.mcap"
    shut.write_text("no")
    close(shut, monkeypatch)
    done = CliRunner().invoke(build(), ["analyze", str(tmp_path), "--workers", "1", "--json"])
    said = json.loads(done.stdout)
    refused = [each["error"] for each in said["refused"]]
    assert done.exit_code == 2 and "bad.mcap" in refused[0] and "closed.mcap: cannot be read" in refused[1]
    assert said["answer"][0]["missions"] == 1
