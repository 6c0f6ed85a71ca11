"""Make the manual's pictures of the pages: make screenshots

Needs chromium and the development packages. A walk: one transmitter is hidden, a person walks to it by advice with
a LoRa module, over a drawn picture of the ground. A mission: simulated, shown as a recording. The editor: from no file
to a preflight, on two emulated rovers. The pictures go to docs/pictures.
"""

import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from playwright.sync_api import sync_playwright

from fieldkit.geo import FieldFrame
from fieldkit.recording.reader import open_recording
from mission.lab.synthetic import emulated_pair, record_simulated, small_mission
from mission.lab.walk_demo import ORIGIN_DEG, SIZE_M, demo_walk
from mission.page import serve
from mission.plan.serve import plan
from mission.shell.flight import fly
from mission.shell.warm_up import warm_up

OUT = Path(__file__).with_name("pictures")
PHONE: dict[str, Any] = {
    "viewport": {"width": 390, "height": 844},
    "has_touch": True,
    "is_mobile": True,
    "color_scheme": "light",
}
DESK: dict[str, Any] = {"viewport": {"width": 1440, "height": 900}, "color_scheme": "light"}
DRAWN = {
    "fence": ((0.16, 0.2), (0.8, 0.2), (0.84, 0.91), (0.16, 0.91)),
    "keep_out": ((0.45, 0.4), (0.55, 0.37), (0.57, 0.5), (0.47, 0.52)),
}
"""Corners, in shares of the map."""
SEED = 7
RATE = 20.0
HEARD_MID_WALK = "7"
LONGEST_MS = 300_000
LONGEST_PX = 640
PIXEL_M = 0.5
FIELDS = ((201, 214, 168), (188, 205, 150), (222, 214, 172), (176, 198, 143))


def draw_ground(folder: Path) -> str:
    """A made-up aerial picture of the field with its world file; the name for `background`."""
    rng = np.random.default_rng(SEED)
    side = round(1.4 * SIZE_M / PIXEL_M)
    picture = Image.new("RGB", (side, side), FIELDS[0])
    pen = ImageDraw.Draw(picture)
    for k, east in enumerate(range(0, side, 190)):
        for j, north in enumerate(range(-60 * (k % 2), side, 260)):
            pen.rectangle((east, north, east + 186, north + 256), fill=FIELDS[(k + 2 * j) % len(FIELDS)])
    bends = [(x, 0.62 * side + 40.0 * np.sin(x / 130.0)) for x in range(-20, side + 40, 20)]
    pen.line(bends, fill=(120, 160, 200), width=14, joint="curve")
    pen.line([(0.3 * side, 0), (0.42 * side, side)], fill=(235, 232, 225), width=10)
    for x, y in rng.normal((0.72 * side, 0.3 * side), 0.09 * side, (260, 2)):
        pen.ellipse((x - 7, y - 7, x + 7, y + 7), fill=(104, 140, 92), outline=(86, 122, 78))
    picture.save(folder / "ground.png")
    frame = FieldFrame(*ORIGIN_DEG)
    north_deg, west_deg, _ = frame.to_geodetic(-0.2 * SIZE_M, 1.2 * SIZE_M)
    south_deg, east_deg, _ = frame.to_geodetic(1.2 * SIZE_M, -0.2 * SIZE_M)
    across, down = (east_deg - west_deg) / side, (south_deg - north_deg) / side
    numbers = (across, 0.0, 0.0, down, west_deg + across / 2, north_deg + down / 2)
    (folder / "ground.pgw").write_text("".join(f"{number:.12f}\n" for number in numbers))
    return "ground.png"


