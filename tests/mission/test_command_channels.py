"""Whatever comes over the page or the terminal: it is refused aloud or does what it says, and nothing else."""

import asyncio
import json
import logging
import random
import threading
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.sync.client import connect

from fieldkit.messages import Operator
from mission.page.commands import ACTIONS, checked_command, message_of, number_of, question_of, token_of
from mission.page.serve import LivePage
from mission.page.server import Mailbox, Page
from mission.safety.limits import SafetySettings
from mission.shell.keyboard import NotUnderstood, help_of, meaning

ROBOTS = ("r1", "r2", "left rover")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.sampled_from(ACTIONS),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.parametrize(
    ("line", "asked"),
    [
        ("\n", ("hold", None)),
        ("h\n", ("hold", None)),
        ("hold all\n", ("hold", None)),
        ("HOLD ALL\n", ("hold", None)),
        ("stop\n", ("hold", None)),
        ("HALT\n", ("hold", None)),
        ("\x1b[A\x1bOB\x1b[1;5C\x1b\n", ("hold", None)),
        ("hold r2\n", ("hold", "r2")),
        ("stop R2\n", ("hold", "r2")),
        ("hold left rover\n", ("hold", "left rover")),
        ("R\n", ("resume", None)),
        ("resume all\n", ("resume", None)),
        ("home\n", ("return", None)),
        ("end\n", ("end", None)),
    ],
)
def test_the_terminal_understands_few_words_and_enter_holds(line: str, asked: object) -> None:
    assert meaning(line, ROBOTS) == asked


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("dance\n", "Enter: HOLD ALL"),
        ("hold r9\n", "robots are: r1, r2"),
        ("hold r1 r2\n", "robots are: r1, r2"),
        ("end r1\n", "takes no robot"),
    ],
)
def test_the_terminal_refuses_aloud_what_it_does_not_understand(line: str, says: str) -> None:
    with pytest.raises(NotUnderstood, match=says):
        meaning(line, ROBOTS)


@given(st.text())
def test_no_line_typed_is_an_error_of_ours(line: str) -> None:
    try:
        action, robot = meaning(line, ROBOTS)
    except NotUnderstood as refusal:
        assert "Enter: HOLD ALL" in str(refusal) or "Nothing was done" in str(refusal)
    else:
        assert action in ("hold", "resume", "return", "end") and robot in (None, *ROBOTS)


@given(st.dictionaries(st.sampled_from(["action", "robot", "source", "area_m", "number"]), JSON))
def test_any_command_is_checked_or_refused_in_words(message: dict[str, object]) -> None:
    command = checked_command(message)
    if isinstance(command, str):
        assert command and len(command) < 1_000
        command.encode()  # it can be sent and printed
    else:
        assert command["action"] in ACTIONS
        json.dumps(command, allow_nan=False).encode()  # it can be recorded


KINDS = st.sampled_from(["look", "seek", "play", "pause", "token", "command"])


@given(
    st.fixed_dictionaries(
        {"kind": KINDS | JSON}, optional=dict.fromkeys(("t_s", "rate", "token", "number"), JSON)
    )
)
def test_any_question_is_read_or_is_none(message: dict[str, object]) -> None:
    question = question_of(message)
    if question is not None:
        assert question.kind == message["kind"]
        json.dumps(question.model_dump(), allow_nan=False).encode()
    token_of(message).encode("utf-8", "replace")
    assert number_of(message) is None or message["kind"] == "command"


@given(st.binary() | st.text())
def test_any_frame_is_a_message_or_nothing(data: bytes | str) -> None:
    assert isinstance(message_of(data), dict)


