"""Guided collection: packets that do not arrive are counted, an interruption costs one place at most."""

import asyncio
import threading
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.cli import app
from calibration.collect import Beacon, Collector, parse_answer
from calibration.collect_log import CollectLog, free_path, metadata, places_of
from calibration.collection import Packet, Place, from_csv, packets_from, still_missing, to_csv
from calibration.dataset import read_readings
from calibration.fit import fit
from calibration.importing import csv_from_recording
from calibration.options import settings
from calibration.positions import PositionFeed
from fieldkit.clock import VirtualClock
from fieldkit.errors import ConfigError, DataError, DeviceError
from fieldkit.messages import Pose, ReceiverState, RssReading, VehicleState
from fieldkit.recording import RecordingWriter, open_recording

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


def run(out: Path, answers, *, collect_log=None, headings=(), ask=None, where=None, **more):
    clock = SteppedClock(100 * SECOND)
    receiver = FakeReceiver(clock, **more)
    said: list[str] = []
    collector = Collector(
        receiver,
        clock,
        Beacon(1.0, 15, source="beacon"),
        out,
        ask or operator(receiver, answers),
        said.append,
        collect_log,
        where and where(clock, receiver),
        headings,
    )
    places = asyncio.run(collector.run())
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
    assert "going on after 2 places" in said[0] and "still wanted" in said[1]
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


class FakeRover:
    """A vehicle's link: stands where told, and says so five times a second of the test's clock."""

    robots = ("r1", "other")

    def __init__(self, clock, receiver, late_s=0.0):
        self.clock, self.receiver, self.late_s = clock, receiver, late_s
        self.east_m, self.drift_m_s, self.silent, self.open = 0.0, 0.0, False, False

    async def __aenter__(self):
        self.open = True
        return self

    async def __aexit__(self, *error):
        self.open = False

    async def events(self):
        while True:
            now_ns = self.clock.now_ns()
            while self.clock.now_ns() == now_ns:  # noqa: ASYNC110 the clock has no event to wait for
                await asyncio.sleep(0)
            self.east_m += self.drift_m_s
            self.receiver.distance_m = max(0.1, abs(self.east_m))
            stamp = self.clock.now_ns() - round(self.late_s * SECOND)
            yield VehicleState(stamp, "r1", "hold", False)
            yield Pose(stamp, "other", 99.0, 99.0)
            if not self.silent:
                yield Pose(stamp, "r1", self.east_m, 0.0, heading_deg=0.0, sigma_m=0.02)

    def beat(self): ...
    async def acquire_control(self, robot, *, arm=True): ...
    async def goto(self, robot, waypoint): ...
    async def hold(self, robot): ...
    async def return_home(self, robot): ...


def tracked(out, steps, transmitter=None, late_s=0.0, **more):
    """Answers, each with what happens to the rover before it is given."""
    rover: list[FakeRover] = []

    def where(clock, receiver):
        rover.append(FakeRover(clock, receiver, late_s))
        return PositionFeed("r1", rover[0], transmitter)

    queue = list(steps)

    def ask(question):
        answer, changes = queue.pop(0)
        for name, value in changes.items():
            setattr(rover[0], name, value)
        return answer

    places, said = run(out, [], ask=ask, where=where, **more)
    assert not rover[0].open
    return places, said


def test_places_are_read_from_telemetry(tmp_path):
    steps = [("", {}), ("t", {}), ("", {"east_m": 3.0}), ("", {"east_m": -2.0}), ("q", {})]
    places, said = tracked(tmp_path / "r.csv", steps)
    assert "place is not known" in said[0] and "the transmitter is at 0.00 m east" in said[1]
    # Looking north, the transmitter to the west is on the left: 270 degrees clockwise; from the west, 90.
    assert [(p.distance_m, p.heading_deg) for p in places] == [(3.0, 270.0), (2.0, 90.0)]
    assert read_readings(tmp_path / "r.csv").n_places == 2


