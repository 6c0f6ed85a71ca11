"""The report in a browser: the mission's own page stands in it, without a server and without internet."""

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fieldkit.cli import build
from mission.lab.synthetic import record_simulated


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    recorded = record_simulated(folder, duration_s=150.0, sources_found=9)
    done = CliRunner().invoke(build(), ["report", str(recorded), "-o", str(folder / "report.html")])
    assert done.exit_code == 0, done.output
    return folder / "report.html"


@pytest.fixture
def tab(browser: Any, report: Path) -> Any:
    context = browser.new_context(viewport={"width": 1300, "height": 900}, offline=True)
    tab = context.new_page()
    faults: list[str] = []
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.goto(report.as_uri())
    yield tab
    context.close()
    assert not faults


def test_its_map_moves_and_its_time_goes_back(tab: Any) -> None:
    tab.locator("iframe").evaluate("(node) => node.scrollIntoView()")  # what is out of sight is not drawn
    frame = tab.frames[1]
    frame.wait_for_function("() => window.fieldkit?.grids.belief")
    assert frame.locator("#state").inner_text() == "recording"
    frame.wait_for_function("() => Number(document.getElementById('detections').textContent) > 0")
    whole = int(frame.locator("#detections").inner_text())
    assert frame.locator("#robots .card").count() == 4
    frame.evaluate("document.getElementById('zoom-in').click()")
    frame.evaluate(
        "() => { const s = document.getElementById('slider'); s.value = 20; s.dispatchEvent(new Event('input')); }"
    )
    frame.wait_for_function("() => window.fieldkit.frame.t_s <= 20")
    frame.wait_for_function(f"() => Number(document.getElementById('detections').textContent) < {whole}")
    assert frame.evaluate("window.fieldkit.tracks.r1.every((point) => point[0] <= 20)")
    frame.evaluate("document.getElementById('play').click()")
    frame.wait_for_function("() => window.fieldkit.frame.t_s > 60")


def test_what_it_says_first_is_on_the_first_page(tab: Any) -> None:
    front = tab.locator(".front")
    assert "What was found" in front.inner_text() and "What to do next" in front.inner_text()
    tab.set_viewport_size({"width": 390, "height": 844})
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    tab.emulate_media(media="print")
    assert not tab.locator("iframe").is_visible(), "on paper nothing moves"


A4_PX = (688, 1016)
"""What the margins of @page leave of a sheet of A4 in Chromium's pixels, 96 to an inch."""


def test_on_paper_the_front_fits_a_sheet_and_no_table_leaves_it(tab: Any) -> None:
    tab.set_viewport_size({"width": A4_PX[0], "height": A4_PX[1]})
    tab.emulate_media(media="print")
    assert tab.locator(".front > svg").count() == 1, "the map is on it"
    assert tab.locator(".front").evaluate("(node) => node.getBoundingClientRect().bottom") <= A4_PX[1]
    assert tab.evaluate("document.documentElement.scrollWidth") <= A4_PX[0]
    assert tab.locator(".source table").count() > 0
    wide = tab.evaluate(
        """() => [...document.querySelectorAll('table')].filter(
            (table) => table.scrollWidth > table.parentElement.clientWidth).length"""
    )
    assert wide == 0
