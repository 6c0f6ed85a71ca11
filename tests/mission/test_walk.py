"""People in missions: advice, what safety asks of them, and a whole walk on emulated devices."""

import asyncio
import math
import re
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from typer.testing import CliRunner

from fieldkit.channel.antenna_file import dump_antenna
from fieldkit.cli import build
from fieldkit.clock import RealClock, VirtualClock
from fieldkit.errors import ConfigError
from fieldkit.messages import (
    Event,
    GoTo,
    Hold,
    Operator,
    Pose,
    ReceiverState,
    RssReading,
    Tick,
    VehicleState,
    Waypoint,
)
from fieldkit.ports import PositionSource, Receiver
from fieldkit.receiver_file import receiver_of
from fieldkit.settings import WALKER
from fieldkit.world.walker import Walker, WanderingError, body_loss_db
from mission.core.advice import advise
from mission.core.kernel import Kernel
from mission.core.mission_file import Mission, mission_of, parse_mission
from mission.core.tables import FieldTable
from mission.core.walk_text import WalkOptions, walk_text
from mission.lab.study.walk import GUIDES, Job, _lanes, summary, trial, walk_mission
from mission.lab.synthetic import small_mission
from mission.lab.walk_demo import believed
from mission.page.commands import checked_command
from mission.page.serve import LivePage
from mission.safety.rules import Safety
from mission.shell.intake import streams_of
from mission.shell.runner import Runner
from mission.shell.setups import live
from mission.shell.start import _not_heard

S = 10**9
DEVICES = ["walk", "--receiver", "x,rylr", "--gnss", "/dev/none", "--antenna", "antenna.toml"]


# -- safety ----------------------------------------------------------------------------------------------------


def people(folder: Path, *names: str) -> Safety:
    """A mission of robots r1 to r4 of which these are people."""
    return Safety(replace(small_mission(folder, duration_s=5.0).safety, on_foot=frozenset(names)))


def placed(safety: Safety, robot: str, east_m: float, north_m: float, t_s: float) -> None:
    safety.observe(VehicleState(round(t_s * S), robot, "guided", True))
    safety.observe(Pose(round(t_s * S), robot, east_m, north_m, sigma_m=0.1))


def test_a_person_who_stands_is_not_stuck_and_a_robot_is(tmp_path: Path) -> None:
    held = {}
    for who in ((), ("r1",)):
        safety = people(tmp_path, *who)
        said = []
        for k in range(120):
            placed(safety, "r1", 2.0, 2.0, 0.5 * k)
            said += safety.observe(Tick(round(0.5 * k * S)))
            if k == 1:
                assert isinstance(safety.allow(GoTo(S, "r1", Waypoint(8.0, 8.0, 0.4))), GoTo)
        held[who] = [command for command in said if isinstance(command, Hold)]
    assert held[()] and not held[("r1",)]


def test_people_may_come_near_each_other_and_robots_keep_away_from_them(tmp_path: Path) -> None:
    safety = people(tmp_path, "r1", "r2")
    for robot, east_m in (("r1", 2.0), ("r2", 2.6), ("r3", 5.0), ("r4", 9.0)):
        placed(safety, robot, east_m, 2.0, 1.0)
    safety.observe(Tick(S))
    assert isinstance(safety.allow(GoTo(S, "r1", Waypoint(2.6, 2.0, 1.0))), GoTo)
    refused = safety.allow(GoTo(S, "r3", Waypoint(2.6, 2.0, 0.4)))
    assert isinstance(refused, Hold) and "r" in refused.reason


def test_whoever_drives_near_a_person_stops_though_it_was_named_first(tmp_path: Path) -> None:
    safety = people(tmp_path, "r4")
    held = []
    for k in range(40):
        t_s = 0.25 * k
        placed(safety, "r1", 2.0 + 0.1 * k, 2.0, t_s)
        placed(safety, "r4", 6.0 - 0.1 * k, 2.0, t_s)
        if k == 1:
            safety.allow(GoTo(round(t_s * S), "r1", Waypoint(4.0, 2.0, 0.4)))
            safety.allow(GoTo(round(t_s * S), "r4", Waypoint(2.0, 2.0, 0.4)))
        held += [command for command in safety.observe(Tick(round(t_s * S))) if isinstance(command, Hold)]
    assert {command.robot for command in held} == {"r1"}


