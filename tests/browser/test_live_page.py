"""The live page in a real browser: every command clicked, the belief drawn, and nobody commands without the token."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying import Flown, looking, wait_until

from fieldkit.messages import SourceEstimate
from mission.lab.synthetic import small_mission
from mission.page import serve

LIVE = "() => document.getElementById('state').textContent === 'live'"
COLOURS = """() => {
  const map = document.getElementById('map');
  const data = map.getContext('2d').getImageData(0, 0, map.width, map.height).data;
  const seen = new Set();
  for (let i = 0; i < data.length; i += 4) seen.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]);
  return seen.size;
}"""


@pytest.fixture
def tab(browser: Any, flown: Flown) -> Any:
    with looking(browser, flown.page.command_address) as tab:
        tab.wait_for_function(LIVE)
        tab.wait_for_selector("#robots .card")
        assert not tab.locator("#robots .empty").count(), "what it waited for is there"
        yield tab


def modes(flown: Flown) -> set[str]:
    return set(flown.fleet._mode.values())


def show_sources(flown: Flown) -> None:
    """As if the belief had found something: the page cannot tell."""
    found = SourceEstimate(7, 6.0, 5.0, np.diag([0.09, 0.04]), 4, 5.0, 0.1, 1.0, 0.96, "found")
    candidate = SourceEstimate(8, 2.0, 7.0, np.diag([1.0, 0.5]), 90, 2.0, 0.1, 0.7, 0.3, "candidate")
    flown.runner.kernel.belief.sources = lambda: [found, candidate]  # type: ignore[method-assign]
    flown.runner.kernel._sources = None
    for follower in flown.runner.followers:
        follower.sources(0, flown.runner.setup.clock.now_ns(), [found, candidate])


def test_hold_all_by_button_holds_every_robot_without_asking(tab: Any, flown: Flown) -> None:
    tab.locator("#hold-all").dispatch_event("pointerdown")
    wait_until(lambda: flown.asked("hold") and modes(flown) == {"hold"})
    tab.wait_for_selector("text=operator: hold all")


@pytest.mark.parametrize("key", ["Space", "h"])
def test_hold_all_by_key(tab: Any, flown: Flown, key: str) -> None:
    tab.keyboard.press(key)
    wait_until(lambda: flown.asked("hold") and modes(flown) == {"hold"})


def test_before_the_start_the_page_says_what_it_waits_for(browser: Any, tmp_path: Path) -> None:
    with serve.live(small_mission(tmp_path)) as shown, looking(browser, shown.page.command_address) as tab:
        tab.wait_for_function("() => document.getElementById('state').textContent === 'not started'")
        tab.wait_for_selector("#robots >> text=The mission starts when")
        assert "r1, r2" in tab.locator("#robots .cards").inner_text()
        tab.evaluate("() => { window.fieldkit.heardAt -= 60_000; }")  # it takes a while, and is not lost
        tab.wait_for_timeout(1200)
        assert tab.locator("#state").inner_text() == "not started" and not tab.locator("#stale").is_visible()


def test_before_anything_is_known_pages_of_agents_say_what_those_wait_for(
    browser: Any, tmp_path: Path
) -> None:
    for ends, said in (
        ("agent", "its radio and its vehicle"),
        ("page", "Nothing has been heard of the robots"),
    ):
        with serve.live(small_mission(tmp_path)) as shown:
            shown.ends(ends)  # type: ignore[arg-type]
            with looking(browser, shown.page.command_address) as tab:
                tab.wait_for_selector(f"#robots >> text={said}")


def test_one_robot_is_held_returned_released_and_resumed(tab: Any, flown: Flown) -> None:
    card = tab.locator(".card[data-robot=r2]")
    card.get_by_text("Hold", exact=True).click()
    wait_until(lambda: flown.asked("hold", "r2") and flown.fleet._mode["r2"] == "hold")
    assert not flown.asked("hold"), "the others are not meant"
    card.get_by_text("Resume").click()
    wait_until(lambda: flown.asked("resume", "r2") and flown.fleet._mode["r2"] == "guided")
    card.get_by_text("Return").click()
    wait_until(lambda: flown.asked("return", "r2"))
    release = card.locator("[data-action=release]")
    release.click()
    assert not flown.asked("release", "r2"), "asked twice"
    release.click()
    wait_until(lambda: flown.asked("release", "r2") and flown.fleet._mode["r2"] == "other")
    tab.wait_for_selector(".card[data-robot=r2] >> text=released")


def test_everybody_is_resumed_and_sent_home(tab: Any, flown: Flown) -> None:
    tab.keyboard.press("h")
    wait_until(lambda: modes(flown) == {"hold"})
    for action in ("resume", "return"):
        button = tab.locator(f"[data-all={action}]")
        button.click()
        assert not flown.asked(action)
        button.click()
        wait_until(lambda action=action: flown.asked(action))  # type: ignore[misc]


def test_a_source_is_marked_as_removed(tab: Any, flown: Flown) -> None:
    show_sources(flown)
    button = tab.locator("[data-action=remove][data-source='7']")
    button.click()
    button.click()
    wait_until(lambda: any(event.action == "remove" and event.source == 7 for event in flown.operated))
    wait_until(lambda: 7 in flown.runner.kernel.removed)


def test_an_area_is_drawn_and_closed(tab: Any, flown: Flown) -> None:
    tab.click("#exclude")
    box = tab.locator("#map").bounding_box()
    for x, y in ((0.45, 0.4), (0.6, 0.4), (0.6, 0.6)):
        tab.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
    tab.click("#exclude")
    wait_until(lambda: flown.asked("exclude"))
    area = next(event.area_m for event in flown.operated if event.action == "exclude")
    assert len(area) == 3 and all(0 < value < 10 for corner in area for value in corner)
    wait_until(lambda: area in flown.runner.safety.settings.keep_out.polygons)


def test_the_mission_is_ended(tab: Any, flown: Flown) -> None:
    button = tab.locator("[data-all=end]")
    button.click()
    button.click()
    wait_until(lambda: flown.runner.end_reason)
    assert flown.asked("end") and flown.runner.end_reason == "operator, on the page"
    tab.wait_for_selector("#state >> text=ended")
    for pressed in ("#hold-all", "#commands button", ".card .act"):
        wait_until(lambda pressed=pressed: tab.locator(f"{pressed}:enabled").count() == 0)  # type: ignore[misc]
    assert tab.locator(".card .act:disabled").count() == 16


def test_robots_on_their_way_home_can_be_held_after_the_end(tab: Any, flown: Flown) -> None:
    """Those that fly land before anybody stops steering."""
    landing = flown.runner._landing
    landing.is_over = lambda *_: (False, ["r2"])  # type: ignore[method-assign]
    button = tab.locator("[data-all=end]")
    button.click()
    button.click()
    tab.wait_for_selector("#state >> text=ended")
    tab.wait_for_selector("[data-all=end]:disabled")
    tab.locator(".card[data-robot=r2]").get_by_text("Hold", exact=True).click()
    wait_until(lambda: flown.asked("hold", "r2"))
    tab.locator("#hold-all:enabled").dispatch_event("pointerdown")
    wait_until(lambda: flown.asked("hold") and modes(flown) == {"hold"})
    del landing.is_over


def test_belief_robots_and_sources_are_drawn(tab: Any, flown: Flown) -> None:
    show_sources(flown)
    tab.wait_for_selector("text=6.0 m E, 5.0 m N")
    tab.wait_for_function("() => window.fieldkit.grids.belief && window.fieldkit.grids.exposure")
    tab.wait_for_timeout(300)
    with_belief = tab.evaluate(COLOURS)
    tab.click("#layers >> text=plain")
    tab.wait_for_timeout(300)
    assert with_belief > tab.evaluate(COLOURS) > 10
    assert tab.locator("#found").inner_text() == "1"
    assert tab.locator("#robots .card").count() == 4


def test_what_is_heard_shows_with_its_levels(tab: Any, flown: Flown) -> None:
    flown.receivers["r1"].hear(-61.0)
    wait_until(lambda: flown.runner.kernel.detections, 120.0)  # the first is when loops are compiled
    tab.wait_for_selector("#signals >> text=-61 dBm")


def test_a_trouble_shows_on_the_robots_card(tab: Any, flown: Flown) -> None:
    flown.receivers["r3"].set_up(False, "unplugged")
    tab.wait_for_selector(".card[data-robot=r3] >> text=radio down")


def test_on_a_phone_hold_all_is_in_reach_wherever_one_scrolls(browser: Any, flown: Flown) -> None:
    phone = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    with looking(browser, flown.page.command_address, **phone) as tab:
        tab.wait_for_function(LIVE)
        tab.wait_for_selector("#robots .card")
        tab.evaluate("window.scrollTo(0, document.body.scrollHeight)")
        box = tab.locator("#hold-all").bounding_box()
        assert box["y"] >= 0 and box["y"] + box["height"] <= 844 and box["height"] >= 48
        assert tab.evaluate("document.documentElement.scrollWidth") <= 390, "nothing runs off the side"
        for name in ("sources", "signals", "events", "robots"):
            tab.click(f"#tabs [data-tab={name}]")
            assert tab.locator(f"#{name}").is_visible()
        tab.locator("#hold-all").dispatch_event("pointerdown")
        wait_until(lambda: modes(flown) == {"hold"})


@pytest.mark.parametrize("width", [390, 320])
def test_on_a_phone_nothing_lies_over_hold_all_and_no_button_is_cut_off(
    browser: Any, flown: Flown, width: int
) -> None:
    phone = {"viewport": {"width": width, "height": 700}, "has_touch": True, "is_mobile": True}
    with looking(browser, flown.page.command_address, **phone) as tab:
        tab.wait_for_function(LIVE)
        tab.locator("#hold-all").dispatch_event("pointerdown")
        tab.wait_for_function("() => document.querySelectorAll('.card .mode.hold').length === 4")
        others = tab.evaluate(
            """() => {
                const button = document.getElementById('hold-all'), box = button.getBoundingClientRect();
                const on = (x, y) => document.elementFromPoint(box.x + x * box.width, box.y + y * box.height);
                const places = [0.05, 0.2, 0.5, 0.8, 0.95];
                return places.flatMap((x) => places.map((y) => on(x, y)))
                    .filter((each) => !button.contains(each)).length;
            }"""
        )
        assert others == 0
        rights = tab.evaluate(
            "[...document.querySelectorAll('.card .act')].map((each) => each.getBoundingClientRect().right)"
        )
        assert len(rights) == 16 and max(rights) <= width


# Who may command


def test_without_the_token_one_can_look_but_not_command(browser: Any, flown: Flown) -> None:
    with looking(browser, flown.page.address) as tab:
        tab.wait_for_function("() => document.getElementById('state').textContent === 'live, only looking'")
        tab.wait_for_selector("#robots .card")
        assert tab.locator("#hold-all").is_disabled()
        tab.keyboard.press("Space")
        tab.wait_for_selector("text=Only looking")
        said = tab.evaluate(
            """async () => { const socket = await import('/socket.js'); return socket.command({ action: 'hold' }); }"""
        )
        assert not said["ok"] and "token" in said["text"]
    assert not flown.operated


def test_a_wrong_token_is_said(browser: Any, flown: Flown) -> None:
    with looking(browser, flown.page.address + "#wrong%") as tab:
        tab.wait_for_selector("text=The token is wrong")
        assert tab.locator("#hold-all").is_disabled()


def test_the_token_does_not_stay_in_the_address(tab: Any, flown: Flown) -> None:
    assert flown.page.token not in tab.url


def test_a_foreign_page_cannot_connect(flown: Flown) -> None:
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    address = flown.page.address.replace("http", "ws") + "live"
    with pytest.raises(InvalidStatus):
        connect(address, origin="http://evil.example")  # type: ignore[arg-type]
    with connect(address, origin=flown.page.address.rstrip("/")) as socket:  # type: ignore[arg-type]
        assert json.loads(socket.recv(timeout=10))["kind"] == "hello"


def test_a_name_that_was_made_to_point_here_gets_nothing(flown: Flown) -> None:
    import http.client

    connection = http.client.HTTPConnection("127.0.0.1", flown.page.port)
    connection.request("GET", "/", headers={"Host": "evil.example"})
    assert connection.getresponse().status == 421
    connection.close()
    connection = http.client.HTTPConnection("127.0.0.1", flown.page.port)
    connection.request("GET", "/..%2fserver.py")
    assert connection.getresponse().status == 404
    connection.close()


@pytest.mark.parametrize(
    "message",
    [
        {"action": "fly"},
        {"action": "hold", "robot": 3},
        {"action": "remove", "source": "x"},
        {"action": "exclude", "area_m": [[1, 2], [3, 4]]},
        {"action": "exclude", "area_m": [[1, 2], [3, 4], [float("inf"), 0]]},
        {"action": "withdraw"},
    ],
)
def test_nonsense_is_answered_and_not_passed_on(flown: Flown, message: dict[str, Any]) -> None:
    from websockets.sync.client import connect

    with connect(flown.page.address.replace("http", "ws") + "live") as socket:
        socket.send("not json")
        socket.send(json.dumps({"kind": "token", "token": flown.page.token}))
        socket.send(json.dumps({"kind": "command", "number": 1, **message}))
        answers = iter(lambda: json.loads(socket.recv(timeout=10)), None)
        answer = next(each for each in answers if each["kind"] == "answer")
    assert not answer["ok"] and answer["text"]
    assert not flown.operated


def test_a_port_that_is_taken_is_said(flown: Flown, tmp_path: Path) -> None:
    from fieldkit.errors import ConfigError
    from mission.page.server import Page

    with pytest.raises(ConfigError, match="another --page-port"):
        Page(None, port=flown.page.port)  # type: ignore[arg-type]
