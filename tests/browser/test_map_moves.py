"""The map under fingers, mouse and keys; the time line; what is old, and what calls the operator."""

import json
from typing import Any

import numpy as np
import pytest
from flying import Flown, looking, wait_until

from fieldkit.messages import SourceEstimate

LIVE = "() => document.getElementById('state').textContent === 'live'"
VIEW = "import('./mapview.js').then((m) => [...m.toMetres([200, 200]), m.X(1) - m.X(0)])"


@pytest.fixture
def tab(browser: Any, flown: Flown) -> Any:
    with looking(browser, flown.page.command_address) as tab:
        tab.wait_for_function(LIVE)
        tab.wait_for_selector("#robots .card")
        yield tab


def view(tab: Any) -> tuple[float, float, float]:
    """Where a pixel of the map is, and pixels a metre."""
    tab.wait_for_timeout(150)
    east_m, north_m, scale = tab.evaluate(VIEW)
    return east_m, north_m, scale


def middle(tab: Any) -> tuple[float, float]:
    box = tab.locator("#map").bounding_box()
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def shown(flown: Flown, sources: list[SourceEstimate]) -> None:
    for follower in flown.runner.followers:
        follower.sources(0, flown.runner.setup.clock.now_ns(), sources)
    flown.runner.kernel.belief.sources = lambda: sources  # type: ignore[method-assign]
    flown.runner.kernel._sources = None


def candidate(
    ident: int, east_m: float, north_m: float, p: float, state: Any = "candidate"
) -> SourceEstimate:
    return SourceEstimate(ident, east_m, north_m, np.diag([0.04, 0.04]), 4, 5.0, 0.1, 1.0, p, state)


def test_a_drag_moves_the_map_by_as_much(tab: Any) -> None:
    before = view(tab)
    x, y = middle(tab)
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 60, y + 30, steps=4)
    tab.mouse.up()
    moved = (before[0] - 60 / before[2], before[1] + 30 / before[2])
    wait_until(lambda: view(tab)[:2] == pytest.approx(moved, abs=0.02))
    assert view(tab)[2] == pytest.approx(before[2])
    assert not tab.locator("#where").is_visible(), "a drag is no tap"
    tab.click("#zoom-whole")
    assert view(tab) == pytest.approx(before)


def test_the_wheel_zooms_where_the_mouse_is(tab: Any) -> None:
    box = tab.locator("#map").bounding_box()
    before = view(tab)
    tab.mouse.move(box["x"] + 200, box["y"] + 200)
    tab.mouse.wheel(0, -400)
    after = view(tab)
    assert after[2] > 1.5 * before[2]
    assert after[:2] == pytest.approx(before[:2], abs=0.02), "what was under the mouse still is"


def test_two_fingers_zoom(browser: Any, flown: Flown) -> None:
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    with looking(browser, flown.page.command_address, **phone) as tab:
        tab.wait_for_function(LIVE)
        before = view(tab)
        x, y = middle(tab)
        wire = tab.context.new_cdp_session(tab)

        def touch(kind: str, apart: float | None) -> None:
            points = (
                []
                if apart is None
                else [{"x": x + s * apart, "y": y, "id": k} for k, s in enumerate((-1, 1))]
            )
            wire.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        touch("touchStart", 30)
        for apart in (40, 60, 90):
            touch("touchMove", apart)
        touch("touchEnd", None)
        assert view(tab)[2] == pytest.approx(3.0 * before[2], rel=0.15)


def test_keys_move_and_zoom_and_do_not_hold(tab: Any, flown: Flown) -> None:
    before = view(tab)
    tab.focus("#map")
    tab.keyboard.press("ArrowRight")
    tab.keyboard.press("+")
    after = view(tab)
    assert after[2] > before[2] and after[0] > before[0]
    tab.keyboard.press("0")
    assert view(tab) == pytest.approx(before)
    assert not flown.operated


def test_a_distance_is_measured(tab: Any) -> None:
    tab.click("#measure")
    box = tab.locator("#map").bounding_box()
    scale = view(tab)[2]
    tab.mouse.click(box["x"] + 150, box["y"] + 200)
    tab.mouse.click(box["x"] + 250, box["y"] + 200)
    words = tab.evaluate("import('./measure.js').then((m) => m.said(...m.measure.points))")
    assert words == f"{100 / scale:.1f} m, 090°"
    tab.keyboard.press("Escape")
    assert tab.get_attribute("#measure", "aria-pressed") == "false"


def test_a_tap_on_a_source_says_how_sure_it_is(tab: Any, flown: Flown) -> None:
    shown(flown, [candidate(7, 6.0, 5.0, 0.97, "found")])
    tab.wait_for_function("() => window.fieldkit.frame.sources.length === 1")
    x, y = tab.evaluate("import('./mapview.js').then((m) => m.toPixels([6, 5]))")
    box = tab.locator("#map").bounding_box()
    tab.mouse.click(box["x"] + x, box["y"] + y)
    tab.wait_for_selector("#where >> text=Source 7: found, within 0.4 m, 90 % sure")