def test_a_person_whose_position_was_lost_goes_on_when_it_is_back(tmp_path: Path) -> None:
    said = {}
    for who in ((), ("r1",)):
        safety = people(tmp_path, *who)
        placed(safety, "r1", 2.0, 2.0, 0.0)
        commands = [c for k in range(300) for c in safety.observe(Tick(round(0.5 * k * S)))]
        said[who] = {type(command).__name__ for command in commands}
        placed(safety, "r1", 2.0, 2.0, 150.0)
        safety.observe(Tick(150 * S))
    assert "CallOperator" in said[()] and "CallOperator" not in said[("r1",)]
    assert isinstance(safety.allow(GoTo(150 * S, "r1", Waypoint(4.0, 2.0, 0.4))), GoTo)


def test_a_mark_is_a_persons_word_and_changes_nothing_else(tmp_path: Path) -> None:
    kernel = Kernel(small_mission(tmp_path, duration_s=5.0).kernel)
    unknown = kernel.step(Operator(S, "mark", "r1"))
    assert unknown.notes == ("operator: mark r1: where that is, is not known",)
    kernel.step(Pose(S, "r1", 2.0, 3.0))
    before = kernel.digest()
    marked = kernel.step(Operator(2 * S, "mark", "r1"))
    assert marked.notes == ("r1 says: a transmitter is here, at 2.0 m east, 3.0 m north",)
    assert not marked.commands and kernel.digest() == before


def test_a_bearing_taken_is_written_down_as_a_persons_word_and_changes_nothing_else(tmp_path: Path) -> None:
    kernel = Kernel(small_mission(tmp_path, duration_s=5.0).kernel)
    kernel.step(Pose(S, "r1", 2.0, 3.0))
    before = kernel.digest()
    command = checked_command(
        {"action": "bearing", "robot": "r1", "bearing_deg": 123.4, "error_90_deg": 14.0, "swing_db": 9.0}
    )
    assert isinstance(command, dict)
    taken = kernel.step(Operator(2 * S, **command))
    assert taken.notes == (
        "r1 says: bearing 123 degrees, off by 14 at most (90 %), 9 dB between front and back, "
        "taken at 2.0 m east, 3.0 m north",
    )
    assert not taken.commands and kernel.digest() == before
    assert isinstance(checked_command({"action": "bearing", "robot": "r1", "bearing_deg": "<b>"}), str)


async def test_nobody_says_here_while_the_last_position_is_old(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, duration_s=5.0)
    clock, said = VirtualClock(), list[Event]()
    runner = SimpleNamespace(
        mission=mission, kernel=Kernel(mission.kernel), safety=Safety(mission.safety), put=said.append,
        setup=SimpleNamespace(clock=clock), recorder=SimpleNamespace(path=tmp_path),
    )  # fmt: skip
    page = LivePage(mission, "127.0.0.1", 0)
    page.attach(cast(Runner, runner))
    assert "not known yet" in page._command({"action": "mark", "robot": "r1"})
    runner.kernel.step(Pose(S, "r1", 2.0, 3.0))
    clock.advance_to(2 * S)
    assert page._command({"action": "mark", "robot": "r1"}) == ""
    clock.advance_to(61 * S)
    assert "r1 is 60 s old" in page._command({"action": "mark", "robot": "r1"})
    await asyncio.sleep(0)
    assert [event.action for event in said if isinstance(event, Operator)] == ["mark"]


# -- the world -------------------------------------------------------------------------------------------------


