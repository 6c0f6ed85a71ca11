"""What is wrong with a draft, by the same checks as `fieldkit check`, each with the key that it is about."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fieldkit.errors import FieldkitError
from mission.core.advice import advise
from mission.core.mission_file import mission_of
from mission.maps.background import read_background
from mission.shell import setups

OF_ROBOT = re.compile(r"(receiver|vehicle) of (.+?) \([^()]*\): (.*)")
"""What drivers say of their options."""
SHOWN_SHARE = 0.99
"""A background that covers less of the field is remarked on."""


@dataclass(frozen=True, slots=True)
class Remark:
    """One thing to say of a draft."""

    level: Literal["red", "amber"]
    """"red": it cannot be flown so; "amber": it can, but."""
    key: str
    """As in the file: "field.cell_m"; empty where it is about the whole."""
    text: str


NO_ROBOT = Remark("red", "robot", "expected a value, got nothing")
ADD_ONE = Remark("red", "", "No robot yet: add one, with its radio and its vehicle.")


def judge(text: str, path: Path) -> list[Remark]:
    """Remarks on a draft of the mission file at `path`, whose antenna and background lie beside it."""
    try:
        mission = mission_of(text, path)
        setups.live(mission)  # drivers check their own options when they are made
        background = read_background(mission)
    except FieldkitError as error:
        remarks = [_remark("red", line, path) for line in str(error).splitlines() if line.strip()]
        if NO_ROBOT in remarks:  # whoever begins has no team either: one thing to do, not two
            return [ADD_ONE, *(each for each in remarks if each.key not in ("robot", "team"))]
        return remarks
    remarks = [_remark("amber", line, path) for line in advise(mission)]
    if background is not None and background.covered < SHOWN_SHARE:
        shown = f"shows {background.covered:.0%} of the field"
        remarks.append(Remark("amber", "field.background", shown))
    return remarks


def _remark(level: Literal["red", "amber"], line: str, path: Path) -> Remark:
    said = line.removeprefix(f"{path}: ")
    if of_robot := OF_ROBOT.fullmatch(said):
        part, name, rest = of_robot.groups()
        return Remark(level, f"robot {name}: {part}", rest)
    key, _, rest = said.partition(": ")
    is_key = bool(rest) and " " not in key.strip() and "/" not in key
    return Remark(level, key if is_key else "", rest if is_key else said)
