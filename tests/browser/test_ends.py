"""What End on a page says that it ends: with robots that have computers of their own it is not the mission."""

from pathlib import Path
from typing import Any

import pytest
from flying import browser, looking

from mission.lab.synthetic import small_mission
from mission.page import serve
from mission.page.protocol import Ends

__all__ = ["browser"]


@pytest.mark.parametrize(
    ("ends", "words"), [("mission", "End mission"), ("agent", "End this agent"), ("page", "End this page")]
)
def test_end_says_what_it_ends(browser: Any, tmp_path: Path, ends: Ends, words: str) -> None:
    with serve.live(small_mission(tmp_path)) as shown:
        shown.ends(ends)
        with looking(browser, shown.page.command_address) as tab:
            tab.locator("#end", has_text=words).wait_for()
            tab.locator("#end").click()
            tab.locator("#end", has_text="Sure? Press again").wait_for()
            tab.locator("#end", has_text=words).wait_for()
