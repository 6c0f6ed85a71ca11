"""Before the start: what is wrong is red or amber with a remedy, and keeps the mission from moving anything."""

import asyncio
from dataclasses import replace
from pathlib import Path

import pytest

from fieldkit.channel.antenna_file import AntennaFile, Receiver
from fieldkit.channel.spread import ChannelSpread
from fieldkit.checks import Check, worst
from fieldkit.clock import ScaledClock
from fieldkit.errors import DeviceError, VehicleRefused
from fieldkit.messages import GoTo, Pose
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from fieldkit.world.sources import TransientSource
from mission.lab.synthetic import ANTENNA, small_mission
from mission.shell import setups
from mission.shell.preflight import Heard, judge_calibration, judge_gaps, judge_places, preflight
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places


class Careless(FakeFleet):
    """Vehicles that would drive on."""

    async def inspect(self, robot, demands=None):  # type: ignore[no-untyped-def]
        return [Check(robot, "failsafe", "red", "FS_GCS_ENABLE is 0: drives on", "set FS_GCS_ENABLE 1")]


def setup_of(mission, fleet=FakeFleet) -> Setup:  # type: ignore[no-untyped-def]
    clock = ScaledClock(20.0)
    rovers = {name: Rover(*place) for name, place in start_places(mission).items()}
    return Setup(clock, (), (fleet(rovers, clock),))


def run(folder: Path, fleet, override: str = "") -> FakeFleet:  # type: ignore[no-untyped-def]
    mission = small_mission(folder, duration_s=5.0)
    setup = setup_of(mission, fleet)
    with RecordingWriter(folder / "mission.mcap", mission_toml=mission.text) as recorder:
        asyncio.run(Runner(mission, setup, recorder, override=override).run())
    return setup.links[0]  # type: ignore[return-value]


