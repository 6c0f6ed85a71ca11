"""A terminal that closes says so more than once: the system to all in front, then the shell to its jobs."""

import asyncio
import os
import signal
from pathlib import Path

import pytest

from mission.shell.signals import StopSignals, leave_closed_terminals


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no terminals that hang up here")
async def test_a_hang_up_that_comes_again_after_the_mission_does_not_kill_what_writes_the_report() -> None:
    came: list[str] = []
    signals = StopSignals(came.append, lambda: None, lambda: None)
    before = signal.getsignal(signal.SIGHUP)
    try:
        with signals.caught():
            os.kill(os.getpid(), signal.SIGHUP)
            await asyncio.sleep(0.01)
        assert came == ["SIGHUP"]
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
        os.kill(os.getpid(), signal.SIGHUP)  # would end the tests
    finally:
        signal.signal(signal.SIGHUP, before)


def test_what_is_said_to_a_closed_terminal_is_no_error_and_files_are_left_as_they_are(tmp_path: Path) -> None:
    pty = pytest.importorskip("pty")
    master, terminal = pty.openpty()
    kept = os.open(tmp_path / "kept", os.O_WRONLY | os.O_CREAT)
    os.close(master)
    with pytest.raises(OSError):
        os.write(terminal, b"ended")
    leave_closed_terminals((terminal, kept))
    assert os.write(terminal, b"ended") == 5
    assert os.write(kept, b"ended") == 5 and (tmp_path / "kept").read_bytes() == b"ended"
    os.close(terminal)
    os.close(kept)
