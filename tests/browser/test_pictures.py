"""Pages look as they did: screenshots against kept ones, by the mean colour of squares of 16 pixels.

Letters drawn a little differently by another machine do not count; a panel that has moved, or gone, does. After a
change that is wanted: FIELDKIT_PICTURES=write pytest tests/browser/test_pictures.py, and look at what has changed.
"""

import io
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying import looking
from PIL import Image
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.recording.reader import open_recording
from mission.cli.dashboard import _past
from mission.lab.synthetic import record_simulated
from mission.page import serve
from mission.page.shelf import shelf
from mission.plan.serve import plan

KEPT = Path(__file__).with_name("pictures")
SQUARE_PX = 16
DIFFERENT = 14.0
"""Levels of 255, in any colour."""
MOST = 0.012
"""Share of squares that may differ."""
LOOKS = {
    "desk": (1440, 900, "dark"),
    "laptop": (1024, 768, "light"),
    "small": (800, 600, "dark"),
    "phone": (390, 844, "light"),
}


def squares(picture: Image.Image) -> np.ndarray:
    """Mean colours: (rows, columns, 3)."""
    size = (picture.width // SQUARE_PX, picture.height // SQUARE_PX)
    return np.asarray(picture.convert("RGB").resize(size, Image.Resampling.BOX), dtype=float)


def differing(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the squares whose colour differs."""
    if one.shape != other.shape:
        return 1.0
    return float((np.abs(one - other).max(axis=2) > DIFFERENT).mean())


def looks_as_kept(tab: Any, name: str, tmp_path: Path) -> None:
    tab.wait_for_timeout(400)
    shot = Image.open(io.BytesIO(tab.screenshot()))
    path = KEPT / f"{name}.png"
    if os.environ.get("FIELDKIT_PICTURES") == "write":
        KEPT.mkdir(exist_ok=True)
        Image.fromarray(squares(shot).round().astype(np.uint8)).save(path, optimize=True)
    with Image.open(path) as kept:
        share = differing(squares(shot), np.asarray(kept, dtype=float))
    if share > MOST:
        shot.save(tmp_path / f"{name}.png")
    assert share <= MOST, f"{share:.1%} of {name} looks different: {tmp_path / name}.png"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("pictures")
    record_simulated(top, duration_s=120.0, sources_found=9)
    return top


@pytest.fixture
def recording(folder: Path) -> Iterator[str]:
    with serve.past(open_recording(folder / "mission.mcap")) as page:
        yield page.address


def view(width: int, height: int, scheme: str) -> dict[str, Any]:
    return {"viewport": {"width": width, "height": height}, "color_scheme": scheme}


@pytest.mark.parametrize("name", LOOKS)
def test_the_page_of_a_recording(browser: Any, recording: str, name: str, tmp_path: Path) -> None:
    with looking(browser, recording, **view(*LOOKS[name])) as tab:
        tab.wait_for_function("() => window.fieldkit.grids.belief")
        looks_as_kept(tab, f"recording-{name}", tmp_path)


@pytest.mark.parametrize("name", ["desk", "phone"])
def test_the_editor(browser: Any, folder: Path, name: str, tmp_path: Path) -> None:
    with (
        plan(folder / "mission.toml") as page,
        looking(browser, page.command_address, **view(*LOOKS[name])) as tab,
    ):
        tab.wait_for_selector("#remarks li")
        looks_as_kept(tab, f"editor-{name}", tmp_path)


def test_the_list_of_recordings(browser: Any, folder: Path, tmp_path: Path) -> None:
    with (
        shelf(folder, partial(_past, host="127.0.0.1")) as page,
        looking(browser, page.address, **view(*LOOKS["small"])) as tab,
    ):
        tab.wait_for_selector("#rows tr")
        looks_as_kept(tab, "recordings", tmp_path)


def test_the_report_on_screen_and_on_paper(browser: Any, folder: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(
        build(), ["report", str(folder / "mission.mcap"), "-o", str(tmp_path / "report.html")]
    )
    assert done.exit_code == 0, done.output
    context = browser.new_context(offline=True, **view(*LOOKS["laptop"]))
    tab = context.new_page()
    tab.goto((tmp_path / "report.html").as_uri())
    looks_as_kept(tab, "report", tmp_path)
    tab.emulate_media(media="print", color_scheme="light")
    looks_as_kept(tab, "report-paper", tmp_path)
    context.close()


def test_what_has_moved_is_seen_and_letters_are_not() -> None:
    with Image.open(KEPT.parents[2] / "docs" / "pictures" / "plan.png") as picture:
        page = picture.convert("RGB")
    moved = Image.new("RGB", page.size, page.getpixel((5, page.height - 5)))
    moved.paste(page, (0, 24))
    blurred = page.resize((page.width // 2, page.height // 2), Image.Resampling.BILINEAR).resize(page.size)
    gone = page.copy()
    gone.paste((255, 255, 255), (980, 60, 1440, 400))
    assert differing(squares(page), squares(moved)) > MOST
    assert differing(squares(page), squares(gone)) > MOST
    assert differing(squares(page), squares(blurred)) < MOST / 4
