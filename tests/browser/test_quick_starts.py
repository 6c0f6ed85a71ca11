"""A quick start by its page alone: the command it names, the page on a phone, an arrow, and a found transmitter."""

import contextlib
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
from flying import looking, wait_until
from sizes import size

PAGES = Path(__file__).parents[2] / "docs" / "quickstart"
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
LONGEST_S = 300

pytestmark = pytest.mark.timeout(600)


@dataclass
class Started:
    """A command at a terminal, and what it has said."""

    process: subprocess.Popen[str]
    said: list[str] = field(default_factory=list)

    def has_said(self, pattern: str) -> str:
        found = re.search(pattern, "".join(self.said))
        return found.group(1) if found else ""


@contextmanager
def started(page: str, folder: Path) -> Iterator[Started]:
    """The command of a quick start, as somebody types it; Ctrl-C at the end."""
    (command,) = re.findall(r"^    fieldkit (demo .*)$", (PAGES / page).read_text("utf-8"), re.MULTILINE)
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "fieldkit", *shlex.split(command), "--page-port", "0", "--out", str(folder)],
        stdin=theirs, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip
    os.close(theirs)
    running = Started(process)

    def listen() -> None:
        assert process.stdout is not None
        running.said.extend(iter(lambda: process.stdout.readline(), ""))  # type: ignore[union-attr]  # piped above

    reader = Thread(target=listen, daemon=True)
    reader.start()
    try:
        yield running
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(signal.SIGINT)
        try:
            process.wait(30.0)
        except subprocess.TimeoutExpired:
            process.kill()
        reader.join(10.0)
        os.close(ours)


def wait_for(tab: Any, running: Started, shown: str) -> None:
    """Until the page shows something; fails at once where the command has ended, with what it said."""
    from playwright.sync_api import TimeoutError as NotYet

    for _ in range(LONGEST_S):
        try:
            tab.wait_for_function(f"() => {shown}", timeout=1000)
            return
        except NotYet:
            assert running.process.poll() is None, "".join(running.said)[-3000:]
    raise AssertionError(f"not shown within {LONGEST_S} s: {shown}")


@pytest.mark.parametrize("page", size(["lora.md"], ["lora.md", "drone.md"]))
def test_a_newcomer_sees_a_transmitter_found_on_a_phone(page: str, browser: Any, tmp_path: Path) -> None:
    on_foot = page != "drone.md"
    with started(page, tmp_path) as running:
        wait_until(lambda: running.has_said(r"open\s+(http\S+)") or running.process.poll() is not None, 120.0)
        with looking(browser, running.has_said(r"open\s+(http\S+)"), **PHONE) as tab:
            if on_foot:
                wait_for(
                    tab,
                    running,
                    """document.getElementById("walk-arrow").style.opacity === "1"
                      && /^\\d+ m, /.test(document.getElementById("walk-go").textContent)""",
                )
            wait_for(tab, running, "document.getElementById('found').textContent === '1'")
            if on_foot:
                wait_for(
                    tab, running, "document.getElementById('walk-go').textContent === 'The walk is over'"
                )
                tab.locator("#walk-found button").tap()
            else:
                tab.locator("[data-tab=sources]").tap()
                tab.locator("#sources .source button").first.tap()
            tab.wait_for_selector("#where button[data-form=mgrs]")
            wait_until(lambda: running.has_said("(the page stays open)"), 60.0)
    said = "".join(running.said)
    assert "it was hidden at" in said and "Traceback" not in said, said[-3000:]
    assert running.process.returncode == 0
