"""A mission that is refused leaves no folder: whoever looks for a recording finds those of missions alone."""

import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fieldkit.errors import ConfigError, FieldkitError
from mission.cli.missions import run
from mission.cli.options import begun_folder
from mission.lab.synthetic import record_simulated, small_mission
from mission.shell import warm_up


@pytest.fixture(autouse=True)
def ready_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm_up, "warm_up", lambda mission: None)


def test_a_mission_whose_port_is_absent(tmp_path: Path) -> None:
    small_mission(tmp_path)
    with pytest.raises(FieldkitError, match="port1"):
        run(tmp_path / "mission.toml", out=tmp_path / "runs", page=False)
    assert not (tmp_path / "runs").exists()


def test_a_resumed_mission_that_is_refused(tmp_path: Path) -> None:
    log = record_simulated(tmp_path, seed=2, duration_s=30.0)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    (tmp_path / "runs" / "before").mkdir(parents=True)
    with pytest.raises(FieldkitError, match="port1"):
        run(resume=cut, out=tmp_path / "runs", page=False)
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["before"]


def test_a_mission_whose_page_has_no_port_is_refused_before_anything_else(tmp_path: Path) -> None:
    small_mission(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(ConfigError, match="--page-port"):
        run(tmp_path / "mission.toml", out=tmp_path / "runs", page_port=taken.getsockname()[1])
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("begun", [False, True])
def test_what_has_begun_is_kept(tmp_path: Path, begun: bool) -> None:
    mission = small_mission(tmp_path)
    runner: Any = SimpleNamespace(begun=begun)
    with pytest.raises(KeyboardInterrupt), begun_folder(tmp_path / "runs", mission) as (folder, on_start):
        (folder / "mission.mcap").write_bytes(b"")
        on_start(runner)
        raise KeyboardInterrupt
    assert (folder / "mission.mcap").exists() is begun
    assert (tmp_path / "runs").exists() is begun
