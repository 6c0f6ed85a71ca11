"""The page without a browser: what is kept for a slow one, what is built up from the stream, who may ask."""

import socket
from pathlib import Path
from typing import Any, cast
from urllib.parse import urlsplit

import numpy as np
import pytest

from fieldkit.messages import (
    CallOperator,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    SourceEstimate,
    Tick,
    VehicleState,
)
from mission.lab.synthetic import small_mission
from mission.page.commands import checked_command
from mission.page.exposure import Exposure
from mission.page.live import LiveShow
from mission.page.server import NEWS_WAITING, Mailbox, Page, is_known_host, is_own_origin, own_address
from mission.page.view import View, grid, thin

S = 1_000_000_000


async def test_a_browser_that_takes_nothing_keeps_only_the_newest() -> None:
    mailbox = Mailbox()
    for number in range(10_000):
        mailbox.put("frame", f"frame {number}")
        mailbox.put("grid belief", f"grid {number}")
        mailbox.add(f"news {number}")
    assert mailbox.dropped == 2 * 9_999 + 10_000 - NEWS_WAITING
    taken = []
    async for text in mailbox.items():
        taken.append(text)
        if text == "news 9999":
            break
    assert taken[:3] == ["frame 9999", "grid 9999", f"news {10_000 - NEWS_WAITING}"]
    assert len(taken) == NEWS_WAITING + 2


def test_a_frame_says_how_each_robot_is(tmp_path: Path) -> None:
    view = View(small_mission(tmp_path), lambda: {"r1": ("Hold", "no answer")})
    view.event(1, 0, Tick(0))
    view.event(2, 0, Pose(0, "r1", 3.0, 4.0, 0.0, 90.0))
    view.event(3, 0, VehicleState(0, "r1", "hold", True, True, 61.0, "waiting"))
    view.event(4, 0, ReceiverState(0, "r1", False, "unplugged"))
    view.command(5, 0, CallOperator(0, "r1", "stuck"), "safety")
    view.event(6, 3 * S, Tick(3 * S))
    robot = view.frame()["robots"][0]
    assert (robot["east_m"], robot["mode"], robot["battery_pct"], robot["reserve_pct"]) == (
        3.0,
        "hold",
        61.0,
        25.0,
    )
    assert (robot["pose_age_s"], robot["link_age_s"], robot["fence_m"]) == (3.0, 3.0, 3.0)
    assert (robot["radio_up"], robot["call"], robot["answer"]) == (False, "stuck", "no answer")
    view.event(7, 3 * S, Operator(3 * S, "resume", "r1"))
    assert view.frame()["robots"][0]["call"] == ""
    assert view.frame()["robots"][1]["east_m"] is None


