"""The list of recordings, and what is posted to a page, at their worst: nothing takes the list or the draft away."""

import json
import os
import socket
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from closed import close

from mission.cli.dashboard import _past
from mission.lab.synthetic import record_simulated
from mission.page.server import Page
from mission.page.shelf import LONGEST_QUESTION, Shelf, shelf
from mission.plan.serve import plan

open_past = partial(_past, host="127.0.0.1")
ODD_POSTS = (b"[" * 10_000, b"NaN", b'{"name": "\\ud800"}', b'{"field": {"cell_m": 1e400}}', b"\xff", b"{")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return record_simulated(tmp_path_factory.mktemp("flown"), duration_s=20.0).read_bytes()


@pytest.fixture
def page(tmp_path: Path, data: bytes) -> Iterator[Page]:
    (tmp_path / "mission.mcap").write_bytes(data)
    with shelf(tmp_path, open_past, host="127.0.0.1") as page:
        yield page


def said(address: str, body: bytes | None = None, token: str = "") -> tuple[int, str]:
    request = Request(address, body, {"authorization": f"Bearer {token}"})
    try:
        with urlopen(request, timeout=30) as answer:
            return answer.status, answer.read().decode()
    except HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="these names cannot be given there")
def test_files_that_vanish_and_names_that_are_no_letters_leave_the_list(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gone.mcap").symlink_to(tmp_path / "nowhere")
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "closed.mcap").write_bytes(b"x")
    close(tmp_path / "closed.mcap", monkeypatch)
    Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.mcap")).write_bytes(b"x")
    status, text = said(f"{page.address}runs/list")
    runs = {run["name"]: run.get("error", "") for run in json.loads(text)["runs"]}
    assert (
        status == 200
        and set(runs) == {"mission.mcap", "closed.mcap", "?.mcap"}
        and "rename it" in runs["?.mcap"]
    )
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "mission.mcap").read_bytes()[:3000])
    (cut,) = [
        run for run in json.loads(said(f"{page.address}runs/list")[1])["runs"] if run["name"] == "cut.mcap"
    ]
    assert str(tmp_path) not in cut["error"], "which one it is stands beside it"
    assert said(f"{page.address}runs/open", b'{"name": "?.mcap"}')[0] == 400
    assert runs["closed.mcap"] == "cannot be read: permission denied"


def test_more_than_can_be_listed_are_counted(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mission.page.shelf.MOST_LISTED", 1)
    (tmp_path / "another.mcap").write_bytes(b"x")
    answer = json.loads(said(f"{page.address}runs/list")[1])
    assert len(answer["runs"]) == 1 and answer["unlisted"] == 1


def test_what_is_posted_is_refused_in_words(page: Page) -> None:
    for body in (*ODD_POSTS, b'"' + b"x" * LONGEST_QUESTION + b'"'):
        status, text = said(f"{page.address}runs/open", body)
        assert status == 400 and json.loads(text)["error"], body[:40]


def test_whoever_goes_in_the_middle_of_a_question_says_nothing_in_the_terminal(
    page: Page, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_connection((page.host, page.port)) as asking:
        head = f"POST /runs/open HTTP/1.1\r\nHost: {page.host}:{page.port}\r\nContent-Length: 1000\r\n\r\n"
        asking.sendall(head.encode() + b'{"name":')
    assert said(f"{page.address}runs/list")[0] == 200
    monkeypatch.setattr(Shelf, "rows", lambda self: 1 / 0)  # a mistake of ours
    status, text = said(f"{page.address}runs/list")
    assert status == 500 and "ZeroDivisionError" in text
    assert [record.exc_info for record in caplog.records if record.levelname == "ERROR"] == [False]


def test_the_editors_draft_outlives_whatever_is_posted(tmp_path: Path) -> None:
    with plan(tmp_path / "mission.toml") as page:
        before = said(f"{page.address}plan/state", token=page.token)
        for body in ODD_POSTS:
            status, text = said(f"{page.address}plan/change", body, page.token)
            assert status == 400 and json.loads(text)["error"], body[:40]
            assert said(f"{page.address}plan/state", token=page.token) == before


def test_a_recording_that_has_grown_is_opened_anew(tmp_path: Path, data: bytes) -> None:
    """The mission that writes it was under way when it was opened first."""
    (tmp_path / "mission.mcap").write_bytes(data[: len(data) // 2])
    kept = Shelf(tmp_path, open_past)
    try:
        first = kept.open("mission.mcap")
        (tmp_path / "mission.mcap").write_bytes(data)
        assert kept.open("mission.mcap") != first
    finally:
        kept.close()
