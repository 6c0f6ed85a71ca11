"""The page without a browser: what is kept for a slow one, what is built up from the stream, who may ask."""

import base64
import json
import re
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
from mission.page.commands import Look, Seek, checked_command
from mission.page.disk import DiskWords
from mission.page.exposure import Exposure
from mission.page.grids import grid
from mission.page.live import PAST_EVERY_S, LiveShow
from mission.page.server import (
    MOST_VIEWERS,
    NEWS_WAITING,
    Mailbox,
    Page,
    is_known_host,
    is_own_origin,
    own_address,
)
from mission.page.view import View, thin

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
    assert robot["radio_why"] == "unplugged"
    view.event(7, 3 * S, ReceiverState(3 * S, "r1", True, "plugged in"))
    assert view.frame()["robots"][0]["radio_why"] == ""
    view.event(7, 3 * S, Operator(3 * S, "resume", "r1"))
    assert view.frame()["robots"][0]["call"] == ""
    assert view.frame()["robots"][1]["east_m"] is None


def test_ticks_in_quick_succession_make_no_more_than_a_few_frames_a_second(tmp_path: Path) -> None:
    class Looked:
        clients = 1
        commanders = 0
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


def test_idle_viewers_do_not_lock_the_operator_out(tmp_path: Path) -> None:
    from contextlib import ExitStack

    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    show = LiveShow(View(small_mission(tmp_path)))
    done: list[str] = []
    with Page(show, lambda command: done.append(command["action"]) or "") as page, ExitStack() as open_ones:
        show.page = page
        address = page.address.replace("http", "ws") + "live"
        idle = [open_ones.enter_context(connect(address)) for _ in range(MOST_VIEWERS)]
        operator = open_ones.enter_context(connect(address))
        operator.send(json.dumps({"kind": "token", "token": page.token}))
        for _ in range(20):  # more come, and the operator stays
            open_ones.enter_context(connect(address))
        operator.send(json.dumps({"kind": "command", "number": 1, "action": "hold"}))
        answers = iter(lambda: json.loads(operator.recv(timeout=10)), None)
        assert next(each for each in answers if each["kind"] == "answer")["ok"]
        assert done == ["hold"] and page.commanders == 1 and page.clients <= MOST_VIEWERS + 1
        with pytest.raises(ConnectionClosed):
            while True:
                idle[0].recv(timeout=10)


def test_one_looks_back_at_a_mission_under_way(tmp_path: Path) -> None:
    show = LiveShow(View(small_mission(tmp_path)))
    for second in range(60):
        show.event(2 * second, second * S, Pose(second * S, "r1", 0.1 * second, 4.0, 0.0, 90.0))
        show.event(2 * second + 1, second * S, Tick(second * S))
    mailbox = Mailbox()
    for asked_s, most_s in ((20.0, 20.0), (-5.0, 1.0), (1e300, 60.0)):
        show.asked(mailbox, Look(kind="look", t_s=asked_s))
        past = json.loads(mailbox._newest["past"])
        assert past["kind"] == "past" and most_s - PAST_EVERY_S <= past["frame"]["t_s"] <= most_s
    show.asked(mailbox, Seek(kind="seek", t_s=3.0))
    assert list(mailbox._newest) == ["past"]


def test_the_code_for_a_phone_is_the_address(capsys: pytest.CaptureFixture[str]) -> None:
    cv2 = pytest.importorskip("cv2", reason="pip install .[dev]")
    from mission.cli.options import print_code

    print_code("http://192.0.2.7:8321/#abcDEF123")
    rows = capsys.readouterr().err.splitlines()
    halves = {"█": (0, 0), " ": (1, 1), "▀": (0, 1), "▄": (1, 0)}
    cells = [[halves[c] for c in row if c in halves] for row in map(strip_colours, rows) if row]
    picture = np.array([[each[half] for each in row] for row in cells for half in (0, 1)], np.uint8)
    said, *_ = cv2.QRCodeDetector().detectAndDecode(np.kron(picture * 255, np.ones((8, 8), np.uint8)))
    if not said:  # printed light on dark, or dark on light
        said, *_ = cv2.QRCodeDetector().detectAndDecode(
            np.kron(255 - picture * 255, np.ones((8, 8), np.uint8))
        )
    assert said == "http://192.0.2.7:8321/#abcDEF123"


def strip_colours(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def test_the_page_says_how_large_the_recording_is_and_when_the_disk_fills(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from collections import namedtuple

    path = tmp_path / "mission.mcap"
    path.write_bytes(b"x" * 12_345)
    room = namedtuple("room", "free")
    monkeypatch.setattr("mission.page.disk.shutil.disk_usage", lambda _: room(34.2e9))
    words = DiskWords(path)
    assert words.now() == "recording, 12 kB; 34 GB left"
    monkeypatch.setattr("mission.page.disk.shutil.disk_usage", lambda _: room(1.2e9))
    assert words.now() == "recording, 12 kB; 34 GB left", "a disk is not asked each time"
    assert DiskWords(path).now() == "DISK NEARLY FULL: 1.2 GB left"
    path.unlink()
    assert "cannot be seen" in DiskWords(path).now()


def test_where_nothing_is_known_the_map_is_dark_and_a_peak_is_bright() -> None:
    def shown(values: np.ndarray) -> np.ndarray:
        return np.frombuffer(base64.b64decode(grid("belief", values, 1.0)["data"]), dtype=np.uint8)

    unknown = np.full((20, 20), 0.0016)
    assert shown(unknown).max() < 100
    unknown[3, 4] = 0.03
    assert shown(unknown).max() == 255
