"""axe-core (WCAG 2.2 AA) on every view of the page, dark and light, on a desk and on a phone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying import Flown, found_wrong, looking
from sizes import size

from fieldkit.messages import SourceEstimate
from fieldkit.recording.reader import open_recording
from mission.lab.synthetic import record_simulated
from mission.page import serve

pytest.importorskip("axe_playwright_python.sync_playwright", reason="pip install .[dev]")
ALL_LOOKS = [
    (1440, 900, "dark"),
    (1440, 900, "light"),
    (800, 600, "dark"),
    (390, 844, "light"),
    (390, 844, "dark"),
]
LOOKS = size([ALL_LOOKS[1], ALL_LOOKS[4]], ALL_LOOKS)


def show_all(flown: Flown) -> None:
    """Sources of each state, a robot that calls, an alarm."""
    states = ("found", "candidate", "inconsistent", "outside")
    sources = [
        SourceEstimate(k, 2.0 * k, 5.0, np.diag([0.09, 0.04]), 4, 5.0, 0.1, 1.0, 0.9, state)  # type: ignore[arg-type]
        for k, state in enumerate(states, start=1)
    ]
    flown.runner.kernel.belief.sources = lambda: sources  # type: ignore[method-assign]
    flown.runner.kernel._sources = None
    for follower in flown.runner.followers:
        follower.sources(0, flown.runner.setup.clock.now_ns(), sources)
    flown.receivers["r3"].set_up(False, "unplugged")
    flown.receivers["r1"].hear(-61.0)


def free_pixel(tab: Any) -> tuple[float, float]:
    """A place on the map where no robot or source is tapped: they move."""
    box = tab.locator("#map").bounding_box()
    x, y = tab.evaluate(
        """() => import('/mapview.js').then(({ toPixels }) => {
            const { robots, sources } = window.fieldkit.frame;
            const things = [...robots, ...sources].filter((each) => each.east_m !== null);
            const taken = things.map((each) => toPixels([each.east_m, each.north_m]));
            const places = [2, 3, 4, 6, 7, 8].flatMap((e) => [2, 3, 4, 6, 7, 8].map((n) => toPixels([e, n])));
            const far = ([x, y]) => Math.min(...taken.map(([u, v]) => Math.hypot(u - x, v - y)));
            return places.sort((a, b) => far(b) - far(a))[0];
        })"""
    )
    return box["x"] + x, box["y"] + y


def test_a_live_mission_has_no_finding(browser: Any, flown: Flown) -> None:
    for width, height, scheme in LOOKS:
        look_at_all_of_it(browser, flown, width, height, scheme)


def look_at_all_of_it(browser: Any, flown: Flown, width: int, height: int, scheme: str) -> None:
    look = {"viewport": {"width": width, "height": height}, "color_scheme": scheme}
    with looking(browser, flown.page.command_address, **look) as tab:
        tab.wait_for_selector("#robots .card")
        show_all(flown)
        tab.wait_for_function("() => window.fieldkit.frame.sources.length === 4")
        tab.wait_for_function("() => window.fieldkit.detections.length > 0")
        for name in ("robots", "sources", "signals", "events"):
            if width <= 1180:
                tab.click(f"#tabs [data-tab={name}]")
            tab.wait_for_timeout(100)
            assert not found_wrong(tab), (width, height, scheme)
            if width > 1180:
                break
        tab.mouse.click(*free_pixel(tab))
        tab.wait_for_selector("#where")
        assert not found_wrong(tab)


def test_a_walk_has_no_finding(browser: Any, walking: Flown) -> None:
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    with looking(browser, walking.page.command_address, **phone, color_scheme="light") as tab:
        tab.wait_for_selector("#walk-go")
        assert not found_wrong(tab)


def test_a_recording_has_no_finding(browser: Any, tmp_path: Path) -> None:
    recorded = record_simulated(tmp_path, duration_s=60.0, sources_found=9)
    with serve.past(open_recording(recorded)) as page, looking(browser, page.address) as tab:
        tab.wait_for_function("() => window.fieldkit.frame")
        assert not found_wrong(tab)


def test_the_mission_editor_has_no_finding(browser: Any, tmp_path: Path) -> None:
    from mission.plan.serve import plan

    with plan(tmp_path / "mission.toml") as page:
        for width, height, scheme in LOOKS:
            look = {"viewport": {"width": width, "height": height}, "color_scheme": scheme}
            with looking(browser, page.command_address, **look) as tab:
                tab.wait_for_selector("#remarks li")
                tab.click("#add")
                tab.wait_for_selector(".robot")
                assert not found_wrong(tab), (width, height, scheme)
