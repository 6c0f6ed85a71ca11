"""What the live page costs a browser: 16 robots, 64 candidates, ten updates a second, in a real Chromium.

Needs Chromium and playwright (`pip install playwright`). CPU is that of all the browser's processes, as /proc has it.
"""

import os
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.clock import wall_s, wall_sleep
from fieldkit.errors import ConfigError
from fieldkit.messages import Pose, SourceEstimate, Tick, VehicleState
from mission.lab.synthetic import small_mission
from mission.page import serve
from mission.page.server import FILES

ROBOTS, CANDIDATES = 16, 64
UPDATES_HZ = 10.0
SETTLE_S, MEASURE_S = 5.0, 20.0
STEP_NS = 500_000_000
"""Mission time between updates: frames are made no nearer to each other."""
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def page() -> dict[str, Any]:
    """First paint, size of the page's files, share of a core, growth of its memory."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise ConfigError("bench page: needs playwright: pip install playwright") from None
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise ConfigError("bench page: needs chromium on this machine")
    with tempfile.TemporaryDirectory(prefix="fieldkit-") as made:
        mission = small_mission(Path(made), robots=ROBOTS)
        with serve.live(mission) as shown, sync_playwright() as driver:
            over = threading.Event()
            feeding = threading.Thread(target=_feed, args=(shown, over), daemon=True)
            feeding.start()
            browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
            tab = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
            tab.goto(shown.page.address)
            tab.wait_for_function(f"() => window.fieldkit?.frame?.sources.length === {CANDIDATES}")
            paint_ms = tab.evaluate(
                "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"
            )
            wall_sleep(SETTLE_S)
            heap_before = tab.evaluate("performance.memory.usedJSHeapSize")
            version, cpu_s, began_s = tab.evaluate("window.fieldkit.version.side"), _cpu_s(), wall_s()
            wall_sleep(MEASURE_S)
            passed_s = wall_s() - began_s
            updates = tab.evaluate("window.fieldkit.version.side") - version
            used_s = _cpu_s() - cpu_s
            heap_after = tab.evaluate("performance.memory.usedJSHeapSize")
            over.set()
            feeding.join()
            browser.close()
    return {
        "robots": ROBOTS,
        "candidates": CANDIDATES,
        "updates_hz": round(updates / passed_s, 2),
        "browser_share_of_a_core": round(used_s / passed_s, 3),
        "first_paint_ms": None if paint_ms is None else round(paint_ms, 1),
        "files_kb": round(sum(path.stat().st_size for path in FILES.values()) / 1e3, 1),
        "heap_mb": [round(heap / 1e6, 1) for heap in (heap_before, heap_after)],
    }


def _feed(shown: serve.LivePage, over: threading.Event) -> None:
    """A mission's events, without the mission."""
    rng = np.random.default_rng(1)
    robots = shown.follower.view.mission.kernel.engine.robots
    places = rng.uniform(1.0, 9.0, (len(robots), 2))
    number, began_s = 0, wall_s()
    while not over.is_set():
        t_ns = number * STEP_NS
        places = np.clip(places + rng.normal(0.0, 0.1, places.shape), 0.3, 9.7)
        for robot, (east_m, north_m) in zip(robots, places, strict=True):
            shown.follower.event(number, t_ns, Pose(t_ns, robot, east_m, north_m, 0.0, 90.0))
            shown.follower.event(
                number, t_ns, VehicleState(t_ns, robot, "guided", True, True, 80.0, "link up")
            )
        shown.follower.sources(number, t_ns, _candidates(rng))
        shown.follower.event(number, t_ns, Tick(t_ns))
        number += 1
        over.wait(max(0.0, began_s + number / UPDATES_HZ - wall_s()))


def _candidates(rng: np.random.Generator) -> list[SourceEstimate]:
    places = np.random.default_rng(2).uniform(0.5, 9.5, (CANDIDATES, 2))
    sure = rng.uniform(0.1, 0.9, CANDIDATES)
    cov_m2 = np.diag([0.2, 0.1])
    return [
        SourceEstimate(k, east_m, north_m, cov_m2, 30, 2.0, 0.1, 0.8, float(sure[k]), "candidate")
        for k, (east_m, north_m) in enumerate(places)
    ]


def _cpu_s() -> float:
    """CPU seconds of this process's children's trees so far: the browser's."""
    children: dict[int, list[int]] = {}
    spent: dict[int, float] = {}
    tick = os.sysconf("SC_CLK_TCK")
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        children.setdefault(int(fields[1]), []).append(int(folder.name))
        spent[int(folder.name)] = (int(fields[11]) + int(fields[12])) / tick
    todo, total = list(children.get(os.getpid(), [])), 0.0
    while todo:
        one = todo.pop()
        total += spent.get(one, 0.0)
        todo += children.get(one, [])
    return total
