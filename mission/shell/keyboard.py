"""The terminal as a hand on the mission: Enter holds all robots at once, a word does the rest."""

import asyncio
import contextlib
import sys
from collections.abc import Iterator, Sequence
from typing import Literal

from fieldkit.messages import Operator
from mission.shell.runner import Runner

Action = Literal["hold", "resume", "return", "end"]
WORDS: dict[str, Action] = {
    "": "hold",
    "h": "hold",
    "hold": "hold",
    "r": "resume",
    "resume": "resume",
    "home": "return",
    "return": "return",
    "end": "end",
}
HELP = "Enter: HOLD ALL   r: resume   home: all return, in sequence   end: end the mission   Ctrl-C: end"
EVERYBODY = ("all", "everybody", "*")


class NotUnderstood(ValueError):
    """What was typed asks for nothing; the text says why, and what the words are."""


def meaning(line: str, robots: Sequence[str]) -> tuple[Action, str | None]:
    """What a line asks for, and of which robot (None: all). Raises `NotUnderstood`.

    What is not understood must not do anything, but an empty line, the quickest there is, stops everybody.
    """
    words = line.split()
    said = words[0].lower() if words else ""
    action = WORDS.get(said)
    if action is None:
        raise NotUnderstood(f"there is no command {said!r}. {HELP}")
    who = " ".join(words[1:])
    if not who or who.lower() in EVERYBODY:
        return action, None
    if action == "end":
        raise NotUnderstood(f"'end' ends the whole mission and takes no robot, got {who!r}. Nothing was done")
    if who not in robots:
        raise NotUnderstood(
            f"there is no robot {who!r}; robots are: {', '.join(robots)}, or all. Nothing was done"
        )
    return action, who


@contextlib.contextmanager
def keyboard(runner: Runner) -> Iterator[None]:
    """Lines typed at a terminal go to the mission while in here; without a terminal nothing is read."""
    loop = asyncio.get_running_loop()
    if not (sys.stdin is not None and sys.stdin.isatty()):
        yield
        return

    def typed() -> None:
        line = sys.stdin.readline()
        if not line:  # the terminal has gone
            loop.remove_reader(sys.stdin.fileno())
            return
        try:
            action, robot = meaning(line, runner.mission.kernel.engine.robots)
        except NotUnderstood as refusal:
            print(refusal, file=sys.stderr)
            return
        runner.put(Operator(runner.setup.clock.now_ns(), action, robot, f"terminal: {action}"))

    try:
        loop.add_reader(sys.stdin.fileno(), typed)
    except (NotImplementedError, OSError, ValueError):  # Windows; a closed descriptor
        yield
        return
    try:
        yield
    finally:
        loop.remove_reader(sys.stdin.fileno())