def test_a_walker_goes_where_it_is_told_or_for_one_hint_somewhere_else() -> None:
    obeys = Walker(0.0, 0.0, np.random.default_rng(1), ignores=0.0)
    obeys.advise((12.0, 0.0))
    for _ in range(100):
        obeys.step(0.5)
    assert math.dist((obeys.east_m, obeys.north_m), (12.0, 0.0)) <= 1.0
    rng = np.random.default_rng(2)
    went = []
    for _ in range(300):
        walker = Walker(50.0, 50.0, rng, size_m=(100.0, 100.0))
        walker.advise((60.0, 50.0))
        for _ in range(4):
            walker.step(1.0)
        assert 0.0 <= walker.east_m <= 100.0 and 0.0 <= walker.north_m <= 100.0
        went.append(walker.east_m > 54.0 and abs(walker.north_m - 50.0) < 0.5)
    assert 0.6 < np.mean(went) < 0.75


def test_a_body_takes_nothing_in_front_and_all_behind() -> None:
    assert body_loss_db(np.array([0.0, 90.0, 180.0, -90.0]), 8.0) == pytest.approx([0.0, 4.0, 8.0, 4.0])


def test_a_wandering_error_has_its_deviation_and_lasts() -> None:
    error = WanderingError(3.0, 60.0, np.random.default_rng(3))
    track = []
    for _ in range(20_000):
        error.step(1.0)
        track.append(error.off_m.copy())
    path = np.array(track)
    assert path.std(axis=0) == pytest.approx([3.0, 3.0], rel=0.2)
    minute = np.mean(path[60:] * path[:-60], axis=0) / path.var(axis=0)
    assert minute == pytest.approx([math.exp(-1.0)] * 2, abs=0.15)


# -- the walk --------------------------------------------------------------------------------------------------


def test_the_file_of_a_walk_is_a_mission_with_a_person() -> None:
    options = WalkOptions({"driver": "lines", "port": "-", "map": "rylr"}, "/dev/x", "a.toml", (47.0, 8.0))
    file = parse_mission(walk_text(options), "walk")
    assert [robot.on_foot for robot in file.robot] == [True]
    assert file.positions[0].driver == "gnss"
    mission = walk_mission(3)
    assert mission.safety.on_foot == {WALKER}
    assert mission.kernel.max_pose_gap_s >= 2.0, "a satellite receiver gives one position a second"


def test_a_radio_with_a_map_of_its_own_is_walked_with_from_a_file(tmp_path: Path) -> None:
    radio = tmp_path / "radio.toml"
    radio.write_text('port = "-"\nformat = "regex"\npattern = \'S=(?P<rss>\\d+)\'\nunit = "-dBm"\n')
    table = receiver_of(str(radio))
    text = walk_text(WalkOptions(table, "/dev/x", "a.toml", (47.0, 8.0)))
    receiver = parse_mission(text, "walk").robot[0].receiver
    assert (receiver.driver, (receiver.model_extra or {})["pattern"]) == ("lines", r"S=(?P<rss>\d+)")
    assert receiver_of("/dev/x,rylr") == {"driver": "lines", "port": "/dev/x", "map": "rylr"}
    for wrong, says in (("no.toml", "cannot be read"), (str(tmp_path / "empty.toml"), "at least 'port'")):
        (tmp_path / "empty.toml").touch()
        with pytest.raises(ConfigError, match=says):
            receiver_of(wrong)


async def test_a_height_above_the_sea_is_none_above_the_ground_for_those_who_walk() -> None:
    class Satellites:
        robots = ("ada", "copter")

        async def poses(self) -> AsyncIterator[Pose]:
            for robot in self.robots:
                yield Pose(S, robot, 1.0, 2.0, 545.0, sigma_m=3.0, origin="gnss")

    source = cast(PositionSource, Satellites())
    (stream,) = streams_of((), (), (source,), RealClock(), lambda *_: None, flying=("copter",))
    assert [(event.robot, event.up_m) async for event in stream[1] if isinstance(event, Pose)] == [
        ("ada", 0.0),
        ("copter", 545.0),
    ]