def test_ticks_in_quick_succession_make_no_more_than_a_few_frames_a_second(tmp_path: Path) -> None:
    class Looked:
        clients = 1
        calls = 0

        def call(self, action: object) -> None:
            self.calls += 1

    show = LiveShow(View(small_mission(tmp_path)))
    page = show.page = Looked()  # type: ignore[assignment]
    for k in range(1000):
        show.event(k + 1, k * S // 100, Tick(k * S // 100))
    frames = page.calls  # type: ignore[union-attr]
    assert 20 <= frames <= 26
    show.flush()
    assert page.calls == frames + 1, "what matters is shown at once"  # type: ignore[union-attr]


def test_a_hold_that_is_repeated_is_told_once(tmp_path: Path) -> None:
    view = View(small_mission(tmp_path))
    for age_s in (2.5, 5.5, 120.5):
        view.command(1, 0, Hold(0, "r1", f"its position is {age_s} s old (limit 2.0 s)"), "safety")
    view.command(1, 0, Hold(0, "r1", "its radio is down for 10 s"), "safety")
    assert [note["text"].split(" is ")[0] for note in view.notes] == [
        "r1 holds: its position",
        "r1 holds: its radio",
    ]


def test_the_region_of_a_source_holds_90_percent_of_it(tmp_path: Path) -> None:
    cov = np.array([[0.5, 0.3], [0.3, 0.4]])
    view = View(small_mission(tmp_path))
    view.sources(0, 0, [SourceEstimate(1, 0.0, 0.0, cov, 4, 3.0, 0.1, 1.0, 0.9, "found")])
    shown = view.frame()["sources"][0]
    points = np.random.default_rng(1).multivariate_normal((0, 0), cov, 20_000)
    turn = np.radians(shown["turn_deg"])
    along = points @ [np.cos(turn), np.sin(turn)] / shown["half_axes_m"][0]
    across = points @ [-np.sin(turn), np.cos(turn)] / shown["half_axes_m"][1]
    assert np.mean(along**2 + across**2 <= 1.0) == pytest.approx(0.9, abs=0.01)


def test_a_large_grid_is_reduced_to_the_largest_of_each_block() -> None:
    values = np.zeros((300, 400))
    values[299, 0] = 1.0
    sent = grid("belief", values, 0.5)
    assert (sent["n_north"], sent["n_east"], sent["cell_m"]) == (75, 100, 2.0)
    import base64

    cells = np.frombuffer(base64.b64decode(sent["data"]), np.uint8).reshape(75, 100)
    assert cells[74, 0] == 255 and cells.sum() == 255


def test_exposure_is_the_chance_that_a_source_there_was_heard(tmp_path: Path) -> None:
    engine = small_mission(tmp_path).kernel.engine
    exposure = Exposure(engine)
    for second in range(11):
        exposure.listen([(2.0, 2.0)], second * S)
    searched = exposure.searched()
    here = int(2.0 / exposure.cell_m)
    assert searched[here, here] == pytest.approx(1.0 - np.exp(-engine.reference_rate_hz * 10.0))
    assert searched[-1, -1] == 0.0
    exposure.listen([(2.0, 2.0)], 100 * S)
    assert exposure.searched()[here, here] == searched[here, here], "a gap is no listening"


def test_thinning_keeps_the_ends_and_everything_recent() -> None:
    rows = list(range(1601))
    thin(rows, 1600)
    assert len(rows) < 1300 and rows[0] == 0 and rows[-400:] == list(range(1201, 1601))


def test_commands_from_browsers_are_checked() -> None:
    assert checked_command({"action": "hold"}) == {"action": "hold", "robot": None}
    area = checked_command({"action": "exclude", "area_m": [[0, 0], [1, 0], [1, 1]]})
    assert isinstance(area, dict) and area["area_m"] == ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    assert isinstance(checked_command({"action": "withdraw"}), str)


@pytest.mark.parametrize(
    ("host", "shown"),
    [("127.0.0.1", "http://127.0.0.1:"), ("::1", "http://[::1]:"), ("0.0.0.0", f"http://{own_address()}:")],
)
def test_the_address_that_is_printed_is_one_to_open(host: str, shown: str) -> None:
    page = Page(cast(Any, None), host=host)
    try:
        assert page.address.startswith(shown)
        with socket.create_connection((urlsplit(page.address).hostname or "", page.port), timeout=5.0):
            pass
    finally:
        page._socket.close()


def test_only_names_of_this_machine_and_addresses_are_known_hosts() -> None:
    for host in ("127.0.0.1:8321", "localhost:8321", "192.168.1.7:80", "[::1]:8321"):
        assert is_known_host(host, "127.0.0.1")
    own = socket.gethostname()
    for host in (
        own,
        f"{own.upper()}:80",
        f"{own}.local:8321",
    ):  # as phones find a laptop without a name server
        assert is_known_host(host, "0.0.0.0")
    for host in ("evil.example:8321", "", "localhost.evil.example", f"{own}.evil.local"):
        assert not is_known_host(host, "127.0.0.1")
    assert is_own_origin(None, "a:1") and is_own_origin("http://a:1", "a:1")
    assert not is_own_origin("http://b:1", "a:1") and not is_own_origin("null", "a:1")
