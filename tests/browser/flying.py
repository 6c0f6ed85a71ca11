"""A real browser (Debian's chromium, or whatever is called so) and a mission behind the page."""

import asyncio
import contextlib
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from fieldkit.clock import ScaledClock, wall_sleep
from fieldkit.messages import Event, Operator
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from mission.lab.synthetic import small_mission
from mission.page import serve
from mission.page.server import Page
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places

CLOCK_RATE = 5.0
"""So much faster than the wall's clock missions fly here."""
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


def wait_until(condition: Callable[[], object], timeout_s: float = 30.0) -> None:
    for _ in range(int(timeout_s / 0.02)):
        if condition():
            return
        wall_sleep(0.02)
    raise AssertionError(f"did not happen within {timeout_s:g} s")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Not for the whole session: while it is open, this thread has an event loop that runs."""
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine: apt-get install chromium")
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="playwright is not installed: pip install .[dev]"
    )
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"]
        )
        yield chromium
        chromium.close()


@dataclass
class Flown:
    """A mission that runs in a thread, with its page."""

    page: Page
    runner: Runner
    fleet: FakeFleet
    receivers: dict[str, FakeReceiver]
    operated: list[Operator]

    def asked(self, action: str, robot: str | None = None) -> bool:
        return any(event.action == action and event.robot == robot for event in self.operated)


@contextmanager
def flying(folder: Path, on_foot: frozenset[str] = frozenset()) -> Iterator[Flown]:
    """A mission of four stand-in robots, some of them people, that lasts until it is ended."""
    mission = small_mission(folder, duration_s=100_000.0)
    patient_s = CLOCK_RATE * mission.safety.pose_timeout_s  # as long on the wall's clock as in a mission
    mission = replace(mission, safety=replace(mission.safety, on_foot=on_foot, pose_timeout_s=patient_s))
    clock = ScaledClock(CLOCK_RATE)
    fleet = FakeFleet({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
    receivers = {name: FakeReceiver(name, clock) for name in mission.kernel.engine.robots}
    setup = Setup(clock, tuple(receivers.values()), (fleet,))
    operated: list[Operator] = []
    made: list[Any] = []

    class Watcher(RecordingWriter):
        def event(self, inbox_number: int, log_time_ns: int, event: Event) -> None:
            super().event(inbox_number, log_time_ns, event)
            if isinstance(event, Operator):
                operated.append(event)

    def fly(shown: serve.LivePage) -> None:
        async def run() -> None:
            runner = Runner(mission, setup, recorder, followers=(shown.follower,))
            shown.attach(runner)
            made.append((runner, asyncio.get_running_loop()))
            await runner.run()

        with Watcher(folder / "mission.mcap", mission_toml=mission.text) as recorder:
            asyncio.run(run())

    with serve.live(mission) as shown:
        thread = threading.Thread(target=fly, args=(shown,), daemon=True)
        thread.start()
        wait_until(lambda: made and made[0][0].kernel.started_ns is not None)
        runner, loop = made[0]
        yield Flown(shown.page, runner, fleet, receivers, operated)
        with contextlib.suppress(RuntimeError):  # the test has ended the mission itself: its loop is closed
            loop.call_soon_threadsafe(runner.put, Operator(clock.now_ns(), "end"))
        thread.join(120.0)
        assert not thread.is_alive()


@pytest.fixture
def flown(tmp_path: Path) -> Iterator[Flown]:
    with flying(tmp_path) as running:
        yield running


@pytest.fixture
def walking(tmp_path: Path) -> Iterator[Flown]:
    """The same with r1 on foot."""
    with flying(tmp_path, frozenset({"r1"})) as running:
        yield running


@contextmanager
def looking(browser: Any, address: str, *, is_refused: bool = False, **options: Any) -> Iterator[Any]:
    """A tab on the page that fails on script errors and on anything fetched from elsewhere.

    `is_refused`: the server will say no, which browsers note as an error.
    """
    context = browser.new_context(**({"viewport": {"width": 1440, "height": 860}} | options))
    tab = context.new_page()
    tab.set_default_timeout(30_000)
    faults: list[str] = []
    tab.on("pageerror", lambda error: faults.append(str(error)))
    tab.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    own = f"http://{urlsplit(address).hostname}:"  # also on another port: a recording's page has its own
    tab.on(
        "request",
        lambda request: (
            None
            if request.url.startswith((own, own.replace("http", "ws"), "data:"))
            else faults.append(f"fetched {request.url}")
        ),
    )
    tab.goto(address)
    yield tab
    context.close()
    if is_refused:
        faults = [each for each in faults if not each.startswith("Failed to load resource")]
    assert not faults, faults


WCAG = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]}}


def found_wrong(tab: Any) -> list[str]:
    """What axe-core finds wrong by WCAG 2.2 AA."""
    from axe_playwright_python.sync_playwright import Axe

    report = Axe().run(tab, options=WCAG).response
    return [
        f"{each['impact']}: {each['id']}: {node['html'][:120]} {node['failureSummary'][:200]}"
        for each in report["violations"]
        for node in each["nodes"]
    ]
