"""The fault campaign itself: drawn from the seed, the same twice, and its judge can say no."""

import asyncio
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from fieldkit import jumploop
from mission.lab.study import fault_flight, fault_judge, fault_kinds
from mission.lab.study.fault_kinds import KINDS, LARGE, SMALL, Fault, Job, draw_faults
from mission.lab.study.faults import summary, trial
from mission.safety.limits import SafetySettings


def test_faults_come_from_the_seed_and_every_kind_comes_up() -> None:
    robots = tuple(f"r{k}" for k in range(1, 5))
    drawn = [draw_faults(Job(n, n), robots) for n in range(len(KINDS))]
    assert drawn == [draw_faults(Job(n, n), robots) for n in range(len(KINDS))]
    assert {fault.kind for each in drawn for fault in each} == set(KINDS)
    assert all(0 < fault.at_s < SMALL.duration_s / 2 for each in drawn for fault in each)
    sizes = Counter(Job(n, n).size.robots for n in range(200))
    assert sizes == {4: 150, 16: 50} and LARGE.robots == 16


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fault_kinds, "SMALL", replace(SMALL, duration_s=40.0))


@pytest.mark.usefixtures("short")
def test_a_trial_is_repeatable_and_good() -> None:
    lost_link = Job(0, 0)
    first, second = trial(lost_link), trial(lost_link)
    assert first == second
    assert first["faults"][0] == "link loss"
    total = summary([first])
    for name in ("fence_breaches", "separation_breaches", "lost_not_held", "unreadable_recordings"):
        assert total[name] == 0, total


@pytest.mark.usefixtures("short")
def test_the_judge_sees_a_vehicle_that_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rover without its own failsafe, cut off: exactly what must not be counted as held."""
    from drivers.emulators.fleet import EmulatedRover

    monkeypatch.setattr(EmulatedRover, "drives_for_us", property(lambda rover: rover.silent))
    assert summary([trial(Job(0, 0))])["lost_not_held"] > 0


def test_the_judge_sees_two_ways_that_meet() -> None:
    place = {"a": np.array([0.0, 0.0]), "b": np.array([4.0, 0.0])}
    heading = {"a": (np.array([4.0, 0.0]), 0.4), "b": (np.array([0.0, 0.0]), 0.4)}
    assert fault_judge._would_meet("a", "b", place, heading, 0.25)
    heading["b"] = (np.array([4.0, 4.0]), 0.4)
    assert not fault_judge._would_meet("a", "b", place, heading, 0.25)


def test_only_a_short_loss_of_position_under_our_own_hold_needs_no_resume() -> None:
    limits = SafetySettings(("a",), 10.0, 10.0, call_after_s=30.0, pose_timeout_s=2.0)
    short, long = Fault("GPS loss", "a", 100.0, 131.0), Fault("GPS loss", "a", 100.0, 140.0)
    assert fault_flight._goes_on_by_itself(short, True, limits)
    assert not fault_flight._goes_on_by_itself(short, False, limits), "its own failsafe has taken it from us"
    assert not fault_flight._goes_on_by_itself(long, True, limits)
    assert not fault_flight._goes_on_by_itself(replace(short, kind="link loss"), True, limits)


def test_time_jumps_and_sockets_do_not() -> None:
    async def hours() -> tuple[float, list[str]]:
        said: list[str] = []

        async def late(name: str, delay_s: float) -> None:
            await asyncio.sleep(delay_s)
            said.append(name)

        loop = asyncio.get_running_loop()
        await asyncio.gather(
            late("b", 7200.0), late("a", 3600.0), loop.run_in_executor(None, said.append, "now")
        )
        reader, writer = await _pair()
        writer.write(b"x")
        assert await reader.readexactly(1) == b"x"
        writer.close()
        return loop.time(), said

    async def _pair() -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        import socket

        ours, theirs = socket.socketpair()
        reader, first = await asyncio.open_connection(sock=ours)
        _, writer = await asyncio.open_connection(sock=theirs)
        _keep.append(first)
        return reader, writer

    _keep: list[asyncio.StreamWriter] = []
    assert jumploop.run(hours()) == (7200.0, ["now", "a", "b"])
