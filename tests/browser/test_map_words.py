"""Places on the map in the words of other maps: tapped, shown, copied; north and a scale."""

import json
from collections.abc import Iterator
from typing import Any
from urllib.request import urlopen

import pytest
from flying import Flown, looking

PHONE = {"width": 390, "height": 844}
DRAWN = """async () => {
    const map = await import("./mapview.js");
    while (!map.view.scale) await new Promise((done) => setTimeout(done, 20));
}"""
"""Done once the map has been drawn."""


@pytest.fixture
def tab(browser: Any, flown: Flown) -> Iterator[Any]:
    with looking(browser, flown.page.address, viewport=PHONE, has_touch=True, is_mobile=True) as tab:
        tab.context.grant_permissions(["clipboard-read", "clipboard-write"])
        tab.wait_for_function("() => window.fieldkit.frame")
        tab.evaluate(DRAWN)
        yield tab


def test_a_tap_before_the_map_is_drawn_is_nowhere(tab: Any) -> None:
    asked: list[str] = []
    tab.on("request", lambda request: asked.append(request.url) if "where?" in request.url else None)
    tab.evaluate("""async () => {
        const { view } = await import("./mapview.js");
        const canvas = document.getElementById("map");
        const tap = (kind) => canvas.dispatchEvent(
            new PointerEvent(kind, { pointerId: 7, pointerType: "touch", clientX: 150, clientY: 300 }));
        view.scale = 0;
        tap("pointerdown"); tap("pointerup");
    }""")
    tab.evaluate(DRAWN)
    tab.locator("#map").tap()
    tab.wait_for_selector("#where:not([hidden]) [data-form=mgrs]")
    assert len(asked) == 1


def test_a_tap_says_where_that_is_and_another_copies_it(tab: Any, flown: Flown) -> None:
    box = tab.locator("#map").bounding_box()
    tab.touchscreen.tap(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    tab.wait_for_selector("#where:not([hidden]) [data-form=mgrs]")
    metres = tab.inner_text("#where [data-form=metres] span")
    east_m, north_m = (float(part.split()[0]) for part in metres.split(", "))
    with urlopen(f"{flown.page.address}where?east_m={east_m}&north_m={north_m}", timeout=10) as answer:
        said = json.loads(answer.read())
    for form in ("lat_lon", "utm", "mgrs"):
        button = tab.locator(f"#where [data-form={form}]")
        assert button.inner_text().split()[-1][:-2] == said[form].split()[-1][:-2], (
            "to the rounding of metres"
        )
        button.tap()
        tab.wait_for_selector(f"#where [data-form={form}].copied")
        assert tab.evaluate("() => navigator.clipboard.readText()") == button.locator("span").inner_text()
    field = tab.evaluate("() => window.fieldkit.hello.field")
    assert abs(east_m - field["east_m"] / 2) < field["east_m"] / 10
    tab.locator("#where .close").tap()
    assert tab.locator("#where").is_hidden()


def test_without_https_the_old_way_copies(tab: Any) -> None:
    """A phone in the field opens http://ADDRESS: there browsers keep the clipboard's new ways to themselves."""
    tab.evaluate("() => { Object.defineProperty(window, 'isSecureContext', { value: false }); }")
    tab.locator("#map").tap()
    button = tab.locator("#where [data-form=mgrs]")
    button.tap()
    tab.wait_for_selector("#where [data-form=mgrs].copied")
    assert tab.evaluate("() => navigator.clipboard.readText()") == button.locator("span").inner_text()


def test_a_tap_while_an_area_is_drawn_is_a_corner_and_no_question(browser: Any, flown: Flown) -> None:
    with looking(browser, flown.page.command_address) as tab:
        tab.wait_for_function("() => window.fieldkit.mayCommand && window.fieldkit.frame")
        tab.click("#exclude")
        tab.click("#map")
        assert tab.locator("#where").is_hidden()


def test_the_scale_is_a_round_length_that_fits(tab: Any) -> None:
    lengths = tab.evaluate(
        """async () => { const { scaleOf } = await import("/map.js");
          return [260, 130, 30, 1.3, 0.4, 0.01, 1000].map(scaleOf); }"""
    )
    assert lengths == [0.5, 1, 2, 100, 200, 10000, 0.5]