def test_a_rover_that_moves_is_silent_or_stands_at_the_transmitter_gives_no_place(tmp_path):
    steps = [
        ("", {"east_m": 3.0, "drift_m_s": 0.2}),
        ("", {"drift_m_s": 0.0, "silent": True}),
        ("", {"silent": False, "east_m": 0.0}),
        ("what", {}),
        ("q", {}),
    ]
    places, said = tracked(tmp_path / "r.csv", steps, transmitter=(0.0, 0.0))
    text = " / ".join(said)
    assert places == []
    assert "moved by" in text and "no position came" in text and "cannot distinguish from none" in text
    assert "'what' is no answer" in text


def test_positions_stamped_by_another_clock_are_noticed(tmp_path):
    steps = [("", {"east_m": 3.0}), ("q", {})]
    _, said = tracked(tmp_path / "r.csv", steps, transmitter=(0.0, 0.0), late_s=7.0)
    assert any("-7.0 s from this computer's clock" in line for line in said)


def test_the_antenna_is_turned_through_headings_at_each_place(tmp_path):
    out = tmp_path / "r.csv"
    places, _ = run(out, ["2", "", "s", "", "", "4", "", "", "", "", "q"], headings=(0.0, 90.0, 180.0, 270.0))
    assert [(p.name, p.heading_deg) for p in places] == [
        *(("p01", h) for h in (0.0, 180.0, 270.0)),
        *(("p02", h) for h in (0.0, 90.0, 180.0, 270.0)),
    ]
    assert from_csv(out) == places
    assert read_readings(out).n_places == 2


def test_a_recording_of_the_collection_gives_the_same_readings(tmp_path):
    log, out = tmp_path / "r.mcap", tmp_path / "r.csv"
    with RecordingWriter(log, metadata=metadata("beacon", 1.0, 15)) as writer:
        run(out, ["1", "2", "u", "3", "q"], collect_log=CollectLog(writer))
    recording = open_recording(log)
    assert places_of(recording) == from_csv(out)
    assert csv_from_recording(log)[0] == out.read_text()
    assert sum(isinstance(event, RssReading) for _, _, event in recording.events()) > 60


def test_a_second_recording_holds_what_the_first_run_collected(tmp_path):
    out = tmp_path / "r.csv"
    for answers in (["1", "2", "q"], ["u", "3", "q"]):
        log = free_path(out.with_suffix(".mcap"))
        with RecordingWriter(log, metadata=metadata("beacon", 1.0, 15)) as writer:
            run(out, answers, collect_log=CollectLog(writer))
    assert log.name == "r-2.mcap"
    assert csv_from_recording(log)[0] == out.read_text()


def test_sequence_numbers_count_packets_that_time_alone_would_misplace():
    # Three numbers later after two periods and a half: the beacon's clock is fast, and two packets were missed.
    def reading(t_s, number):
        return RssReading(round(t_s * SECOND), "r1", -60.0 - number % 7, frame_id=f"1234:0001/{number:02x}")

    heard = [
        reading(0.0, 0xFE),
        reading(0.85, 0xFF),
        reading(1.7, 0x00),
        reading(4.2, 0x03),
        reading(5.95, 0x05),
    ]
    levels = [p.rss_dbm for p in packets_from(heard, 0, 1.0, 8)]
    assert [level is None for level in levels] == [False, False, False, True, True, False, True, False]


def test_a_restarted_sequence_number_falls_back_to_time():
    heard = [
        RssReading(t * SECOND, "r1", -60.0, frame_id=f"1:2/{n:02x}") for t, n in ((0, 0), (1, 1), (2, 0x81))
    ]
    assert len(packets_from(heard, 0, 1.0, 4)) == 4


