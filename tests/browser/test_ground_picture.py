"""A picture of the ground lies where it belongs, seen pixel by pixel: under page, editor, report and its plot."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying import looking, wait_until
from matplotlib.figure import Figure
from PIL import Image
from typer.testing import CliRunner

from fieldkit.cli import build
from fieldkit.messages import Tick
from mission.analysis.plots import draw_ground
from mission.core.mission_file import Mission, read_mission
from mission.lab.synthetic import record, small_mission
from mission.maps.background import read_background
from mission.page import serve
from mission.plan.serve import plan

COLOURS = {"nw": (200, 30, 30), "ne": (30, 160, 30), "sw": (30, 30, 200), "se": (200, 180, 30)}
PLACES = {"nw": (3, 7), "ne": (8, 8), "sw": (2, 2), "se": (7, 1)}
SEEN = """async ([east, north, module]) => {
  const { toPixels } = await import(module);
  const canvas = document.getElementById("map");
  const ratio = canvas.width / canvas.clientWidth;
  const [x, y] = toPixels([east, north]);
  return [...canvas.getContext("2d").getImageData(x * ratio + 3, y * ratio + 3, 1, 1).data].slice(0, 3);
}"""


def is_seen(tab: Any, module: str = "/mapview.js", most: float = 40.0) -> None:
    for name, place in PLACES.items():
        seen = tab.evaluate(SEEN, [*place, module])
        assert all(abs(a - b) < most for a, b in zip(seen, COLOURS[name], strict=True)), (name, seen)


def quarters(folder: Path) -> None:
    """A picture of a colour a quarter, and where it lies: the field of 10 m, exactly."""
    picture = Image.new("RGB", (100, 100))
    for name, colour in COLOURS.items():
        picture.paste(
            colour, (50 * ("e" in name), 50 * ("s" in name), 50 + 50 * ("e" in name), 50 + 50 * ("s" in name))
        )
    picture.save(folder / "ground.png")
    (folder / "ground.pgw").write_text("0.1\n0\n0\n-0.1\n0.05\n9.95\n")


@pytest.fixture
def mission(tmp_path: Path) -> Mission:
    quarters(tmp_path)
    small_mission(tmp_path, duration_s=20.0, engine={"keep_teams": True})
    path = tmp_path / "mission.toml"
    text = path.read_text()
    more = 'background = "ground.png"\nbackground_crs = "local"\n'
    path.write_text(text.replace("origin_lat_deg", f"{more}origin_lat_deg", 1))
    return read_mission(path)


def test_under_the_page(browser: Any, mission: Mission) -> None:
    with serve.live(mission) as shown, looking(browser, shown.page.address) as tab:
        wait_until(lambda: shown.page.clients == 1)
        for second in range(120):  # a frame and a grid come with a tick, on a busy machine with a later one
            shown.follower.event(second, second * 10**9, Tick(second * 10**9))
            if tab.evaluate("() => Boolean(window.fieldkit?.frame) && window.fieldkit.version.grids > 0"):
                break
            tab.wait_for_timeout(500)
        tab.check("input[value=none]", force=True)
        tab.wait_for_timeout(300)
        is_seen(tab)


def test_under_the_editor(browser: Any, mission: Mission) -> None:
    with plan(Path(mission.where)) as page, looking(browser, page.command_address, is_refused=True) as tab:
        tab.wait_for_selector("#remarks li")
        tab.wait_for_timeout(500)
        is_seen(tab)
        tab.fill('[data-key="field.size_east_m"]', "0")
        tab.press('[data-key="field.size_east_m"]', "Tab")
        tab.wait_for_selector("text=must be known first")


def test_in_the_report(browser: Any, mission: Mission, tmp_path: Path) -> None:
    recorded = record(mission, tmp_path / "mission.mcap", 1)
    done = CliRunner().invoke(build(), ["report", str(recorded), "-o", str(tmp_path / "report.html")])
    assert done.exit_code == 0, done.output
    context = browser.new_context(viewport={"width": 1300, "height": 900}, offline=True)
    tab = context.new_page()
    tab.goto((tmp_path / "report.html").as_uri())
    tab.locator("iframe").evaluate("(node) => node.scrollIntoView()")
    frame = tab.frames[1]
    frame.wait_for_function("() => window.fieldkit?.grids.belief")
    frame.check("input[value=none]", force=True)
    tab.wait_for_timeout(500)
    is_seen(frame, "fieldkit/mapview.js")
    context.close()


def test_under_the_plot(mission: Mission) -> None:
    background = read_background(mission)
    assert background is not None
    figure = Figure(figsize=(5, 5), dpi=40)
    axes = figure.add_axes((0, 0, 1, 1))
    draw_ground(axes, background)
    axes.set(xlim=(0, 10), ylim=(0, 10))
    out = io.BytesIO()
    figure.savefig(out, format="png")
    pixels = np.asarray(Image.open(out).convert("RGB"))  # 200 x 200: 20 a metre
    for name, (east_m, north_m) in PLACES.items():
        seen = pixels[200 - 20 * north_m - 3, 20 * east_m + 3]
        assert np.abs(seen - np.array(COLOURS[name])).max() < 20, name
