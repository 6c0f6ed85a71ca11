"""Hours of a mission in one browser, a browser that takes nothing, and a recording with its time slider."""

import json
import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flying import looking, wait_until

from fieldkit.messages import Detection, Pose, RssReading, SourceEstimate, Tick, VehicleState
from fieldkit.recording.reader import open_recording
from mission.lab.synthetic import record_simulated, small_mission
from mission.page import serve
from mission.page.live import LiveShow
from mission.page.server import Page
from mission.page.view import View

S = 1_000_000_000
HOURS_S = 3600 * int(os.environ.get("FIELDKIT_HOURS", "1"))
"""Hours of a mission; FIELDKIT_HOURS=8 takes minutes."""
FULL_MINUTE, LAST_MINUTE = 30, HOURS_S // 60
"""When everything that is kept has its full length, and the end."""
BATCH_S = 60


class Feed:
    """A mission that never was: robots that wander, sources that are heard, as fast as the browser takes it."""

    def __init__(self, folder: Path, on_foot: frozenset[str] = frozenset()) -> None:
        mission = small_mission(folder, robots=4)
        mission = replace(mission, safety=replace(mission.safety, on_foot=on_foot))
        self.show = LiveShow(View(mission))
        self.rng = np.random.default_rng(1)
        self.t_s = 0
        self.place = {f"r{k}": np.array([2.0 * k, 1.0]) for k in range(1, 5)}

    def second(self) -> None:
        self.t_s += 1
        t_ns, show = self.t_s * S, self.show
        for name, place in self.place.items():
            place += self.rng.normal(0.0, 0.3, 2)
            np.clip(place, 0.2, 9.8, out=place)
            show.event(0, t_ns, Pose(t_ns, name, float(place[0]), float(place[1])))
            show.event(0, t_ns, VehicleState(t_ns, name, "guided", True, True, 80.0, "on its way"))
            show.event(0, t_ns, RssReading(t_ns, name, float(self.rng.normal(-65.0, 4.0))))
        if self.t_s % 2 == 0:
            places = np.array(list(self.place.values()))
            rss = self.rng.normal(-65.0, 4.0, 4)
            quiet = np.zeros(4, dtype=bool)
            show.detection(0, t_ns, Detection(t_ns, tuple(self.place), places, np.zeros(4), rss, quiet))
            found = SourceEstimate(1, 3.0, 4.0, np.eye(2) * 0.1, 5, 9.0, 0.1, 1.0, 0.9, "found")
            show.sources(0, t_ns, [found])
        if self.t_s % 10 == 0:
            belief = self.rng.random((50, 50))
            show.belief(0, t_ns, belief, cell_m=0.2, numbers={"probability_left": 0.5})
            show.note("info", f"note of second {self.t_s}", t_ns)
        show.event(0, t_ns, Tick(t_ns))


def heap_bytes(tab: Any) -> int:
    session = tab.context.new_cdp_session(tab)
    session.send("HeapProfiler.collectGarbage")
    return int(session.send("Runtime.getHeapUsage")["usedSize"])