def photograph(address: str, went_wrong: list[BaseException]) -> None:
    """Look at the walk as it goes on, and at what it has found."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    try:
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
            phone, desk = (browser.new_context(**look).new_page() for look in (PHONE, DESK))
            for tab in (phone, desk):
                tab.set_default_timeout(LONGEST_MS)
                tab.goto(address)
            phone.wait_for_function(
                f"""() => Number(document.getElementById("detections").textContent) >= {HEARD_MID_WALK}
                  && document.getElementById("walk-arrow").style.opacity === "1" """
            )
            phone.screenshot(path=OUT / "walk-phone.png")
            desk.screenshot(path=OUT / "walk-map.png")
            phone.wait_for_function(
                "() => document.getElementById('walk-go').textContent.includes('is over')"
            )
            phone.locator("#walk-found button").tap()
            phone.wait_for_selector("#where button[data-form=mgrs]")
            phone.wait_for_timeout(500)
            phone.screenshot(path=OUT / "walk-found.png")
            browser.close()
    except BaseException as error:
        went_wrong.append(error)


def photograph_editor(tab: Any, folder: Path) -> None:
    """The steps from no file to a mission that may start, on two emulated rovers with radios."""
    mission = small_mission(folder)
    with (
        emulated_pair(mission) as (field, address),
        plan(folder / "north-meadow.toml") as page,
    ):
        lat_deg, lon_deg, _ = mission.frame.to_geodetic(0.0, 0.0)
        tab.goto(page.command_address)
        tab.wait_for_selector("#remarks li.red")
        tab.screenshot(path=OUT / "plan-new.png")
        write(tab, "#address", f"udpin:{address}")
        tab.click("#heard")
        for row in range(3):  # both vehicles, and where the field begins
            tab.locator("#around .thing").nth(row).locator("button").click()
        tab.wait_for_selector(".robot >> nth=1")
        part(tab, "robots", "plan-heard")
        for key, value in (("size_east_m", "10"), ("size_north_m", "10")):
            write(tab, f'[data-key="field.{key}"]', value)
        write(tab, '[data-key="field.origin_lat_deg"]', f"{lat_deg:.7f}")
        write(tab, '[data-key="field.origin_lon_deg"]', f"{lon_deg:.7f}")
        part(tab, "remarks", "plan-remarks")
        for name, path in field.receiver_ports.items():
            write(tab, f'[data-key="robot {name}: receiver.port"]', path)
        draw(tab)
        tab.wait_for_function("() => document.getElementById('verdict').className !== 'red'")
        tab.click("#store")
        tab.wait_for_function("() => document.getElementById('stored').textContent === 'stored'")
        tab.screenshot(path=OUT / "plan.png")
        tab.click("#preflight")
        tab.wait_for_selector("#checks >> text=before the start:")
        part(tab, "start", "plan-preflight")


def write(tab: Any, where: str, text: str) -> None:
    """Type into a box, and wait until the server has taken it in."""
    tab.fill(where, text)
    tab.press(where, "Tab")
    tab.wait_for_timeout(400)


def draw(tab: Any) -> None:
    """A fence and a closed area."""
    box = tab.locator("#map").bounding_box()
    for kind, corners in DRAWN.items():
        tab.click(f"[data-draw={kind}]")
        for x, y in corners:
            tab.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
        tab.click(f"[data-draw={kind}]")
        tab.wait_for_timeout(300)


def part(tab: Any, name: str, file: str) -> None:
    """One panel of the editor, or the upper part of a long one."""
    path = OUT / f"{file}.png"
    tab.locator(f"section[aria-labelledby=h-{name}]").screenshot(path=path)
    with Image.open(path) as shot:
        shot.crop((0, 0, shot.width, min(shot.height, LONGEST_PX))).save(path)


def photograph_recording(tab: Any, folder: Path) -> None:
    """The page of a mission, as a recording shows it."""
    recorded = record_simulated(folder, duration_s=400.0, sources_found=9)
    with serve.past(open_recording(recorded)) as page:
        tab.goto(page.address)
        tab.wait_for_function("() => window.fieldkit.grids.belief")
        tab.wait_for_timeout(500)
        tab.screenshot(path=OUT / "page.png")


def photograph_desk() -> None:
    """What is looked at on a desk."""
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_playwright() as driver, tempfile.TemporaryDirectory(prefix="fieldkit-") as made:
        browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        for name, take in (("editor", photograph_editor), ("recording", photograph_recording)):
            (Path(made) / name).mkdir()
            tab = browser.new_context(**DESK).new_page()
            take(tab, Path(made) / name)
        browser.close()


def main() -> None:
    OUT.mkdir(exist_ok=True)
    photograph_desk()
    with tempfile.TemporaryDirectory(prefix="fieldkit-") as made:
        folder = Path(made)
        with demo_walk(folder, "lora", SEED, RATE, background=draw_ground(folder)) as (mission, setup, truth):
            warm_up(mission)
            with serve.live(mission) as shown:
                went_wrong: list[BaseException] = []
                looking = threading.Thread(target=photograph, args=(shown.page.command_address, went_wrong))
                looking.start()
                fly(mission, setup, folder / "mission.mcap", lambda _: None, truth=truth, page=shown)
                shown.follower.publish()
                looking.join()
    if went_wrong:
        raise went_wrong[0]
    for path in OUT.glob("*.png"):  # a third of the size, and nobody sees it
        with Image.open(path) as shot:
            shot.convert("RGB").quantize(256).save(path, optimize=True)
    print(f"written: {len(list(OUT.glob('*.png')))} pictures in {OUT}")


if __name__ == "__main__":
    main()