async def test_why_a_radio_is_down_is_said_once_for_each_reason(caplog: pytest.LogCaptureFixture) -> None:
    class Radio:
        robot = "ada"

        async def readings(self) -> AsyncIterator[RssReading | ReceiverState]:
            for up, reason in ((True, "opened"), (False, "no line for 5 s"), (True, "lines come again"),
                               (False, "no line for 6 s"), (False, "its lines are no readings: 'S=7'")):  # fmt: skip
                yield ReceiverState(S, self.robot, up, reason)

    notes: list[str] = []
    radio = cast(Receiver, Radio())
    (stream,) = streams_of((radio,), (), (), RealClock(), lambda level, text: notes.append(text))
    assert len([event async for event in stream[1]]) == 5
    assert notes == ["ada: radio down: no line for 5 s", "ada: radio down: its lines are no readings: 'S=7'"]
    assert [record.getMessage() for record in caplog.records] == notes


def test_a_drone_placed_by_satellites_needs_to_know_how_high_its_field_lies() -> None:
    walk = walk_mission(3)
    flown = replace(walk, safety=replace(walk.safety, altitude_m={WALKER: 10.0}))
    high = replace(flown, file=flown.file.model_copy(update={"field": at_500_m(flown)}))
    for mission, warned in ((walk, False), (flown, True), (high, False)):
        assert any("origin_alt_m is 0" in note for note in advise(mission)) == warned


def at_500_m(mission: Mission) -> FieldTable:
    return mission.file.field.model_copy(update={"origin_alt_m": 500.0})


def test_a_satellite_receiver_and_short_gaps_are_advised_against() -> None:
    mission = walk_mission(3)
    assert not any("max_pose_gap_s" in note for note in advise(mission))
    short = replace(mission, kernel=replace(mission.kernel, max_pose_gap_s=1.0))
    assert any("max_pose_gap_s of 1 s bridges no gap" in note for note in advise(short))


@pytest.mark.parametrize("rate", [1.0, 20.0, 40.0])
def test_a_walk_on_a_fast_clock_stays_within_the_limits_of_a_mission(rate: float) -> None:
    options = WalkOptions(
        {"driver": "lines", "port": "-", "map": "rylr"}, "/dev/x", "a.toml", (47.0, 8.0), rate=rate
    )
    assert parse_mission(walk_text(options), "walk").safety.overrun_s >= min(60.0, 3.0 * rate)


def test_lanes_cover_the_field() -> None:
    corners = np.array(_lanes())
    assert corners.min() >= 0.0 and corners.max() <= 300.0
    assert len({east for east, _ in _lanes()}) == 3


def test_advice_finds_a_transmitter_in_a_quarter_of_an_hour_or_so() -> None:
    """One walk of the study; its page has fifty."""
    row = trial(Job(0, 3, "advice"))
    assert row["found_s"] is not None and row["found_s"] < 1500.0
    assert row["off_m"] < 20.0 and row["false"] == 0