def test_settings_are_numbers_where_they_look_like_numbers():
    given = [
        "system_id=1",
        "baud=9600",
        "rate=0.5",
        "port=/dev/ttyUSB0",
        "address=0013A200",
        "sync=true",
        "key=[1]",
    ]
    assert list(settings(given).values()) == [1, 9600, 0.5, "/dev/ttyUSB0", "0013A200", True, "[1]"]
    with pytest.raises(ConfigError, match="NAME=VALUE"):
        settings(["port"])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--positions", "camera", "--address", "0"], "no source of positions is installed"),
        (["--vehicle", "mavlink", "--address", "udpin:127.0.0.1:0"], "--origin"),
        (["--vehicle", "mavlink"], "--address"),
        (["--period-s", "0"], "--period-s"),
        (["--receiver", "nothing"], "no 'nothing'"),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_is_opened(tmp_path, options, says, monkeypatch):
    from fieldkit import plugins

    known = plugins.names
    monkeypatch.setattr(plugins, "names", lambda group: [] if group == "fieldkit.positions" else known(group))
    out = tmp_path / "r.csv"
    result = CliRunner().invoke(app, ["collect", "-o", str(out), "--set", "port=/dev/null", *options])
    assert isinstance(result.exception, ConfigError) and says in str(result.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_receiver_that_a_file_describes_is_collected_with(tmp_path, monkeypatch):
    from fieldkit import plugins

    given = {}

    def opened(name, options, around):
        given.update(options)
        raise ConfigError("far enough")

    monkeypatch.setattr(plugins, "load", lambda group, name: opened if name == "lines" else None)
    (tmp_path / "radio.toml").write_text('port = "/dev/x"\nformat = "regex"\npattern = \'S=(?P<rss>.+)\'\n')
    arguments = ["collect", "-o", str(tmp_path / "r.csv"), "--receiver", str(tmp_path / "radio.toml")]
    result = CliRunner().invoke(app, [*arguments, "--set", "port=/dev/y"])
    assert "far enough" in str(result.exception)
    assert given == {"port": "/dev/y", "format": "regex", "pattern": "S=(?P<rss>.+)"}
    result = CliRunner().invoke(app, ["collect", "-o", str(tmp_path / "r.csv"), "--receiver", "no.toml"])
    assert "--receiver no.toml: cannot be read" in str(result.exception)


def test_ctrl_c_at_a_question_needs_no_enter_as_well(tmp_path):
    asked, released = threading.Event(), threading.Event()

    def ask(question):
        asked.set()
        released.wait(20.0)
        return "q"

    clock = SteppedClock(100 * SECOND)
    collector = Collector(
        FakeReceiver(clock), clock, Beacon(1.0, 15), tmp_path / "r.csv", ask, lambda text: None
    )

    async def interrupted():
        running = asyncio.create_task(collector.run())
        while not asked.is_set():  # noqa: ASYNC110 it is set in a thread
            await asyncio.sleep(0.01)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running

    asyncio.run(interrupted())
    assert not released.is_set() and not collector.receiver.open
    released.set()


def test_what_is_no_file_is_not_gone_on_with():
    with pytest.raises(DataError, match="/dev/full: is no file that could be gone on with"):
        run(Path("/dev/full"), ["q"])


def test_answers_that_end_keep_what_there_is_and_a_missing_radio_leaves_nothing(tmp_path):
    (tmp_path / "lines").write_text("")
    out, port = tmp_path / "r.csv", tmp_path / "lines"
    words = ["collect", "-o", str(out), "--period-s", "0.01", "--receiver"]
    done = CliRunner().invoke(app, [*words, f"{port},json"], input="5\n")
    assert done.exit_code == 130 and "r.csv: 1 place" in done.output and "the same command" in done.output
    assert len(from_csv(out)) == 1
    missing = CliRunner().invoke(app, [*words, f"{tmp_path / 'none'},json"], input="q\n")
    assert isinstance(missing.exception, DeviceError)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lines", "r.csv", "r.mcap"]