def test_vehicles_without_failsafes_do_not_start(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(VehicleRefused, match=r"FS_GCS_ENABLE is 0.*\n.*--override"):
        run(tmp_path, Careless)
    recording = open_recording(tmp_path / "mission.mcap")
    assert not list(recording.commands())
    assert "FS_GCS_ENABLE" not in caplog.text, "said twice"


def test_a_typed_reason_overrides_and_is_recorded(tmp_path: Path) -> None:
    fleet = run(tmp_path, Careless, override="tethered on the bench")
    assert set(fleet._mode.values()) == {"hold"}
    notes = [note.text for _, note in open_recording(tmp_path / "mission.mcap").notes()]
    assert "started in spite of red checks: tethered on the bench" in notes
    assert any("FS_GCS_ENABLE is 0" in note for note in notes)


def test_a_mission_file_of_another_field_does_not_start(tmp_path: Path) -> None:
    class Elsewhere(FakeFleet):
        def __init__(self, rovers, clock) -> None:  # type: ignore[no-untyped-def]
            super().__init__({name: Rover(5000.0, 0.0) for name in rovers}, clock)

    with pytest.raises(VehicleRefused, match="another field"):
        run(tmp_path, Elsewhere)
    assert not [c for *_, c in open_recording(tmp_path / "mission.mcap").commands() if isinstance(c, GoTo)]


def test_a_fence_that_leaves_a_vehicle_out_does_not_start(tmp_path: Path) -> None:
    class Behind(FakeFleet):
        def __init__(self, rovers, clock) -> None:  # type: ignore[no-untyped-def]
            super().__init__(rovers | {"r3": Rover(5.0, -2.5)}, clock)

    with pytest.raises(VehicleRefused, match=r"r3: place: 2\.\d m outside the fence; carry it"):
        run(tmp_path, Behind)
    assert not list(open_recording(tmp_path / "mission.mcap").commands())


def test_places_are_judged(tmp_path: Path) -> None:
    mission = small_mission(tmp_path)
    poses = {"r1": Pose(0, "r1", 5.0, 4.0), "r2": Pose(0, "r2", 5.1, 4.0), "r3": Pose(0, "r3", -0.9, 5.0)}
    checks = {check.robot: check for check in judge_places(mission, poses)}
    assert {robot: check.level for robot, check in checks.items()} == {
        "r1": "amber",
        "r2": "amber",
        "r3": "amber",
        "r4": "red",
    }
    beyond = judge_places(mission, {"r3": Pose(0, "r3", -3.0, 5.0)})
    unsure = judge_places(mission, {"r3": Pose(0, "r3", -3.0, 5.0, sigma_m=1.0)})
    assert [check.level for check in (*beyond, *unsure) if check.robot == "r3"] == ["red", "amber"]
    assert "0.9 m outside" in checks["r3"].found and "from r2" in checks["r1"].found


def test_an_old_or_doubtful_calibration_is_amber(tmp_path: Path) -> None:
    spread = ChannelSpread(2.0, 2.6, 1.0)  # place noise that is only assumed is amber too
    alike = {robot: Receiver(0.0) for robot in ("r1", "r2", "r3", "r4")}
    mission = small_mission(tmp_path, antenna=AntennaFile(ANTENNA, spread=spread, receivers=alike))
    now_ns = ScaledClock(1.0).now_ns()
    assert worst(judge_calibration(mission, now_ns)) == "green"
    assert worst(judge_calibration(mission, now_ns + 100 * 86_400 * 10**9)) == "amber"
    inconsistent = replace(mission, antenna=replace(mission.antenna, verdict="accepted with warnings"))
    assert worst(judge_calibration(inconsistent, now_ns)) == "amber"


def test_receivers_that_nobody_compared_are_named(tmp_path: Path) -> None:
    spread = ChannelSpread(2.0, 2.6, 1.0)
    some = {robot: Receiver(0.0) for robot in ("r1", "r3")}
    mission = small_mission(tmp_path, antenna=AntennaFile(ANTENNA, spread=spread, receivers=some))
    (said,) = [check for check in judge_calibration(mission, 0) if check.name == "receivers"]
    assert said.level == "amber" and said.found.startswith("not compared: r2, r4.") and "2 dB" in said.found
    compared = {robot: Receiver(0.0) for robot in ("r1", "r2", "r3", "r4")}
    mission = small_mission(tmp_path / "all", antenna=AntennaFile(ANTENNA, spread=spread, receivers=compared))
    assert not [check for check in judge_calibration(mission, 0) if check.name == "receivers"]


def test_positions_too_coarse_for_what_is_asked_are_amber(tmp_path: Path) -> None:
    mission = small_mission(tmp_path, engine={"found_within_m": 0.5})
    assert not [check for check in judge_calibration(mission, 0) if check.name == "positions"]
    coarse = replace(mission.kernel.engine, pose_sigma_m=2.0)
    unsure = replace(mission, kernel=replace(mission.kernel, engine=coarse))
    (said,) = [check for check in judge_calibration(unsure, 0) if check.name == "positions"]
    assert said.level == "amber" and "known to 2 m, and a find is asked for within 0.5 m" in said.found


def test_positions_too_rare_to_be_bridged_are_amber(tmp_path: Path) -> None:
    mission, heard = small_mission(tmp_path), Heard()
    for k in range(20):
        heard.place(Pose(round(k * 1e9), "r1", 1.0, 1.0))
        heard.place(Pose(round(k * 2e8), "r2", 2.0, 1.0))
    (said,) = judge_gaps(mission, heard.gaps_s)
    assert (said.robot, said.level) == ("r1", "amber") and "one in 1.0 s" in said.found
    assert "max_pose_gap_s to 5" in said.remedy
    patient = replace(mission, kernel=replace(mission.kernel, max_pose_gap_s=5.0))
    assert not judge_gaps(patient, heard.gaps_s)


def test_a_missing_radio_is_red_and_the_rest_is_checked_all_the_same(tmp_path: Path) -> None:
    class Missing(FakeReceiver):
        async def __aenter__(self):  # type: ignore[no-untyped-def]
            raise DeviceError("XBee of r1: /dev/ttyUSB0: no such port")

    mission = small_mission(tmp_path)
    setup = setup_of(mission)
    setup = replace(setup, receivers=(Missing("r1", setup.clock), FakeReceiver("r2", setup.clock)))
    checks = asyncio.run(preflight(mission, setup, tmp_path, 5.0))
    found = {(check.robot, check.name): check for check in checks}
    assert found["r1", "radio"].level == "red" and "ttyUSB0" in found["r1", "radio"].found
    assert found["r2", "radio"].level == "amber" and "transmitter" in found["r2", "radio"].remedy
    assert found["r4", "failsafe"].level == "green"
    assert setup.links[0].beats >= 4, "a copter that hears no ground station does not arm"  # type: ignore[attr-defined]
    assert found["mission", "disk"].level in ("green", "amber", "red")


def test_an_emulated_field_passes_on_its_wires(tmp_path: Path) -> None:
    mission = small_mission(tmp_path)
    sources = (TransientSource(3.0, 2.0, 0.0, 1.0), TransientSource(7.0, 2.0, 0.0, 1.0))
    with setups.emulated(mission, sources, seed=1, rate=5.0) as setup:
        checks = asyncio.run(preflight(mission, setup, tmp_path, 15.0))
    red = [check for check in checks if check.level == "red" and check.name != "disk"]
    assert not red
    names = {check.name for check in checks}
    assert names >= {
        "radio",
        "failsafe",
        "fence action",
        "battery failsafe",
        "speed",
        "clock",
        "position",
        "EKF",
        "battery",
        "link",
        "place",
        "CPU",
    }
    heard = [check for check in checks if check.name == "radio" and check.level == "green"]
    assert heard and "dBm" in heard[0].found
