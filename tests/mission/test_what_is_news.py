"""What an agent says when all is well: heard by whoever watches, and not as trouble."""

import asyncio
import logging
from pathlib import Path

import pytest
from test_agent_runner import Robot, both, two

from fieldkit.console import NEWS


def test_a_start_is_not_silent_and_a_contact_is_no_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def act(team: dict[str, Robot]) -> None:
        await asyncio.create_task(both(team))

    with caplog.at_level(NEWS):
        two(tmp_path, act, duration_s=8.0)
    news = [record.getMessage() for record in caplog.records if record.levelno == NEWS]
    assert [each for each in news if "r2" in each] == [
        "listens for 3 s who else is there, before anything of r2's is touched",
        "waits for r2's position and vehicle, checks it, and acquires control of it",
        "r2 is in contact",
    ]
    assert not [each for each in caplog.records if each.levelno > NEWS], caplog.text
    assert NEWS < logging.WARNING
