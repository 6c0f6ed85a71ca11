"""The page on a phone, 390 by 844 and touched, in the light scheme that sunlight asks for."""

from collections.abc import Iterator
from typing import Any

import pytest
from flying import Flown, looking, wait_until

PHONE = {"width": 390, "height": 844}
READABLE = 4.5
"""Contrast that WCAG 2.2 asks of text (AA)."""
CONTRAST = """(ids) => {
  const parse = (text) => text.match(/[\\d.]+/g).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const ground = (node) => {
    for (let at = node; at; at = at.parentElement) {
      const colour = parse(getComputedStyle(at).backgroundColor);
      if (colour.length < 4 || colour[3] > 0.99) return colour;
    }
    return [255, 255, 255];
  };
  return Object.fromEntries(ids.map((id) => {
    const node = document.querySelector(id);
    const [a, b] = [light(parse(getComputedStyle(node).color)), light(ground(node))];
    return [id, (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05)];
  }));
}"""


@pytest.fixture
def tab(browser: Any, walking: Flown) -> Iterator[Any]:
    phone = {"viewport": PHONE, "has_touch": True, "is_mobile": True, "color_scheme": "light"}
    with looking(browser, walking.page.command_address, **phone) as tab:
        tab.wait_for_selector("#walk:not([hidden])")
        yield tab


def test_what_a_walker_reads_has_the_contrast_that_text_needs(tab: Any) -> None:
    shown = [
        "#walk-go",
        "#walk-why",
        "#walk-now",
        "#walk-peak",
        "#walk-sound",
        "#walk-turn",
        "#walk-mark",
        "#clock",
    ]
    contrast = tab.evaluate(CONTRAST, shown)
    assert {name: round(value, 1) for name, value in contrast.items() if value < READABLE} == {}


def test_a_thumb_marks_sounds_and_holds(tab: Any, walking: Flown) -> None:
    tab.locator("#walk-sound").tap()
    assert tab.inner_text("#walk-sound") == "Sound off"
    tab.locator("#walk-mark").tap()
    tab.locator("#walk-mark").tap()
    wait_until(lambda: walking.asked("mark", "r1"))
    tab.locator("#hold-all").tap()
    wait_until(lambda: walking.asked("hold"))


def test_nothing_is_wider_than_the_phone(tab: Any) -> None:
    assert tab.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
