"""Guided collection: packets that do not arrive are counted, an interruption costs one place at most."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from calibration.collect import Beacon, collect, parse_answer
from calibration.collection import Packet, Place, from_csv, packets_from, still_missing, to_csv
from calibration.dataset import read_readings
from calibration.fit import fit
from fieldkit.clock import VirtualClock
from fieldkit.errors import DataError, DeviceError
from fieldkit.messages import ReceiverState, RssReading

SECOND = 1_000_000_000


class FakeReceiver:
    """Hears a beacon at the distance last announced, as a radio of the given exponent would."""

    robot = "r1"

    def __init__(self, clock, exponent=2.5, fails_after=None):
        self.clock, self.exponent, self.fails_after = clock, exponent, fails_after
        self.distance_m, self.open, self.heard = 1.0, False, 0
        self.rng = np.random.default_rng(0)

    async def __aenter__(self):
        self.open = True
        return self

    async def __aexit__(self, *error):
        self.open = False

    async def readings(self):
        while True:
            now_ns = self.clock.now_ns()
            while self.clock.now_ns() == now_ns:  # noqa: ASYNC110 the clock has no event to wait for
                await asyncio.sleep(0)
            self.heard += 1
            if self.fails_after is not None and self.heard > self.fails_after:
                yield ReceiverState(self.clock.now_ns(), "r1", False, "unplugged")
                continue
            level = round(-55.0 - 10 * self.exponent * np.log10(self.distance_m) + self.rng.normal(0, 2))
            if level > -75:
                yield RssReading(self.clock.now_ns(), "r1", float(level), frame_id="beacon:1")
            yield RssReading(self.clock.now_ns(), "r1", -40.0, frame_id="stranger:9")


class SteppedClock(VirtualClock):
    """Sleeps in steps of a second, giving other tasks their turn at each."""

    async def sleep(self, duration_s):
        for _ in range(round(duration_s)):
            self.advance_to(self.now_ns() + SECOND)
            for _ in range(5):
                await asyncio.sleep(0)


def operator(receiver, answers):
    queue = list(answers)

    def ask(question):
        answer = queue.pop(0)
        place = parse_answer(answer)
        if place is not None:
            receiver.distance_m = place[0]
        return answer

    return ask


def run(out: Path, answers, **more):
    clock = SteppedClock(100 * SECOND)
    receiver = FakeReceiver(clock, **more)
    said: list[str] = []
    beacon = Beacon(1.0, 15, source="beacon")
    places = asyncio.run(collect(receiver, clock, beacon, out, operator(receiver, answers), said.append))
    assert not receiver.open
    return places, said


def test_what_was_collected_can_be_fitted(tmp_path):
    out = tmp_path / "r.csv"
    answers = [f"{d:.3f}" for d in np.geomspace(0.3, 8.0, 24)]
    places, said = run(out, [*answers, "q"])
    assert len(places) == 24
    readings = read_readings(out)
    assert readings.n_places == 24 and readings.missed.any()
    assert fit(readings).antenna.path_loss_exponent == pytest.approx(2.5, abs=0.25)
    assert any("still wanted" in line for line in said[:4])
    assert not any("still wanted" in line for line in said[-1:])


def test_an_interrupted_collection_is_gone_on_with(tmp_path):
    out = tmp_path / "r.csv"
    run(out, ["1 0", "2 90", "q"])
    places, said = run(out, ["u", "far", "3", "4 180", "q"])
    assert [(p.distance_m, p.heading_deg) for p in places] == [(1.0, 0.0), (4.0, 180.0)]
    assert "going on after 2 places" in said[0]
    assert any("is not a distance" in line for line in said)
    assert any("at every place or at none" in line for line in said)
    assert len(from_csv(out)) == 2


def test_a_lost_receiver_keeps_the_places_before(tmp_path):
    out = tmp_path / "r.csv"
    with pytest.raises(DeviceError, match="was lost"):
        run(out, ["1", "2", "q"], fails_after=20)
    assert [p.distance_m for p in from_csv(out)] == [1.0]


def test_a_silent_period_is_a_missed_packet_and_a_repeat_is_none():
    heard = [RssReading(t * SECOND, "r1", -60.0 - t) for t in (1, 2, 5)]
    heard.append(RssReading(2 * SECOND + 1000, "r1", -99.0))
    packets = packets_from(heard, SECOND // 2, 1.0, 6)
    assert [p.rss_dbm for p in packets] == [-61.0, -62.0, None, None, -65.0, None]
    assert [p.rss_dbm for p in packets_from([], 0, 1.0, 3)] == [None, None, None]


def test_wishes_come_to_an_end():
    def place(number, distance, share):
        packets = tuple(Packet(i, -60.0 if i < share * 20 else None) for i in range(20))
        return Place(f"p{number}", distance, None, "r1", packets)

    assert still_missing([])
    far = [place(i, d, 0.5 if d > 4 else 1.0) for i, d in enumerate(np.geomspace(0.3, 8, 25))]
    assert still_missing(far) == []
    assert "threshold" in " ".join(
        still_missing([place(i, d, 1.0) for i, d in enumerate(np.geomspace(0.3, 8, 25))])
    )


def test_places_survive_the_file(tmp_path):
    places = [Place("p01", 1.5, 90.0, "r1", (Packet(1.0, -60.0), Packet(2.0, None)))]
    (tmp_path / "r.csv").write_text(to_csv(places))
    assert from_csv(tmp_path / "r.csv") == places


def test_somebody_elses_file_is_not_written_over(tmp_path):
    (tmp_path / "r.csv").write_text("a,b\n1,2\n")
    with pytest.raises(DataError, match="was not written by"):
        from_csv(tmp_path / "r.csv")