def test_a_walk_that_found_nothing_counts_as_longer_than_all_others() -> None:
    found = {"found_s": 100.0, "off_m": 2.0, "false": 0}
    rows = [found, found | {"found_s": 300.0, "off_m": 12.0}, found | {"found_s": None, "off_m": None}]
    told = summary(rows)
    assert (told["n"], told["found"], told["median_s"], told["p90_s"]) == (3, 2, 300.0, None)
    assert told["within_10_m"] == 1
    assert GUIDES[0] == "advice"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["walk"], "missing: --receiver, --gnss, --antenna"),
        (["walk", "--receiver", "x,rylr", "--gnss", "/dev/none"], "missing: --antenna"),
        (
            ["walk", "--receiver", "x,rylr", "--gnss", "/dev/none", "--antenna", "none.toml"],
            "--antenna none.toml: cannot be read",
        ),
        (
            ["walk", "--receiver", "x,rylr", "--gnss", "/dev/none", "--antenna", "."],
            "--antenna .: cannot be read: it is a folder",
        ),
        ([*DEVICES, "--background", "none.png"], "--background none.png: no such file"),
        ([*DEVICES, "--background", "antenna.toml"], "--background antenna.toml: expected .mbtiles or a"),
        ([*DEVICES, "--page-host", "no.such.host.invalid"], "expected an address of this computer, or"),
        ([*DEVICES, "--page-host", "192.0.2.1"], "expected an address of this computer, or"),
        ([*DEVICES, "--out", "antenna.toml/a"], "--out antenna.toml/a: cannot make a folder there: "),
        ([*DEVICES, "--receiver", "x,nobody"], "(lines): option 'map': expected one of json"),
        ([*DEVICES, "--receiver", ",rylr"], "--receiver ,rylr: expected a port, as in"),
        ([*DEVICES, "--cot", "nonsense"], "maps.cot: expected udp://HOST:PORT"),
        ([*DEVICES, "--name", ""], "--name: expected what to call whoever walks, got ''; or leave it out"),
        (
            [*DEVICES, "--gnss", "foo://x"],
            "foo://x: there are no foo:// addresses; expected gpsd://HOST[:PORT], or",
        ),
        (
            [*DEVICES, "--receiver", "foo://x,rylr"],
            "foo://x: there are no foo:// addresses; a port may be a serial",
        ),
        (
            ["walk", "m.toml", "--receiver", "x,rylr"],
            "--receiver: with a mission file that is [[robot]] receiver in",
        ),
        (["walk", "m.toml", "--size-m", "300"], "--size-m: with a mission file that is [field] size_east_m"),
        (DEVICES, "lines of walker: no device at x; "),
        (["demo", "--walk", "smoke"], "--walk: expected one of ble, wifi, lora"),
        (["demo", "--walk", "xbee", "--drone"], "--walk and --drone are two demos"),
    ],
)
def test_what_is_missing_for_a_walk_is_said(
    arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before anybody waits for a position: there is no satellite receiver at all."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "antenna.toml").write_text(dump_antenna(believed()))
    result = CliRunner().invoke(
        build(),
        [
            *arguments,
            *(() if "--out" in arguments else ("--out", "runs")),
            *(() if "--page-host" in arguments else ("--no-page",)),
        ],
    )
    assert result.exit_code != 0
    assert says in " ".join((result.output + str(result.exception)).split())
    assert "demo" in arguments or not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            'walker = "/dev/x"',
            'wlaker = "/dev/x"',
            "robots.wlaker: there is no such robot; robots are: walker",
        ),
        (
            'walker = "/dev/x"',
            'walker = "/dev/radio"',
            "/dev/radio is the port of robot 'walker''s radio already",
        ),
        (
            '[[positions]]\ndriver = "gnss"\n\n[positions.robots]\nwalker = "/dev/x"\n',
            "",
            "robot 'walker': nothing says where this person is; add [[positions]]",
        ),
    ],
)
def test_a_walk_says_which_of_its_devices_is_not_as_it_should_be(
    old: str, new: str, says: str, tmp_path: Path
) -> None:
    (tmp_path / "antenna.toml").write_text(dump_antenna(believed()))
    radio = {"driver": "lines", "port": "/dev/radio", "map": "rylr"}
    text = walk_text(WalkOptions(radio, "/dev/x", "antenna.toml", (47.0, 8.0)))
    assert old in text
    with pytest.raises(ConfigError, match=re.escape(says)):
        live(mission_of(text.replace(old, new), tmp_path / "mission.toml"))


def test_of_a_person_who_is_not_there_no_vehicle_is_asked_for() -> None:
    assert _not_heard(["ada"], {"ada"}) == (
        "no position of ada in 60 s: is the satellite receiver on, and where the sky is free?"
    )
    both = _not_heard(["r1", "ada"], {"ada"})
    assert both.startswith("no telemetry from r1 in 60 s") and "no position of ada" in both
