"""What server and browser say to each other is what the types say, of a mission, a walk, a recording and a draft."""

import json
import re
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict
from websockets.sync.client import connect

from drivers import inventory
from drivers.mavlink.vehicle import Vehicle
from fieldkit.checks import Check, worst
from fieldkit.messages import Operator
from fieldkit.recording.reader import Recording, open_recording
from mission.core.mission_file import read_mission
from mission.lab import page_types
from mission.lab.synthetic import record_simulated
from mission.maps.background import Background, Picture
from mission.page import embed, serve
from mission.page.commands import Look, Pause, Play, Seek, number_of, question_of, token_of
from mission.page.disk import DiskWords
from mission.page.live import LiveShow
from mission.page.past import PastShow, _apply, _stream
from mission.page.protocol import FittedBearing, Recorded, Runs, Sent, Where
from mission.page.server import STATIC, Mailbox, Page
from mission.page.shelf import shelf
from mission.page.view import View
from mission.plan.desk import Desk
from mission.plan.protocol import Draft, HeardVehicle, Port, Preflight

S = 1_000_000_000


@cache
def reader(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind | None, config=page_types.STRICT)


def read(kind: Any, plain: Any) -> Any:
    """What it is; raises `ValidationError` where it is not of this kind, to the last field."""
    text = plain if isinstance(plain, str) else json.dumps(plain)
    return reader(kind).validate_json(text, strict=True)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return open_recording(record_simulated(tmp_path_factory.mktemp("flown"), duration_s=60.0))


def test_the_types_of_the_pages_javascript_are_those_of_the_models() -> None:
    assert page_types.PATH.read_text(encoding="utf-8") == page_types.declarations(), "make protocol"


def test_a_message_with_a_field_too_many_or_too_few_is_none() -> None:
    rights = {"kind": "rights", "may_command": True, "wrong_token": False}
    assert read(Sent, rights) == rights
    for wrong in (rights | {"more": 1}, {"kind": "rights"}, rights | {"may_command": 1}, {"kind": "left"}):
        with pytest.raises(ValidationError):
            read(Sent, wrong)
    point = {"kind": "news", "point": {"t_s": 1.0, "left": float("nan"), "p": {}}}
    with pytest.raises(ValidationError):
        read(Sent, point)


class Listening:
    """A page with one viewer, in place of the server."""

    clients, commanders = 1, 1

    def call(self, action: Any) -> None:
        action()


class All(Mailbox):
    """Keeps everything."""

    def __init__(self) -> None:
        super().__init__()
        self.texts: list[str] = []

    def put(self, slot: str, text: str) -> None:
        self.texts.append(text)

    def add(self, text: str) -> None:
        self.texts.append(text)


@pytest.mark.parametrize("on_foot", [(), ("r1", "r2")])
def test_whatever_a_mission_under_way_sends_is_of_a_kind(
    recording: Recording, on_foot: tuple[str, ...]
) -> None:
    mission = read_mission(Path(recording.path).parent / "mission.toml")
    view = View(
        replace(mission, safety=replace(mission.safety, on_foot=frozenset(on_foot))), alarms=lambda: ["r1!"]
    )
    corners = ((0.0, 10.0), (10.0, 10.0), (0.0, 0.0))
    view.background = Background((Picture("a", "image/png", b"", corners),), "us", 1.0).described()
    show, mailbox = LiveShow(view), All()
    show.page, show.disk = Listening(), DiskWords(Path(recording.path))  # type: ignore[assignment]
    show.open(mailbox)
    for item in _stream(recording):
        _apply(show, item)  # type: ignore[arg-type]
    for act in (
        Operator(S, "mark", "r1"),
        Operator(S, "exclude", area_m=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))),
    ):
        show.event(0, S, act)
    show.flush()
    show.asked(mailbox, Look(kind="look", t_s=20.0))
    said = [read(Sent, text) for text in mailbox.texts]
    assert {each["kind"] for each in said} == {"hello", "frame", "grid", "history", "news", "past"}
    assert {key for each in said if each["kind"] == "news" for key in each} == {
        "kind",
        "detection",
        "note",
        "point",
    }
    last = [each for each in said if each["kind"] == "frame"][-1]
    assert last["sources"] and last["marks"] and last["areas_m"] and last["recording"] and last["alarms"]
    assert any(robot["path_m"] for each in said if each["kind"] == "frame" for robot in each["robots"])
    assert [each["name"] for each in said[0]["robots"] if each["on_foot"]] == list(on_foot)


def test_whatever_a_recording_sends_is_of_a_kind(recording: Recording) -> None:
    show, mailbox = PastShow(recording), All()
    show.open(mailbox)
    show.asked(mailbox, Seek(kind="seek", t_s=20.0))
    show._go_on(mailbox, show.duration_s)
    said = [read(Sent, text) for text in mailbox.texts]
    assert {each["kind"] for each in said} == {"hello", "frame", "grid", "history", "news"}
    show.close(mailbox)
    assert read(Recorded, json.dumps(embed._data(recording)))["frames"]


@pytest.fixture(scope="module")
def page(recording: Recording) -> Iterator[Page]:
    with serve.past(recording) as page:
        yield page


