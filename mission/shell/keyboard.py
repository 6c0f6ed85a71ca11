"""The terminal as a hand on the mission: Enter holds all robots at once, a word does the rest."""

import asyncio
import contextlib
import sys
from collections.abc import Iterator
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


def meaning(line: str) -> tuple[Action, str | None] | None:
    """What a line asks for, and of which robot (None: all); None where it asks for nothing known.

    What is not understood must not do anything, but an empty line, the quickest there is, stops everybody.
    """
    words = line.strip().lower().split()
    action = WORDS.get(words[0] if words else "")
    if action is None or len(words) > 2:
        return None
    return action, line.strip().split()[1] if len(words) == 2 else None


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
        asked = meaning(line)
        if asked is None:
            print(HELP, file=sys.stderr)
            return
        action, robot = asked
        runner.put(Operator(runner.rig.clock.now_ns(), action, robot, f"terminal: {action}"))

    try:
        loop.add_reader(sys.stdin.fileno(), typed)
    except (NotImplementedError, OSError, ValueError):  # Windows; a closed descriptor
        yield
        return
    try:
        yield
    finally:
        loop.remove_reader(sys.stdin.fileno())