def test_candidates_at_one_place_are_one_mark(tab: Any) -> None:
    places = [(1, "candidate", 0.2, 1, 1), (2, "candidate", 0.5, 1.1, 1), (3, "candidate", 0.1, 5, 1)]
    places += [(4, "found", 0.9, 1, 1.1), (5, "found", 0.9, 1, 1.2)]
    sources = [dict(zip(("ident", "state", "p", "east_m", "north_m"), each, strict=True)) for each in places]
    groups = tab.evaluate(
        """(sources) => import('./labels.js').then((m) => m.grouped(sources, ([e, n]) => [50 * e, 50 * n], 16)
            .map((group) => [group.source.ident, group.also.map((each) => each.ident)]))""",
        sources,
    )
    assert {ident: set(also) for ident, also in groups} == {4: {2, 1}, 5: set(), 3: set()}, (
        "finds are never hidden"
    )


def test_words_do_not_lie_over_each_other(tab: Any) -> None:
    boxes = tab.evaluate(
        """import('./labels.js').then((m) => {
            const places = new m.Places(400, 400);
            return Array.from({length: 12}, (_, k) => places.place(200 + 3 * k, 200 + 2 * k, 60, 14))
                .map(({left, top, free}) => [left, top, free]); })"""
    )
    free = [(left, top) for left, top, is_free in boxes if is_free]
    assert len(free) >= 4
    for k, (left, top) in enumerate(free):
        assert 0 <= left <= 340 and 0 <= top <= 386
        assert all(abs(left - x) >= 60 or abs(top - y) >= 14 for x, y in free[:k])


def test_a_robot_is_followed_by_its_name_and_its_card_shown_by_a_tap(tab: Any, flown: Flown) -> None:
    tab.locator(".card[data-robot=r2] .name").click()
    assert tab.evaluate("import('./mapview.js').then((m) => m.looking.following)") == "r2"
    box = tab.locator("#map").bounding_box()
    seen = """() => Promise.all([import('./mapview.js'), import('./model.js')]).then(([view, { model }]) => {
        const robot = model.frame.robots.find((each) => each.name === 'r2');
        return view.toPixels([robot.east_m, robot.north_m]); })"""
    for _ in range(20):  # it drives on meanwhile
        x, y = tab.evaluate(seen)
        tab.mouse.click(box["x"] + x, box["y"] + y)
        if tab.locator(".card[data-robot=r2].marked").count():
            break
    else:
        raise AssertionError("no tap on the robot showed its card")
    assert abs(x - box["width"] / 2) < 90 and abs(y - box["height"] / 2) < 90


def test_one_looks_back_and_returns_to_now(tab: Any, flown: Flown) -> None:
    wait_until(lambda: flown.runner.kernel.elapsed_s(flown.runner.setup.clock.now_ns()) > 30.0)
    tab.locator("#back").fill("10")
    tab.wait_for_function("() => window.fieldkit.past && window.fieldkit.past.frame.t_s <= 10")
    tab.wait_for_selector("#back-time >> text=ago")
    tab.wait_for_function("() => window.fieldkit.frame.t_s > window.fieldkit.past.frame.t_s + 15")
    tab.click("#now")
    tab.wait_for_function("() => window.fieldkit.past === null")
    tab.wait_for_function("() => document.getElementById('back-time').textContent === 'now'")


def test_holds_and_the_operators_acts_are_marked_in_time(tab: Any) -> None:
    tab.locator("#hold-all").dispatch_event("pointerdown")
    tab.wait_for_selector("#marks .asked", state="attached")


def test_what_is_old_is_covered_by_its_age(tab: Any, flown: Flown) -> None:
    tab.evaluate(
        """() => Object.defineProperty(window.fieldkit, 'heardAt',
            { get: () => performance.now() - 7000, set() {} })"""
    )
    tab.wait_for_selector("#stale >> text=NOT THE PRESENT")
    assert tab.locator("#hold-all").is_enabled(), "stopping may still get through"


def test_after_the_end_nothing_can_be_pressed(tab: Any, flown: Flown) -> None:
    button = tab.locator("[data-all=end]")
    button.click()
    button.click()
    tab.wait_for_function("() => document.getElementById('state').textContent.startsWith('ended')")
    tab.wait_for_function("() => document.getElementById('hold-all').disabled")


def test_who_looks_and_who_commands_is_said(browser: Any, tab: Any, flown: Flown) -> None:
    with looking(browser, flown.page.address) as other:
        other.wait_for_selector("#robots .card")
        tab.wait_for_selector("#viewers >> text=2 look, 1 may command")
    tab.wait_for_function("() => document.getElementById('viewers').textContent === ''")
    assert json.loads(tab.evaluate("JSON.stringify(window.fieldkit.frame.commanders)")) == 1
