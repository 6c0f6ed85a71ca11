"""Each quick start names one command on emulated devices, and that command is one that `test_walk_demos` flies."""

import re
from pathlib import Path

import pytest

from mission.lab.walk_demo import KINDS

PAGES = Path(__file__).parents[2] / "docs" / "quickstart"
COMMAND = re.compile(r"^    (fieldkit demo .*)$", re.MULTILINE)


@pytest.mark.parametrize("name", ["xbee", "wildlife", "lora", "wifi", "drone"])
def test_a_quick_start_has_one_command_that_there_is(name: str) -> None:
    (command,) = COMMAND.findall((PAGES / f"{name}.md").read_text(encoding="utf-8"))
    words = command.split()
    assert words[-1] == "--page", "ends on the page"
    assert words[2:-1] == ["--drone"] or (words[2] == "--walk" and words[3] in KINDS and len(words) == 5)
