"""The page that says what a safe driver must do names tests that are there."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_every_test_that_the_page_names_is_there():
    page = (ROOT / "docs" / "mavlink.md").read_text()
    there = "\n".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    named = set(re.findall(r"\btest_\w+", page))
    assert len(named) > 40
    assert not named - set(re.findall(r"def (test_\w+)", there))
