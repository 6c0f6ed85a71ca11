"""A log that packs its older entries gives every entry back as it was, and hours of it take little."""

import sys
import threading
from typing import Any

import numpy as np
import pytest

from fieldkit.engine.decentralised.entries import STEP_NS, Entry, Stream
from fieldkit.engine.decentralised.log import CHUNK, RECENT, Log
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.messages import Operator, Pose, ReceiverState, RssReading, VehicleState

START_NS = 1_800_000_000 * 10**9
HOUR = 7_200
"""Poses of a robot in an hour."""


def entries(make: Any, count: int) -> list[Entry]:
    times_ns = [START_NS + k * 5_000 * STEP_NS for k in range(count)]
    return [Entry(at_ns, quantised(make(at_ns - k % 7 * STEP_NS, k))) for k, at_ns in enumerate(times_ns)]


def orders(t_ns: int, k: int) -> Operator | ReceiverState | VehicleState:
    if k % 3 == 0:
        return Operator(t_ns, "hold", None, f"number {k}")
    return (
        VehicleState(t_ns, "a", "guided", True, battery_pct=50.0)
        if k % 3 == 1
        else ReceiverState(t_ns, "a", k % 2 == 0, "")
    )


def driven(t_ns: int, k: int) -> Pose:
    """At 0.4 m/s round a circle, positions good to 3 cm."""
    noise = np.random.default_rng(k).normal(0.0, 0.03, 2)
    at_m = 5.0 + 4.0 * np.array([np.sin(0.05 * k), np.cos(0.05 * k)]) + noise
    return Pose(t_ns, "a", *at_m.tolist(), 0.0, 3.0 * k % 360.0, 0.05)


MAKE: dict[Stream, Any] = {
    Stream.ORDERS: orders,
    Stream.HEARD: lambda t_ns, k: RssReading(t_ns, "a", -50.0 - k % 40, frame_id="x" if k % 5 == 0 else None),
    Stream.PLACES: driven,
}


@pytest.mark.parametrize("stream", list(Stream))
@pytest.mark.parametrize("count", [0, 1, RECENT + CHUNK - 1, RECENT + CHUNK, RECENT + 3 * CHUNK + 7])
def test_every_entry_comes_back_as_it_was(stream: Stream, count: int) -> None:
    given = entries(MAKE[stream], count)
    log = Log("a", stream, given)
    assert len(log) == count and list(log) == given and log == given
    assert log[-3:] == given[-3:] and log[CHUNK - 2 : CHUNK + 2] == given[CHUNK - 2 : CHUNK + 2]
    assert bool(log.packed_bytes) == (count >= RECENT + CHUNK)
    if count:
        assert (log[0], log[-1], log[count // 2]) == (given[0], given[-1], given[count // 2])
    with pytest.raises(IndexError, match=f"no entry {count} of {count}"):
        log[count]
    assert log != [*given, *entries(MAKE[stream], 1)]


def test_a_pose_takes_less_than_nine_bytes() -> None:
    log = Log("a", Stream.PLACES, entries(driven, HOUR))
    packed = HOUR - HOUR % CHUNK - RECENT
    assert log.packed_bytes / packed < 9.0


def test_a_reader_in_another_thread_sees_no_half_a_change() -> None:
    given = entries(MAKE[Stream.HEARD], RECENT + 120 * CHUNK)
    log, wrong, before_s = Log("a", Stream.HEARD), [], sys.getswitchinterval()

    def read() -> None:
        while (count := len(log)) < len(given):
            try:
                if count and log[count - 1] != given[count - 1]:
                    wrong.append(count)
            except IndexError:
                wrong.append(count)

    reader = threading.Thread(target=read)
    sys.setswitchinterval(1e-6)
    try:
        reader.start()
        log.extend(given)
        reader.join()
    finally:
        sys.setswitchinterval(before_s)
    assert wrong == []
