"""How a campaign's work is parted: in tiles and among workers, kept, taken up again, and not lost with a worker."""

import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import fieldkit
from fieldkit.cli import build
from fieldkit.errors import ConfigError, DataError
from fieldkit.messages import SourceEstimate, Tick
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.sources import TransientSource
from mission.analysis import refit as campaign
from mission.analysis.refit import Refitted, Work, refit
from mission.analysis.refit_beliefs import Believed, Believing, believe
from mission.analysis.refit_sessions import job_of, prepare
from mission.core.mission_file import read_mission
from mission.lab.bench_refit import DAY_NS, later
from mission.lab.synthetic import small_mission
from mission.replay.command import Changes

BORDER_M = 5.0
HIDDEN = (TransientSource(BORDER_M, 7.5, 0.0, 0.1), TransientSource(8.0, 2.5, 0.0, 0.1))
NORTH_M = 25.0
"""How far north of the first field the second begins: further than anything is heard."""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A mission in each of two fields, a day apart."""
    folder = tmp_path_factory.mktemp("fields")
    south = small_mission(folder / "south", duration_s=300.0)
    lat_deg, lon_deg, _ = south.frame.to_geodetic(0.0, NORTH_M)
    text = south.text.replace(
        f"origin_lat_deg = {south.frame.origin_lat_deg:.6f}", f"origin_lat_deg = {lat_deg:.9f}"
    )
    text = text.replace(
        f"origin_lon_deg = {south.frame.origin_lon_deg:.6f}", f"origin_lon_deg = {lon_deg:.9f}"
    )
    shutil.copytree(folder / "south", folder / "north")
    (folder / "north" / "mission.toml").write_text(text)
    north = read_mission(folder / "north" / "mission.toml")
    assert north.frame != south.frame
    for mission, name in ((south, "south.mcap"), (north, "flown.mcap")):
        fieldkit.simulate(mission, HIDDEN, seed=1, recording=folder / name)
    return [folder / "south.mcap", later(folder / "flown.mcap", folder / "north.mcap", DAY_NS)]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def whole(logs: list[Path], kept: Path) -> Refitted:
    return refit(logs, Changes(), work=Work(kept, workers=1))


@pytest.fixture(scope="module")
def parted(logs: list[Path], kept: Path, whole: Refitted) -> Refitted:
    """In a tile for each field; sessions are there already."""
    return refit(logs, Changes(), work=Work(kept, workers=1, tiles=(1, 2)))


def found(done: Refitted) -> list[SourceEstimate]:
    return sorted((s for s in done.sources() if s.state == "found"), key=lambda s: (s.north_m, s.east_m))


def test_tiles_find_what_one_belief_finds(whole: Refitted, parted: Refitted) -> None:
    assert len(whole.tiles) == 1 and whole.done_now == (2, 1)
    assert len(parted.tiles) == 2 and parted.done_now == (0, 2)
    assert len(found(whole)) == len(found(parted)) == 4
    for mine, theirs in zip(found(parted), found(whole), strict=True):
        apart_m = np.hypot(mine.east_m - theirs.east_m, mine.north_m - theirs.north_m)
        assert apart_m < 2.0 * np.sqrt(np.trace(theirs.cov_m2))
    assert parted.detections == whole.detections and parted.sessions == whole.sessions == 2
    assert [source.ident for source in parted.sources()] == list(range(1, len(parted.sources()) + 1))


def test_a_source_on_a_border_is_found_once(logs: list[Path], tmp_path: Path) -> None:
    done = refit(logs[:1], Changes(), work=Work(tmp_path, workers=1, tiles=(2, 1)))
    assert done.tiles[0].east_m == pytest.approx(BORDER_M)
    near = [s for s in found(done) if np.hypot(s.east_m - BORDER_M, s.north_m - 7.5) < 1.5]
    assert len(near) == 1 and len(found(done)) == 2
    assert 0.0 < done.probability_left < 1.0


def test_what_is_done_is_not_done_again(
    logs: list[Path], kept: Path, whole: Refitted, parted: Refitted
) -> None:
    again = refit(logs[::-1], Changes(), work=Work(kept, workers=1))
    assert again.done_now == (0, 0) and again.belief_hash == whole.belief_hash
    assert again.sources()[0].p_here == whole.sources()[0].p_here
    (north,) = kept.glob("tile-1-*.json")
    north.unlink()
    again = refit(logs, Changes(), work=Work(kept, workers=1, tiles=(1, 2)))
    assert again.done_now == (0, 1) and again.belief_hash == parted.belief_hash
    assert campaign.plain(again)["tiles_finished_now"] == 1


def killed_once(job: Believing) -> Believed:
    """As `believe`; at the northern tile its worker is killed the first time, in the middle of its work."""
    marked = Path(job.out).with_name("killed")
    if job.tile.number == 1 and not marked.exists():
        marked.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return believe(job)


def test_a_killed_worker_loses_nothing(
    logs: list[Path], kept: Path, parted: Refitted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for session in kept.glob("session-*.npz"):
        shutil.copy(session, tmp_path)
    monkeypatch.setattr(campaign, "believe", killed_once)
    done = refit(logs, Changes(), work=Work(tmp_path, workers=2, tiles=(1, 2)))
    assert (tmp_path / "killed").exists() and done.done_now == (0, 2)
    assert done.belief_hash == parted.belief_hash
    assert campaign.plain(done)["sources"] == campaign.plain(parted)["sources"]


def test_workers_change_no_bit_and_leave_nothing_behind(logs: list[Path], whole: Refitted) -> None:
    done = refit(logs, Changes(), work=Work(workers=2))
    assert done.belief_hash == whole.belief_hash and done.done_now == (2, 1)


def test_a_recording_that_goes_missing_half_way_is_named_and_the_others_are_in(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = Path(shutil.copy(logs[1], tmp_path / "gone.mcap"))

    def delete_and_part(*arguments):
        gone.unlink()
        return tiles_of(*arguments)

    tiles_of = campaign.tiles_of
    monkeypatch.setattr(campaign, "tiles_of", delete_and_part)
    done = refit([logs[0], gone], Changes(), work=Work(tmp_path / "work", workers=1))
    assert len(done.parts) == done.sessions == 1
    assert len(done.refused) == 1 and "gone.mcap" in done.refused[0]
    monkeypatch.undo()
    shutil.copy2(logs[1], gone)
    back = refit([logs[0], gone], Changes(), work=Work(tmp_path / "work", workers=1))
    assert back.done_now == (1, 1) and back.sessions == 2


def test_a_worker_that_stands_in_another_folder_finds_the_recordings(
    logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(logs[0].parent)
    (part,), *_ = campaign._parts([Path(logs[0].name)], Changes())
    job = job_of([part], part.mission.kernel, tmp_path / "work")
    monkeypatch.chdir(tmp_path)
    prepared = prepare(job)
    assert prepared.refused == () and prepared.detections > 5


def test_recordings_in_which_nothing_is_heard_are_refused(tmp_path: Path) -> None:
    mission = small_mission(tmp_path)
    with RecordingWriter(
        tmp_path / "still.mcap", mission_toml=mission.text, antenna_toml=mission.antenna_text, start_ns=0
    ) as writer:
        writer.event(0, 1, Tick(1))
    with pytest.raises(DataError, match="no receiver was listening at a known position"):
        refit([tmp_path / "still.mcap"], Changes())


def test_a_damaged_piece_is_named(logs: list[Path], kept: Path, whole: Refitted, tmp_path: Path) -> None:
    for piece in kept.iterdir():
        (tmp_path / piece.name).write_bytes(b"half")
    with pytest.raises(DataError, match=r"session-.*delete it and run the command again"):
        refit(logs, Changes(), work=Work(tmp_path, workers=1))


def test_the_command_keeps_its_pieces_beside_what_it_writes(logs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "all.geojson"
    result = CliRunner().invoke(
        build(), ["refit", str(logs[0]), "-o", str(out), "--tiles", "1x2", "--workers", "1"]
    )
    assert result.exit_code == 0 and "parted in 2 tiles" in result.output
    assert len(list((tmp_path / "all.geojson.work").glob("tile-*.json"))) == 2
    for wrong in ("2", "0x3", "2x", "ax2", "1000x1000"):
        refused = CliRunner().invoke(build(), ["refit", str(logs[0]), "--tiles", wrong])
        assert isinstance(refused.exception, ConfigError) and wrong in str(refused.exception)
    alone = CliRunner().invoke(build(), ["refit", str(logs[0]), "--dask", "tcp://127.0.0.1:9"])
    assert isinstance(alone.exception, ConfigError) and "--work" in str(alone.exception)
