"""The page in the hand of somebody who walks: where to go, how strong it is, a tone after a tap, their own word."""

import math
import re
from collections.abc import Iterator
from typing import Any

import pytest
from flying import Flown, looking, wait_until

from mission.page import serve

PHONE = {"width": 390, "height": 844}


@pytest.fixture
def tab(browser: Any, walking: Flown) -> Iterator[Any]:
    with looking(browser, walking.page.command_address) as tab:
        tab.set_viewport_size(PHONE)
        tab.wait_for_selector("#walk:not([hidden])")
        yield tab


def test_the_arrow_points_to_the_advice_as_seen_by_whoever_walks(tab: Any, walking: Flown) -> None:
    tab.wait_for_function("() => / m, /.test(document.getElementById('walk-go').textContent)")
    told = tab.evaluate(
        """async () => {
          const { turn, trend } = await import("/walk.js");
          return [turn(0, 0), turn(90, 0), turn(270, 0), turn(180, 0), turn(40, 0), turn(5, 350),
            trend([-90, -90, -80, -80]), trend([-80, -80, -90, -90]), trend([-80, -81, -80, -81]), trend([-80])];
        }"""
    )
    assert told == [
        "straight on", "right", "left", "turn round", "half right", "straight on", "warmer", "colder", "steady", "",
    ]  # fmt: skip


def test_what_is_heard_shows_as_it_is_now_and_at_its_strongest(tab: Any, walking: Flown) -> None:
    for dbm in (-80.0, -62.0, -70.0):
        walking.receivers["r1"].hear(dbm)
        tab.wait_for_function(f"() => document.getElementById('walk-now').textContent === '{dbm:.0f} dBm'")
    assert tab.inner_text("#walk-peak") == "-62 dBm"


def test_sound_is_off_until_it_is_asked_for(tab: Any, walking: Flown) -> None:
    button = tab.locator("#walk-sound")
    assert button.inner_text() == "Sound on" and button.get_attribute("aria-pressed") == "false"
    button.click()
    assert button.inner_text() == "Sound off" and button.get_attribute("aria-pressed") == "true"
    walking.receivers["r1"].hear(-60.0)
    tab.wait_for_function("() => document.getElementById('walk-now').textContent === '-60 dBm'")
    button.click()
    assert button.inner_text() == "Sound on"


def test_found_here_is_asked_twice_and_recorded_as_a_persons_word(tab: Any, walking: Flown) -> None:
    mark = tab.locator("#walk-mark")
    mark.click()
    assert not walking.asked("mark", "r1"), "asked twice"
    mark.click()
    wait_until(lambda: walking.asked("mark", "r1"))
    tab.wait_for_function("() => window.fieldkit.frame.marks.length === 1")
    assert not [s for s in walking.runner.kernel.sources() if s.state == "found"]


def test_a_turn_without_readings_claims_no_bearing_and_one_with_them_is_fitted(
    tab: Any, walking: Flown
) -> None:
    button = tab.locator("#walk-turn")
    button.click()
    assert "Turn once round" in tab.inner_text("#walk-bearing")
    button.click()
    assert "nothing was heard" in tab.inner_text("#walk-bearing")
    said = tab.evaluate(
        """async () => {
          const { bearingWords } = await import("/turn.js");
          const level = (h) => Math.round(-70 + 6 * Math.cos(((h - 120) * Math.PI) / 180));
          const heard = [...Array(18).keys()].map((k) => `${20 * k}:${level(20 * k)}`).join(",");
          return bearingWords(await (await fetch(`bearing?heard=${heard}`)).json());
        }"""
    )
    assert said.startswith("Bearing 12") or said.startswith("Bearing 11"), said


def turn_round(tab: Any, walking: Flown) -> None:
    """Twelve readings over a whole turn, the strongest at 120 degrees, and the fitted bearing in words."""
    tab.locator("#walk-turn").click()
    for number in range(12):
        heading = 30.0 * number
        tab.evaluate(
            """(deg) => {
              const turned = new Event("deviceorientationabsolute");
              turned.alpha = (360 - deg) % 360;
              dispatchEvent(turned);
            }""",
            heading,
        )
        walking.receivers["r1"].hear(round(-70.0 + 6.0 * math.cos(math.radians(heading - 120.0))))
        tab.wait_for_function(
            f"() => document.getElementById('walk-bearing').textContent.includes('heard {number + 1} times')"
        )
    tab.locator("#walk-turn").click()
    tab.wait_for_function("() => document.getElementById('walk-bearing').textContent.startsWith('Bearing 1')")


def test_a_bearing_from_a_whole_turn_is_recorded_as_a_persons_word(tab: Any, walking: Flown) -> None:
    turn_round(tab, walking)
    wait_until(lambda: walking.asked("bearing", "r1"))
    (taken,) = [event for event in walking.operated if event.action == "bearing"]
    bearing_deg, off_deg = map(
        float, re.findall(r"\d+", taken.reason)[:2]
    )  # few readings a turn on a busy machine
    assert abs(bearing_deg - 120.0) <= max(off_deg, 1.0), taken.reason


def test_a_bearing_that_is_refused_goes_with_one_more_press(
    tab: Any, walking: Flown, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patched:
        patched.setattr(serve, "_why_nowhere", lambda runner, robot: "its last position is 9 s old")
        turn_round(tab, walking)
        tab.wait_for_function(
            "() => document.getElementById('walk-turn').textContent === 'Send the bearing again'"
        )
        assert "9 s old" in tab.inner_text("#notice") and not walking.asked("bearing", "r1")
    tab.locator("#walk-turn").click()
    wait_until(lambda: walking.asked("bearing", "r1"))
    tab.wait_for_function("() => document.getElementById('notice').hidden")
    assert tab.inner_text("#walk-turn") == "Turn for a bearing"


def test_one_hand_reaches_everything_and_nothing_is_cut_off(tab: Any, walking: Flown) -> None:
    for name in ("#walk-sound", "#walk-turn", "#walk-mark", "#hold-all"):
        box = tab.locator(name).bounding_box()
        assert box["height"] >= 40, f"{name} is too low for a thumb"
        assert box["x"] >= 0 and box["x"] + box["width"] <= PHONE["width"]
    assert tab.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), (
        "nothing to scroll sideways"
    )


def test_a_mission_without_people_has_no_such_panel(browser: Any, flown: Flown) -> None:
    with looking(browser, flown.page.command_address) as tab:
        tab.wait_for_selector("#robots .card")
        assert tab.locator("#walk").is_hidden()


def test_why_the_radio_is_down_is_read_where_one_walks(browser: Any, walking: Flown) -> None:
    why = f"its lines are no readings: '{'a' * 60}' does not match the pattern"
    with looking(browser, walking.page.address, viewport={"width": 390, "height": 844}) as tab:
        tab.wait_for_selector("#walk:not([hidden])")
        walking.receivers["r1"].set_up(False, why)
        tab.wait_for_function(
            "() => document.getElementById('walk-why').textContent.startsWith('radio down: its lines')"
        )
        assert tab.inner_text("#walk-now") == "radio down"
        assert tab.evaluate(
            "() => { const why = document.getElementById('walk-why'); return why.scrollWidth <= why.clientWidth; }"
        )