@pytest.mark.timeout(600)
@pytest.mark.parametrize("on_foot", [frozenset(), frozenset({"r1"})], ids=["laptop", "phone that is carried"])
def test_hours_of_data_do_not_fill_the_browser(browser: Any, tmp_path: Path, on_foot: frozenset[str]) -> None:
    feed = Feed(tmp_path, on_foot)
    phone = (
        {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True} if on_foot else {}
    )
    with Page(feed.show, lambda _: None) as page:
        feed.show.page = page
        with looking(browser, page.command_address, **phone) as tab:
            wait_until(lambda: page.clients == 1)
            if on_foot:
                feed.second()
                tab.locator("#walk-sound").tap()  # it appears with the first frame
            used = {}
            for minute in range(1, HOURS_S // BATCH_S + 1):
                for _ in range(BATCH_S):
                    feed.second()
                tab.wait_for_function(f"() => window.fieldkit.frame?.t_s >= {feed.t_s - 2}")
                if minute in (FULL_MINUTE, LAST_MINUTE):
                    used[minute] = heap_bytes(tab)
            assert not on_foot or "dBm" in tab.inner_text("#walk-peak")
            sizes = tab.evaluate(
                """() => { const m = window.fieldkit; return {
                  track: Math.max(...Object.values(m.tracks).map((t) => t.length)), series: m.series.length,
                  detections: m.detections.length, notes: m.notes.length,
                  nodes: document.querySelectorAll('*').length }; }"""
            )
    assert sizes["track"] <= 1500 and sizes["series"] <= 600
    assert sizes["detections"] <= 120 and sizes["notes"] <= 250 and sizes["nodes"] < 2000
    assert used[LAST_MINUTE] - used[FULL_MINUTE] < 3_000_000, (
        f"the heap grew from {used[FULL_MINUTE]} to {used[LAST_MINUTE]} bytes"
    )
    track = feed.show.view.tracks["r1"]
    assert len(track) <= 1500 and track[0][0] < 60, "the whole way is still there, thinned"


def test_a_browser_that_reads_nothing_delays_nobody(tmp_path: Path) -> None:
    from websockets.sync.client import connect

    feed = Feed(tmp_path)
    with Page(feed.show) as page:
        feed.show.page = page
        address = page.address.replace("http", "ws") + "live"
        with connect(address, max_queue=1) as dead, connect(address) as alive:
            wait_until(lambda: page.clients == 2)
            newest: list[float] = []

            def read() -> None:
                for text in alive:
                    message = json.loads(text)
                    if message["kind"] == "frame":
                        newest.append(message["t_s"])

            reader = threading.Thread(target=read, daemon=True)
            reader.start()
            for _ in range(1500):
                feed.second()
            wait_until(lambda: newest and newest[-1] >= 1498)
            dead.socket.close()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_simulated(tmp_path_factory.mktemp("log"), duration_s=150.0, sources_found=9)


def test_a_recording_is_shown_at_any_time_and_plays(browser: Any, recorded: Path) -> None:
    recording = open_recording(recorded)
    with serve.past(recording) as page, looking(browser, page.address) as tab:
        tab.wait_for_function("() => window.fieldkit.frame")
        assert tab.locator("#state").inner_text() == "recording"
        assert not tab.locator("#hold-all").is_visible() and not tab.locator("#commands").is_visible()
        whole = len(list(recording.detections()))
        tab.wait_for_function(f"() => document.getElementById('detections').textContent === '{whole}'")
        tab.wait_for_function("() => window.fieldkit.grids.belief")
        tab.locator("#slider").fill("20")
        tab.wait_for_function("() => window.fieldkit.frame.t_s <= 20")
        early = [d for _, _, d in recording.detections() if d.t_ns <= 20 * S]
        assert tab.evaluate("window.fieldkit.detections.length") <= len(early)
        assert tab.evaluate("window.fieldkit.tracks.r1.every((point) => point[0] <= 20)")
        tab.select_option("#rate", "100")
        tab.click("#play")
        tab.wait_for_function("() => window.fieldkit.frame.t_s >= 140")
        # Tracks come once a second of real time, a hundred seconds of the recording at this rate.
        tab.wait_for_function("() => window.fieldkit.tracks.r1.at(-1)[0] > 130")


def test_a_recording_takes_no_commands(recorded: Path) -> None:
    from websockets.sync.client import connect

    with serve.past(open_recording(recorded)) as page:
        with connect(page.address.replace("http", "ws") + "live") as socket:
            socket.send(json.dumps({"kind": "token", "token": page.token}))
            socket.send(json.dumps({"kind": "command", "number": 1, "action": "hold"}))
            answers = iter(lambda: json.loads(socket.recv(timeout=10)), None)
            answer = next(each for each in answers if each["kind"] == "answer")
        assert not answer["ok"]
