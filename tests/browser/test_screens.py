"""Nothing lies over anything else and nothing runs off the side, on any screen, whatever robots are called."""

from pathlib import Path
from typing import Any

from flying import Flown, looking

SIZES = [(1440, 900), (1024, 768), (800, 600), (390, 844)]
APART = [
    "#mission",
    "#clock",
    "#state",
    "header .facts",
    "#alarm-sound",
    "#hold-all",
    "#layers",
    ".tools",
    "#legend",
]
APART += ["#commands button", "#back", "#tabs button"]
OVERLAPS = """(selectors) => {
  const seen = (node) => node.checkVisibility() && node.getBoundingClientRect().width > 0;
  const isFixed = (node) => getComputedStyle(node).position === 'fixed';
  const named = (name) => [...document.querySelectorAll(name)].filter(seen).map((node) => [name, node]);
  const boxes = selectors.flatMap(named);
  const wrong = [];
  for (const [name, node] of boxes) {
    const a = node.getBoundingClientRect();
    if (a.left < -0.5 || a.right > innerWidth + 0.5) wrong.push(`${name} runs off the side`);
    for (const [other, second] of boxes) {
      if (node.contains(second) || second.contains(node) || isFixed(node) || isFixed(second)) continue;
      const b = second.getBoundingClientRect();
      const across = a.left < b.right - 1 && b.left < a.right - 1;
      if (across && a.top < b.bottom - 1 && b.top < a.bottom - 1) wrong.push(`${name} and ${other}`);
    }
  }
  const width = document.documentElement.scrollWidth;
  if (width > innerWidth) wrong.push(`the page is ${width} wide`);
  return [...new Set(wrong)];
}"""
ODD = [
    "<img src=x onerror=alert(1)>",
    "🚜" * 20,
    "רובוט ראשון",
    "r" * 60,
    "[bold]r[/bold]",
    "ロボット",
    "a b",
    "Ærø",
]


def test_nothing_overlaps(browser: Any, flown: Flown) -> None:
    for width, height in SIZES:
        viewport = {"width": width, "height": height}
        with looking(browser, flown.page.command_address, viewport=viewport) as tab:
            tab.wait_for_selector("#robots .card")
            tab.wait_for_function("() => window.fieldkit.grids.belief")
            tab.wait_for_timeout(200)
            assert not tab.evaluate(OVERLAPS, APART), viewport


def test_what_lies_over_something_is_noticed(browser: Any, flown: Flown) -> None:
    with looking(browser, flown.page.command_address) as tab:
        tab.wait_for_selector("#robots .card")
        tab.evaluate("() => { document.querySelector('.tools').style.right = '60%'; }")
        assert tab.evaluate(OVERLAPS, APART)


def test_64_oddly_named_robots_and_200_candidates_fit(browser: Any, flown: Flown) -> None:
    for width, height in SIZES:
        crowd(browser, flown, width, height)


def crowd(browser: Any, flown: Flown, width: int, height: int) -> None:
    with looking(browser, flown.page.address, viewport={"width": width, "height": height}) as tab:
        tab.wait_for_selector("#robots .card")
        tab.evaluate(CROWD, [ODD[k % len(ODD)] + f" {k}" for k in range(64)])
        tab.wait_for_selector(".card >> nth=67", state="attached")
        tab.wait_for_timeout(300)
        assert not tab.evaluate(OVERLAPS, APART)
        assert tab.locator("img[src=x], .card b").count() == 0, "names are words, not markup"
        assert tab.evaluate("document.documentElement.scrollHeight") <= max(height, 3 * 844)
        if width <= 1180:
            tab.click("#tabs [data-tab=sources]")
        assert tab.locator(".source").count() <= 60
        assert "candidates below 5 %" in tab.locator("#faint-sources").inner_text()


CROWD = """(names) => {
  const model = window.fieldkit;
  const like = model.frame.robots[0];
  const crowd = names.map((name, k) => ({ ...like, name, east_m: (k % 8) + 0.5, north_m: Math.floor(k / 8) + 0.5 }));
  const sources = Array.from({ length: 200 }, (_, k) => ({
    ident: k, state: k < 5 ? 'found' : 'candidate', east_m: (k * 7) % 10, north_m: (k * 3) % 10,
    half_axes_m: [0.5, 0.3], turn_deg: 20, p: k < 5 ? 0.95 : k % 2 ? 0.01 : 0.2,
    receptions: 3, power_db: -3, rate_hz: 0.1, note: '',
  }));
  model.hello.robots = [...model.hello.robots, ...names.map((name) => ({ name, team: 9, on_foot: false }))];
  let frame = model.frame;
  Object.defineProperty(model, 'frame', {
    get: () => frame && { ...frame, robots: [...frame.robots, ...crowd], sources },
    set(next) { frame = next; },
  });
  model.version.side += 1;
}"""


def test_a_browser_whose_clock_is_an_hour_off_shows_the_missions_time(browser: Any, flown: Flown) -> None:
    with looking(browser, flown.page.command_address) as tab:
        tab.add_init_script("const now = Date.now; Date.now = () => now() + 3600000;")
        tab.reload()
        tab.wait_for_function("() => document.getElementById('state').textContent.startsWith('live')")
        minutes, seconds = tab.locator("#clock").inner_text().split(":")
        assert int(minutes) * 60 + int(seconds) < 600 and not tab.locator("#stale").is_visible()


def test_a_page_opened_twice_commands_from_both(browser: Any, flown: Flown) -> None:
    with (
        looking(browser, flown.page.command_address) as one,
        looking(browser, flown.page.command_address) as two,
    ):
        for tab in (one, two):
            tab.wait_for_function("() => document.getElementById('state').textContent === 'live'")
        one.wait_for_selector("#viewers >> text=2 look, 2 may command", state="attached")
        two.keyboard.press("h")
        one.wait_for_selector("text=operator: hold all")


def test_black_and_white_paper_keeps_the_map_and_the_words(
    browser: Any, flown: Flown, tmp_path: Path
) -> None:
    with looking(browser, flown.page.command_address) as tab:
        tab.wait_for_selector("#robots .card")
        tab.emulate_media(media="print", color_scheme="light")
        assert not tab.locator("#hold-all").is_visible() and tab.locator("#map").is_visible()
        assert tab.locator("#robots .card").first.is_visible()
        assert len(tab.pdf(print_background=False)) > 10_000
        assert tab.evaluate("getComputedStyle(document.body).color") == "rgb(0, 0, 0)"
