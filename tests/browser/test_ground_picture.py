"""A picture of the ground lies under the map where it belongs, seen pixel by pixel."""

from pathlib import Path
from typing import Any

from flying import looking, wait_until
from PIL import Image

from fieldkit.messages import Tick
from mission.core.mission_file import read_mission
from mission.lab.synthetic import small_mission
from mission.page import serve

COLOURS = {"nw": (200, 30, 30), "ne": (30, 160, 30), "sw": (30, 30, 200), "se": (200, 180, 30)}
PLACES = {"nw": (3, 7), "ne": (8, 8), "sw": (2, 2), "se": (7, 1)}


def test_each_quarter_of_the_picture_is_in_its_quarter_of_the_field(browser: Any, tmp_path: Path) -> None:
    picture = Image.new("RGB", (100, 100))
    for name, colour in COLOURS.items():
        picture.paste(
            colour, (50 * ("e" in name), 50 * ("s" in name), 50 + 50 * ("e" in name), 50 + 50 * ("s" in name))
        )
    picture.save(tmp_path / "ground.png")
    (tmp_path / "ground.pgw").write_text("0.1\n0\n0\n-0.1\n0.05\n9.95\n")
    small_mission(tmp_path)
    path = tmp_path / "mission.toml"
    text = path.read_text()
    more = 'background = "ground.png"\nbackground_crs = "local"\n'
    path.write_text(text.replace("origin_lat_deg", f"{more}origin_lat_deg", 1))
    mission = read_mission(path)
    with serve.live(mission) as shown, looking(browser, shown.page.address) as tab:
        wait_until(lambda: shown.page.clients == 1)
        for second in range(3):
            shown.follower.event(second, second * 10**9, Tick(second * 10**9))
        tab.wait_for_function("() => window.fieldkit.frame && window.fieldkit.version.grids > 0")
        tab.check("input[value=none]", force=True)
        tab.wait_for_timeout(300)
        for name, (east_m, north_m) in PLACES.items():
            seen = tab.evaluate(
                """async ([east, north]) => {
                  const { toPixels } = await import("/mapview.js");
                  const canvas = document.getElementById("map");
                  const ratio = canvas.width / canvas.clientWidth;
                  const [x, y] = toPixels([east, north]);
                  return [...canvas.getContext("2d").getImageData(x * ratio + 3, y * ratio + 3, 1, 1).data].slice(0, 3);
                }""",
                [east_m, north_m],
            )
            assert all(abs(a - b) < 40 for a, b in zip(seen, COLOURS[name], strict=True)), (name, seen)
