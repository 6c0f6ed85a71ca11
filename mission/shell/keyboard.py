"""The terminal as a hand on the mission: Enter holds all robots at once, a word does the rest."""

import asyncio
import contextlib
import os
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Literal, Protocol

from fieldkit.messages import Event, Operator
from mission.core.mission_file import Mission
from mission.shell.setups import Setup

Action = Literal["hold", "resume", "return", "end"]
WORDS: dict[str, Action] = {
    "": "hold",
    "h": "hold",
    "hold": "hold",
    "stop": "hold",
    "halt": "hold",
    "r": "resume",
    "resume": "resume",
    "home": "return",
    "return": "return",
    "end": "end",
}
HELP = "Enter: HOLD ALL   r: resume   home: all return   end or Ctrl-C: end the mission"

WHOLE = "mission"
"""What "end" ends, unless said otherwise."""
EVERYBODY = ("all", "everybody", "*")
LONGEST_LINE = 4096
"""What a terminal takes for a line at the most."""
LISTEN_AGAIN_S = 0.2
"""A terminal that has given nothing, though it said that it would, is listened to again after so long."""
MOST_SHOWN = 40
KEYS = re.compile(r"\x1b(?:\[[0-9;?]*[ -/]*[@-~]|O.|.)?")
"""What arrows and other keys without a letter send: hit on the way to Enter, they must not keep it from holding."""


def help_of(ends: str = WHOLE) -> str:
    """What can be typed. `ends`: what "end" ends, where that is not the whole mission."""
    return HELP if ends == WHOLE else HELP.replace("the mission", f"this {ends}")


class Commanded(Protocol):
    """What takes orders: a runner."""

    @property
    def mission(self) -> Mission: ...

    @property
    def setup(self) -> Setup: ...

    def put(self, event: Event) -> None: ...


class NotUnderstood(ValueError):
    """What was typed asks for nothing; the text says why, and what the words are."""


def meaning(line: str, robots: Sequence[str], ends: str = WHOLE) -> tuple[Action, str | None]:
    """What a line asks for, and of which robot (None: all). Raises `NotUnderstood`.

    What is not understood must not do anything, but an empty line, the quickest there is, stops everybody.
    """
    words = KEYS.sub("", line).split()
    said = words[0].lower() if words else ""
    action = WORDS.get(said)
    if action is None:
        raise NotUnderstood(f"there is no command {_shown(said)}. {help_of(ends)}")
    who = " ".join(words[1:])
    if not who or who.lower() in EVERYBODY:
        return action, None
    if action == "end":
        whole = "the whole mission" if ends == WHOLE else f"this {ends}"
        raise NotUnderstood(f"'end' ends {whole} and takes no robot, got {_shown(who)}. Nothing was done")
    alike = [name for name in robots if name.casefold() == who.casefold()]
    if who not in robots and len(alike) == 1:
        who = alike[0]
    if who not in robots:
        raise NotUnderstood(
            f"there is no robot {_shown(who)}; robots are: {', '.join(robots)}, or all. Nothing was done"
        )
    return action, who


def _shown(word: str) -> str:
    """The word as it was typed, cut to a readable length."""
    return repr(word if len(word) <= MOST_SHOWN else f"{word[:MOST_SHOWN]}...")


class Typed:
    """Lines out of what a terminal gives. It is never waited for: the end of a line may not have been typed yet."""

    def __init__(self) -> None:
        self._begun = b""

    def lines(self, data: bytes) -> list[str]:
        """The lines that `data` completes."""
        *whole, begun = (self._begun + data).replace(b"\r", b"\n").split(b"\n")
        self._begun = begun[:LONGEST_LINE]
        return [line.decode("utf-8", "replace") for line in whole]


@contextlib.contextmanager
def keyboard(runner: Commanded, ends: str = WHOLE, where: str = "the terminal") -> Iterator[None]:
    """Lines typed at a terminal go to the mission while in here; without a terminal nothing is read.

    `ends`: what "end" ends: the mission, this agent, this page. `where`: which terminal this is, for those elsewhere.
    """
    loop = asyncio.get_running_loop()
    if not (sys.stdin is not None and sys.stdin.isatty()):
        yield
        return
    terminal, typed = sys.stdin.fileno(), Typed()
    waits: asyncio.TimerHandle | None = None

    def obey(line: str) -> None:
        try:
            action, robot = meaning(line, runner.mission.kernel.engine.robots, ends)
        except NotUnderstood as refusal:
            print(refusal, file=sys.stderr)
            return
        runner.put(Operator(runner.setup.clock.now_ns(), action, robot, f"operator, in {where}"))

    def ready() -> None:
        try:
            data = os.read(terminal, LONGEST_LINE)
        except OSError:  # in the background it gives nothing
            data = b""
        for line in typed.lines(data):
            obey(line)
        if (
            not data
        ):  # Ctrl-D ends no terminal, and the next Enter must hold; one that has gone is not asked for ever
            pause()

    def pause() -> None:
        nonlocal waits
        loop.remove_reader(terminal)
        waits = loop.call_later(LISTEN_AGAIN_S, listen)

    def listen() -> None:
        if os.isatty(terminal):
            loop.add_reader(terminal, ready)

    try:
        loop.add_reader(terminal, ready)
    except (NotImplementedError, OSError, ValueError):  # Windows; a closed descriptor
        yield
        return
    try:
        yield
    finally:
        loop.remove_reader(terminal)
        if waits is not None:
            waits.cancel()
