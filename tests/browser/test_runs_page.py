"""A folder of recordings: each is a line, the one chosen opens on its page, and its report is written when asked."""

import json
import urllib.request
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.error import HTTPError

import pytest
from flying import found_wrong, looking
from sizes import size

from fieldkit.errors import DataError
from fieldkit.recording.reader import open_recording
from mission.cli.dashboard import _past
from mission.lab.synthetic import record_simulated
from mission.page.server import Page
from mission.page.shelf import MOST_OPEN, Shelf, shelf

pytest.importorskip("axe_playwright_python.sync_playwright", reason="pip install .[dev]")
HOST = "127.0.0.1"
open_past = partial(_past, host=HOST)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One whole, one cut, one that is none."""
    top = tmp_path_factory.mktemp("runs")
    for name in ("whole", "cut", "none"):
        (top / name).mkdir()
    data = record_simulated(top / "whole", duration_s=size(40.0, 100.0)).read_bytes()
    (top / "cut" / "mission.mcap").write_bytes(data[: len(data) // 2])
    (top / "none" / "mission.mcap").write_text("hello\n")
    return top


@pytest.fixture
def page(folder: Path) -> Iterator[Page]:
    with shelf(folder, open_past, host=HOST) as page:
        yield page


def test_each_is_a_line_and_the_one_chosen_opens(browser: Any, page: Page, folder: Path) -> None:
    with looking(browser, page.address) as tab:
        tab.wait_for_selector("#rows tr:nth-child(3)")
        words = tab.locator("#rows").inner_text()
        found = len(open_recording(folder / "whole").result()["found_at_s"])  # type: ignore[index]
        row = tab.locator("tr", has_text="whole/mission.mcap")
        assert row.locator("[data-word=found]").inner_text() == str(found)
        assert "NOT complete" in words and "is not an MCAP recording" in words
        assert not found_wrong(tab)
        tab.set_viewport_size({"width": 390, "height": 844})
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390
        tab.click("text=cut/mission.mcap")
        tab.wait_for_selector("#state >> text=recording", timeout=60_000)
        tab.go_back()
        tab.click("text=whole/mission.mcap")
        tab.wait_for_selector("#files", state="attached", timeout=60_000)
        tab.set_viewport_size({"width": 1440, "height": 860})
        with tab.expect_download(timeout=240_000) as download:
            tab.click("#files >> text=report")
        assert "What was found" in Path(download.value.path()).read_text()


def test_only_what_is_listed_opens(page: Page) -> None:
    def ask(body: bytes, **headers: str) -> tuple[int, dict[str, Any]]:
        request = urllib.request.Request(f"{page.address}runs/open", body, headers, method="POST")
        try:
            with urllib.request.urlopen(request) as answer:
                return answer.status, json.load(answer)
        except HTTPError as error:
            return error.code, json.load(error) if error.code != 403 else {}

    for name in ("../whole/mission.mcap", "/etc/passwd", "nobody", ""):
        status, said = ask(json.dumps({"name": name}).encode())
        assert status == 400 and "is not in" in said["error"]
    for body in (b"", b"[]", b'{"name": 3}', b"\xff"):
        assert ask(body)[0] == 400
    assert ask(b'{"name": "none/mission.mcap"}')[1]["error"].count("is not an MCAP recording") == 1
    assert ask(b'{"name": "whole/mission.mcap"}', Origin="http://elsewhere")[0] == 403


def test_an_empty_folder_says_how_a_recording_is_made(browser: Any, tmp_path: Path) -> None:
    with shelf(tmp_path, open_past, host=HOST) as page, looking(browser, page.address) as tab:
        tab.wait_for_selector("text=There is no recording in")
    with pytest.raises(DataError, match="no such folder"):
        Shelf(tmp_path / "nobody", open_past)


def test_of_many_the_longest_open_is_closed(tmp_path: Path) -> None:
    data = record_simulated(tmp_path, duration_s=20.0).read_bytes()
    for number in range(MOST_OPEN + 1):
        (tmp_path / f"{number}.mcap").write_bytes(data)
    kept = Shelf(tmp_path, open_past)
    addresses = [kept.open(f"{number}.mcap") for number in range(MOST_OPEN + 1)]
    assert len(set(addresses)) == MOST_OPEN + 1
    assert kept.open(f"{MOST_OPEN}.mcap") == addresses[-1], "one that is open is not opened again"
    with pytest.raises(OSError):
        urllib.request.urlopen(addresses[0], timeout=5)
    urllib.request.urlopen(addresses[1], timeout=5).close()
    kept.close()