def odd_frame(rng: random.Random, token: str) -> str | bytes:
    """Something a browser should not send, or only nearly should."""
    digits = "9" * 400
    kinds: list[str | bytes] = [
        rng.randbytes(rng.randrange(200)),
        "{" * rng.randrange(1, 3_000),
        '{"kind":"token","token":"\\ud800"}',
        '{"kind":"command","action":"hold","robot":"\\udfff"}',
        '{"kind":"command","action":"hold","robot":"[/x]"}',
        '{"kind":"command","action":"\\ud83d"}',
        f'{{"kind":"command","action":"remove","source":{digits}}}',
        f'{{"kind":"command","action":"exclude","area_m":[[{digits},1],[1,{digits}],[2,2]]}}',
        '{"kind":"command","action":"exclude","area_m":[[NaN,1],[1,Infinity],[2,2]]}',
        '{"kind":"command","action":["hold"],"number":"\\ud800"}',
        '{"kind":"command","action":"end","robot":"r1"}',
        '{"kind":["go"],"action":{}}',
        '{"kind":"seek","t_s":"\\ud800"}',
        f'{{"kind":"look","t_s":{digits}}}',
        '{"kind":"play","rate":NaN}',
        json.dumps([1, 2, 3]),
        json.dumps(
            {"kind": "command", "action": rng.choice(ACTIONS), "robot": rng.choice([1, None, True, "r9"])}
        ),
        json.dumps({"kind": "token", "token": rng.choice([token, None, 7, "no"])}),
    ]
    return rng.choice(kinds)


def test_ten_thousand_odd_frames_leave_no_traceback_and_end_nothing(caplog: pytest.LogCaptureFixture) -> None:
    class NoShow:
        def open(self, mailbox: Mailbox) -> None: ...

        def close(self, mailbox: Mailbox) -> None: ...

        def asked(self, mailbox: Mailbox, question: dict[str, object]) -> None: ...

    commands: list[dict[str, object]] = []

    def take(command: dict[str, object]) -> str:
        commands.append(command)
        return ""

    rng = random.Random(12)
    errors: list[BaseException] = []
    threading.excepthook, before = (
        (lambda args: errors.append(args.exc_value or Exception())),
        threading.excepthook,
    )
    try:
        with caplog.at_level(logging.WARNING), Page(NoShow(), take) as page:
            address = page.address.replace("http", "ws") + "live"
            for _ in range(10):
                with connect(address) as browser:
                    for _ in range(1_000):
                        browser.send(odd_frame(rng, page.token))
                    browser.send(json.dumps({"kind": "token", "token": page.token}))
                    browser.send(json.dumps({"kind": "command", "number": 77, "action": "hold"}))
                    while True:
                        answer = json.loads(browser.recv(timeout=20.0))
                        if answer.get("number") == 77:
                            break
                    assert answer["ok"]
    finally:
        threading.excepthook = before
    assert not errors
    assert [r for r in caplog.records if r.levelno >= logging.ERROR] == []
    assert all(command["action"] != "end" or command["robot"] is None for command in commands)


async def test_a_page_without_a_mission_says_so() -> None:
    assert asyncio.get_running_loop() is not None
    page = LivePage.__new__(LivePage)
    page._runner = page._loop = None
    assert page._command({"action": "hold", "robot": None}) == "the mission is not running"


async def test_the_page_refuses_to_close_the_whole_field() -> None:
    orders: list[Operator] = []
    page = LivePage.__new__(LivePage)
    page._loop, page._where = asyncio.get_running_loop(), "the page"
    page._runner = SimpleNamespace(  # type: ignore[assignment]
        mission=SimpleNamespace(kernel=SimpleNamespace(engine=SimpleNamespace(robots=("a",)))),
        safety=SimpleNamespace(settings=SafetySettings(("a",), 10.0, 8.0)),
        setup=SimpleNamespace(clock=SimpleNamespace(now_ns=lambda: 0)),
        put=orders.append,
    )
    whole, part = (
        {"action": "exclude", "robot": None, "area_m": ((0.0, 0.0), (10.0, 0.0), (10.0, north), (0.0, north))}
        for north in (8.0, 4.0)
    )
    assert "no ground would be left" in page._command(whole)
    assert page._command(part) == ""
    await asyncio.sleep(0)
    assert [order.area_m for order in orders] == [part["area_m"]]


def test_the_line_of_keys_fits_a_terminal_of_80_columns() -> None:
    for ends in ("mission", "agent", "page"):
        assert len(help_of(ends)) < 80 and help_of(ends).endswith(ends)
        with pytest.raises(NotUnderstood, match=f"Ctrl-C: end .*{ends}$"):
            meaning("dance", ROBOTS, ends)
