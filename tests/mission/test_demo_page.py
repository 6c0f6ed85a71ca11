"""`fieldkit demo --page`: whoever watched the demo keeps its page when it has ended."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.recording import reader
from mission.analysis import report
from mission.lab import cli, demo
from mission.page import embed
from mission.shell import terminal


def test_the_demo_leaves_its_page_open_when_all_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page, runner, done = object(), object(), []
    result = SimpleNamespace(runner=runner, plain=lambda seed: {"seed": seed})

    @contextmanager
    def shown_page(*_: object) -> Iterator[object]:
        yield page
        done.append("closed")

    monkeypatch.setattr(demo, "prepare", lambda *_: (None, ()))
    monkeypatch.setattr(demo, "run", lambda *_, **__: result)
    monkeypatch.setattr(reader, "open_recording", lambda _: None)
    monkeypatch.setattr(embed, "embedded", lambda _: None)
    monkeypatch.setattr(report, "write_report", lambda *_: done.append("report"))
    monkeypatch.setattr(terminal, "result_table", lambda _: done.append("table"))
    monkeypatch.setattr(cli, "shown_page", shown_page)
    monkeypatch.setattr(cli, "stay_open", lambda *what: done.append(what))
    said = CliRunner().invoke(build(), ["demo", "--page", "--out", str(tmp_path)])
    assert said.exit_code == 0, said.output
    assert done == ["report", "table", (page, runner), "closed"]
