"""The moment bytes came in, noted by the kernel."""

import os
import subprocess
import sys
import threading
import time

import pytest

from drivers.arrival import wait_readable


@pytest.fixture
def pipe():
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


def test_nothing_within_the_timeout_is_none(pipe):
    began_s = time.monotonic()
    assert wait_readable(pipe[0], 0.05) is None
    assert time.monotonic() - began_s >= 0.045


def test_bytes_that_wait_already_are_seen_at_once(pipe):
    os.write(pipe[1], b"x")
    before_s = time.monotonic()
    arrived_s = wait_readable(pipe[0], 1.0)
    assert before_s - 0.001 <= arrived_s <= time.monotonic()


def test_a_closed_descriptor_is_an_error():
    with pytest.raises(OSError):
        wait_readable(-1, 0.1)
    gone = os.dup(0)
    os.close(gone)
    with pytest.raises(OSError):
        wait_readable(gone, 0.1)


@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux's select")
def test_a_computing_thread_does_not_make_the_stamp_late(pipe):
    """Bytes written by another process while this one computes without a pause for other threads."""
    arrived = []
    switch_s = sys.getswitchinterval()
    thread = threading.Thread(target=lambda: arrived.append(wait_readable(pipe[0], 2.0)))
    thread.start()
    write = "import os, time; time.sleep(0.1); os.write({}, repr(time.monotonic()).encode())"
    child = subprocess.Popen([sys.executable, "-S", "-c", write.format(pipe[1])], pass_fds=[pipe[1]])
    sys.setswitchinterval(1.0)
    try:
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s:
            pass
    finally:
        sys.setswitchinterval(switch_s)
    child.wait(10.0)
    thread.join()
    written_s = float(os.read(pipe[0], 100))
    assert abs(arrived[0] - written_s) < 0.05