def test_answers_to_tokens_and_commands_are_of_a_kind(recording: Recording) -> None:
    def refused(command: dict[str, Any]) -> str:
        return "no"

    with (
        Page(PastShow(recording), refused) as page,
        connect(page.address.replace("http", "ws") + "live") as browser,
    ):
        assert read(Sent, browser.recv(timeout=10))["kind"] == "hello"
        browser.send(json.dumps({"kind": "token", "token": page.token}))
        assert read(Sent, browser.recv(timeout=10))["may_command"]
        browser.send(json.dumps({"kind": "command", "action": "hold"}))
        answer = read(Sent, browser.recv(timeout=10))
        assert answer == {"kind": "answer", "number": None, "ok": False, "text": "no"}


def test_places_and_bearings_are_answered_as_stated(page: Page) -> None:
    def asked(path: str) -> str:
        with urlopen(f"{page.address}{path}", timeout=30) as answer:
            return str(answer.read().decode())

    assert read(Where, asked("where?east_m=1&north_m=2"))["mgrs"]
    turn = ",".join(
        f"{heading}:{-60 if heading < 90 or heading > 270 else -80}" for heading in range(0, 360, 10)
    )
    assert read(FittedBearing, asked(f"bearing?heard={turn}"))["bearing_deg"] is not None
    assert read(FittedBearing, asked("bearing?heard=1:-60"))["bearing_deg"] is None


def test_a_folder_of_recordings_is_listed_as_stated(recording: Recording) -> None:
    folder = Path(recording.path).parent
    (folder / "broken.mcap").write_bytes(b"no recording")
    with shelf(folder, serve.past) as page, urlopen(f"{page.address}runs/list", timeout=30) as answer:
        runs = read(Runs, answer.read().decode())["runs"]
    assert {each["name"] for each in runs} == {"mission.mcap", "broken.mcap"}
    (folder / "broken.mcap").unlink()


def test_whatever_the_editor_is_answered_is_of_a_kind(recording: Recording) -> None:
    desk = Desk(Path(recording.path).parent / "mission.toml")
    draft = read(Draft, desk.state() | {"choices": desk.choices()})
    draft["form"]["robots"][0]["was"] = "r9"
    draft["form"]["field"]["size_east_m"] = -1.0
    desk.change(draft["form"])
    assert read(Draft, desk.state())["remarks"]
    assert read(
        list[Port], inventory.as_json([inventory.Found("/dev/ttyUSB0", "an XBee", ["x"], {"CH": "C"})])
    )
    assert read(list[HeardVehicle], [inventory._summary(Vehicle("system 1", 1, inventory.NOWHERE))])
    checks = [Check("r1", "battery", "amber", "30 %", "charge it")]
    assert read(Preflight, {"verdict": worst(checks), "checks": [asdict(each) for each in checks]})


def test_questions_are_read_or_are_none() -> None:
    assert question_of({"kind": "look", "t_s": 3}) == Look(kind="look", t_s=3.0)
    assert question_of({"kind": "seek", "t_s": -1.5, "more": 1}) == Seek(kind="seek", t_s=-1.5)
    assert question_of({"kind": "play", "rate": 30}) == Play(kind="play", rate=30.0)
    assert question_of({"kind": "pause"}) == Pause(kind="pause")
    nan, endless = float("nan"), float("inf")
    for t_s in (None, nan, endless, -endless, "soon", [3], 10**400):
        assert question_of({"kind": "seek", "t_s": t_s}) is None
    for kind in ("token", "command", "dance", "", None, ["seek"], {}):
        assert question_of({"kind": kind, "t_s": 1}) is None
    assert question_of({}) is question_of({"kind": "play"}) is None


def test_a_token_or_a_number_of_another_kind_is_none() -> None:
    assert token_of({"kind": "token", "token": "abc"}) == "abc"
    for token in (None, 7, True, ["abc"], {}):
        assert token_of({"kind": "token", "token": token}) == ""
    assert number_of({"kind": "command", "number": 7}) == 7
    for number in (None, "7", 7.5, True, [7]):
        assert number_of({"kind": "command", "number": number}) is None


class Odd(TypedDict):
    """Said of all of it."""

    pairs: list[tuple[int, str | None]]
    """One a line."""
    free: dict[str, Any]


def test_schemas_become_types() -> None:
    shape = TypeAdapter(Odd | None, config=page_types.STRICT).json_schema()["$defs"]["Odd"]
    assert list(page_types._interface("Odd", shape)) == [
        "/** Said of all of it. */",
        "export interface Odd {",
        "  /** One a line. */",
        "  pairs: [number, string | null][];",
        "  free: { [key: string]: unknown };",
        "}",
    ]


@pytest.mark.parametrize("name", ["page", "plan", "runs"])
def test_elements_that_a_page_looks_for_are_in_it(name: str) -> None:
    """`$` throws at an element that is not there; this says so before."""
    there = set(re.findall(r'\bid="([\w-]+)"', (STATIC / f"{name}.html").read_text(encoding="utf-8")))
    modules, waiting = set[str](), {"main" if name == "page" else name}
    while waiting:
        modules |= waiting
        sources = [(STATIC / f"{name}.js").read_text(encoding="utf-8") for name in modules]
        imported = {
            found for source in sources for found in re.findall(r'^import .*"\./([\w-]+)\.js"', source, re.M)
        }
        waiting = imported - modules
    wanted = {found for source in sources for found in re.findall(r'\$\("([\w-]+)"', source)}
    assert len(wanted) > 4 and wanted <= there
