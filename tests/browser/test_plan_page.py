"""From nothing to a mission that preflight lets start, in the editor alone: no file is edited by hand."""

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from flying import looking

from mission.core.mission_file import read_mission
from mission.lab.synthetic import emulated_pair, small_mission
from mission.plan.serve import plan

STORED = "() => document.getElementById('stored').textContent === 'stored'"
STANDING = "() => window.fieldkitPlan.state.standing.some(({ place }) => Math.hypot(...place) < 0.5)"
MENDED = "() => document.getElementById('verdict').className !== 'red'"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with an antenna file, as calibration leaves it, and no mission."""
    (tmp_path / "made").mkdir()
    small_mission(tmp_path / "made")
    shutil.copy(tmp_path / "made" / "antenna.toml", tmp_path / "antenna.toml")
    return tmp_path


@pytest.fixture
def tab(browser: Any, folder: Path) -> Iterator[Any]:
    with plan(folder / "mission.toml") as page, looking(browser, page.command_address) as tab:
        tab.wait_for_selector("#remarks li")
        yield tab


def fill(tab: Any, key: str, value: str) -> None:
    box = tab.locator(f'[data-key="{key}"]')
    box.fill(value)
    box.press("Tab")


def settled(tab: Any, words: str) -> None:
    tab.wait_for_function("(words) => document.getElementById('text').textContent.includes(words)", arg=words)


def test_a_newcomer_gets_from_nothing_to_a_mission_that_may_start(browser: Any, folder: Path) -> None:
    with (
        emulated_pair(read_mission(folder / "made" / "mission.toml")) as (field, address),
        plan(folder / "mission.toml") as page,
        looking(browser, page.command_address) as tab,
    ):
        tab.set_default_timeout(120_000)
        tab.wait_for_selector("#remarks li.red")
        assert tab.locator("#store").is_enabled() and not (folder / "mission.toml").exists()
        fill(tab, "top.name", "north meadow")
        fill(tab, "field.size_east_m", "10")
        fill(tab, "field.size_north_m", "10")
        settled(tab, "size_north_m = 10")
        # Which vehicles are there? They are heard, and added by a press.
        tab.fill("#address", f"udpin:{address}")
        tab.click("#heard")
        tab.wait_for_selector("#around .thing >> text=system 2")
        tab.locator("#around .thing >> nth=0").locator("button").click()
        tab.locator("#around .thing >> nth=1").locator("button").click()
        assert tab.locator("#around button:disabled").all_inner_texts() == ["done", "done"]
        tab.locator("#around .thing", has_text="begin the field where system").locator("button").click()
        tab.wait_for_function(STANDING)
        for name in ("r1", "r2"):  # serial ports of emulated radios are no USB devices: they are typed
            fill(tab, f"robot {name}: receiver.port", field.receiver_ports[name])
            settled(tab, field.receiver_ports[name])
        lat_deg, lon_deg = read_mission(folder / "made" / "mission.toml").frame.to_geodetic(0.0, 0.0)[:2]
        fill(tab, "field.origin_lat_deg", f"{lat_deg:.7f}")
        fill(tab, "field.origin_lon_deg", f"{lon_deg:.7f}")
        settled(tab, f"origin_lon_deg = {float(f'{lon_deg:.7f}')}")
        tab.wait_for_function(MENDED)
        tab.click("#store")
        tab.wait_for_function(STORED)
        mission = read_mission(folder / "mission.toml")
        assert mission.kernel.engine.teams == (("r1", "r2"),) and mission.file.name == "north meadow"
        tab.click("#preflight")
        tab.wait_for_selector("#checks >> text=before the start:")
        words = tab.locator("#checks").inner_text()
        assert "before the start: red" not in words, words
        tab.wait_for_selector(f"#next >> text=fieldkit run {folder / 'mission.toml'}")
        checked = subprocess.run(
            [sys.executable, "-m", "fieldkit", "check", str(folder / "mission.toml")],
            capture_output=True,
            text=True,
            check=False,
        )
        assert checked.returncode == 0, checked.stderr


def test_a_fence_is_drawn_a_corner_moved_and_an_area_closed(tab: Any, folder: Path) -> None:
    box = tab.locator("#map").bounding_box()

    def tap(*corners: tuple[float, float]) -> None:
        for x, y in corners:
            tab.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])

    tab.click("[data-draw=fence]")
    tap((0.35, 0.3), (0.65, 0.3), (0.65, 0.7), (0.35, 0.7))
    tab.click("[data-draw=fence]")
    settled(tab, "\nfence = [[")
    fence = tab.evaluate("window.fieldkitPlan.state.form.field.fence")
    assert len(fence) == 4 and all(0 < value < 25 for corner in fence for value in corner)
    tab.mouse.move(box["x"] + 0.65 * box["width"], box["y"] + 0.3 * box["height"])
    tab.mouse.down()
    tab.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 0.25 * box["height"], steps=4)
    tab.mouse.up()
    tab.wait_for_function(f"() => window.fieldkitPlan.state.form.field.fence[1][0] < {fence[1][0]} - 0.3")
    tab.click("[data-draw=keep_out]")
    tap((0.45, 0.45), (0.5, 0.45), (0.5, 0.5))
    tab.click("[data-draw=keep_out]")
    settled(tab, "\nkeep_out = [[[")
    tab.click("[data-draw=keep_out]")
    tap((0.45, 0.45))
    tab.click("[data-draw=keep_out]")
    tab.wait_for_selector("#notice >> text=three corners")
    tab.click("#clear")
    tab.wait_for_function("() => window.fieldkitPlan.state.form.field.fence === null")


def test_whoever_begins_reads_one_thing_to_do_and_can_always_store(tab: Any) -> None:
    assert tab.locator("#remarks").inner_text() == "No robot yet: add one, with its radio and its vehicle."
    for width, height in ((800, 600), (390, 844)):
        tab.set_viewport_size({"width": width, "height": height})
        tab.evaluate("window.scrollTo(0, 1e6)")
        box = tab.locator("#store").bounding_box()
        assert box["y"] >= 0 and box["y"] + box["height"] <= height, "it stays in reach"


def test_what_is_being_typed_into_a_row_outlives_a_late_answer(tab: Any) -> None:
    tab.click("#add")
    tab.wait_for_selector("#remarks >> text=robot r1: receiver")
    held: list[Any] = []
    tab.route("**/plan/change", lambda route: held.append(route))
    fill(tab, "top.name", "mine")
    port = tab.locator('[data-key="robot r1: receiver.port"]')
    port.press_sequentially("/dev/tty")
    tab.wait_for_timeout(100)
    held.pop().continue_()
    tab.unroute("**/plan/change")
    settled(tab, 'name = "mine"')
    port.press_sequentially("USB0")
    port.press("Tab")
    settled(tab, 'port = "/dev/ttyUSB0"')


def test_what_is_wrong_leads_to_its_box(tab: Any) -> None:
    tab.click("#add")
    tab.wait_for_selector("#remarks >> text=robot r1: receiver")
    tab.locator("#remarks button").first.click()
    assert tab.evaluate("document.activeElement.dataset.key") == "robot r1: receiver.port"
    fill(tab, "field.cell_m", "-1")
    tab.wait_for_selector('[data-key="field.cell_m"][aria-invalid=true]')
    assert "to mend" in tab.locator("#verdict").inner_text()


def test_odd_names_are_kept_as_they_are(tab: Any, folder: Path) -> None:
    odd = "<b>Łódź</b> 🛰 \"quoted\" 'x' שלום"
    fill(tab, "top.name", odd)
    tab.wait_for_function("(odd) => window.fieldkitPlan.state.form.top.name === odd", arg=odd)
    assert tab.locator("#text b").count() == 0


def test_only_looking_changes_nothing(browser: Any, folder: Path) -> None:
    with (
        plan(folder / "mission.toml") as page,
        looking(browser, page.address + "#wrong", is_refused=True) as tab,
    ):
        tab.wait_for_selector("#notice >> text=token is wrong")
        assert tab.locator("#text").inner_text() == ""


def test_a_file_changed_by_hand_meanwhile_is_not_overwritten(browser: Any, folder: Path) -> None:
    path = folder / "mission.toml"
    with plan(path) as page, looking(browser, page.command_address, is_refused=True) as tab:
        tab.click("#store")
        tab.wait_for_function(STORED)
        path.write_text(path.read_text() + "# by hand\n")
        fill(tab, "top.name", "mine")
        tab.wait_for_selector("#stored >> text=changed")
        tab.click("#store")
        tab.wait_for_selector("#notice >> text=changed by somebody else")
    assert path.read_text().endswith("# by hand\n")


def test_nothing_can_be_pressed_before_it_is_listened_to(browser: Any, folder: Path) -> None:
    with (
        plan(folder / "mission.toml") as page,
        looking(browser, page.address + "#wrong", is_refused=True) as tab,
    ):
        tab.wait_for_selector("#notice >> text=token is wrong")
        assert tab.evaluate("document.body.inert")


def test_teams_that_there_are_stay_together(tab: Any) -> None:
    teams = tab.evaluate(
        "import('./plan-robots.js').then((m) => m.paired(['a', 'b', 'c', 'd', 'e'], [['d', 'a'], ['x']]))"
    )
    assert teams == [["d", "a"], ["b", "c"], ["e"]]
