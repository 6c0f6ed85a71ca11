"""The page on a phone, 390 by 844 and touched, in the light scheme that sunlight asks for."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from typing import Any, Self

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


class Air:
    """What is between a phone and the page; out of reach, it carries nothing and tells nobody."""

    def __init__(self, port: int) -> None:
        self._page, self._server = port, socket.create_server(("127.0.0.1", 0))
        self.port = self._server.getsockname()[1]
        self.ends: list[socket.socket] = []
        self._carries: list[threading.Event] = []

    def __enter__(self) -> Self:
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        for each in (self._server, *self.ends):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def lose(self) -> None:
        """Everything that is connected now is out of reach for ever; whoever connects anew is not."""
        for each in self._carries:
            each.clear()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self._page))
                carries = threading.Event()
                carries.set()
                self.ends += [near, far]
                self._carries.append(carries)
                for pair in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=(*pair, carries), daemon=True).start()

    @staticmethod
    def _carry(source: socket.socket, target: socket.socket, carries: threading.Event) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65_536):
                if carries.is_set():
                    target.sendall(data)
            if carries.is_set():
                target.shutdown(socket.SHUT_WR)


def test_a_phone_that_was_out_of_reach_is_back_when_it_is_looked_at(browser: Any, walking: Flown) -> None:
    """Its line has died without a word: no browser notices that by itself for minutes."""
    with Air(walking.page.port) as air:
        address = f"http://127.0.0.1:{air.port}/#{walking.page.token}"
        with looking(browser, address, viewport=PHONE) as tab:
            tab.wait_for_function("() => window.fieldkit.frame && window.fieldkit.mayCommand")
            air.lose()
            tab.wait_for_selector("text=NOT THE PRESENT")
            before = tab.evaluate("() => [window.fieldkit.frame.t_s, window.fieldkit.tracks.r1.length]")
            tab.evaluate("() => dispatchEvent(new Event('online'))")
            tab.wait_for_function("(t_s) => window.fieldkit.frame.t_s > t_s", arg=before[0])
            tab.wait_for_selector("#stale", state="hidden")
            assert tab.evaluate("() => window.fieldkit.tracks.r1.length") >= before[1]
            tab.locator("#hold-all").click()
            wait_until(lambda: walking.asked("hold"))
