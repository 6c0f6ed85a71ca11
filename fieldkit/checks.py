"""What a check before the start says: of which robot, how it looks, and what to do about it."""

from dataclasses import dataclass
from typing import Literal

Level = Literal["green", "amber", "red"]
"""Red: do not start. Amber: start if you know why."""


@dataclass(frozen=True, slots=True)
class Check:
    """One cell of the table robot by check."""

    robot: str
    """The robot, or "mission" for what concerns all."""
    name: str
    """Which check: "failsafe", "fence", "battery" ..."""
    level: Level
    found: str
    """What was found, in a few words."""
    remedy: str = ""
    """What to do; empty where there is nothing to do."""


def worst(checks: list[Check]) -> Level:
    """The worst level among them; green for none."""
    levels: tuple[Level, ...] = ("red", "amber", "green")
    return next((level for level in levels if any(check.level == level for check in checks)), "green")
