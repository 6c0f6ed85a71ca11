"""A vehicle's stored fence is changed only when the mission file asks, is reported before, and is given back."""

import asyncio
import json
from pathlib import Path

import pytest

from fieldkit import jumploop
from fieldkit.errors import DeviceTimeout, VehicleRefused
from fieldkit.jumploop import LoopClock
from fieldkit.ports import StoredFence
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from fieldkit.world.bodies import Rover
from fieldkit.world.fakes import FakeFleet, FakeReceiver
from mission.core.mission_file import Mission, read_mission
from mission.lab.synthetic import small_mission
from mission.shell.preflight import preflight
from mission.shell.runner import Runner
from mission.shell.setups import Setup, start_places
from mission.shell.vehicle_fences import HELD_BEFORE, VehicleFences

OWN = StoredFence("r1", 1.0, ((5001.0, 1.0, 2.0, 0.0, 3.0, 0.0, 0.0, 0.0),) * 3)


def mission_with(folder: Path, asked: bool) -> Mission:
    plain = small_mission(folder, duration_s=5.0)
    text = plain.text.replace("[safety]", f"[safety]\nvehicle_fence = {str(asked).lower()}\n", 1)
    (folder / "mission.toml").write_text(text)
    return read_mission(folder / "mission.toml")


def setup_of(mission: Mission, fleet: type[FakeFleet] = FakeFleet) -> Setup:
    clock = LoopClock(1_000 * 10**9)
    vehicles = fleet({name: Rover(*place) for name, place in start_places(mission).items()}, clock)
    vehicles.fences["r1"] = OWN
    return Setup(
        clock, tuple(FakeReceiver(name, clock) for name in mission.kernel.engine.robots), (vehicles,)
    )


def fly(folder: Path, mission: Mission, setup: Setup) -> list[str]:
    """The mission; what its recording notes."""
    log = folder / "mission.mcap"
    with RecordingWriter(log, mission_toml=mission.text, antenna_toml=mission.antenna_text) as recorder:
        jumploop.run(Runner(mission, setup, recorder).run())
    return [note.text for _, note in open_recording(log).notes()]


def test_a_mission_gives_every_vehicle_its_own_fence_back(tmp_path: Path) -> None:
    put: list[str] = []

    class Watched(FakeFleet):
        async def put_fence(self, robot, corners_m):  # type: ignore[no-untyped-def]
            put.append(robot)
            return await super().put_fence(robot, corners_m)

    mission = mission_with(tmp_path, True)
    setup = setup_of(mission, Watched)
    notes = fly(tmp_path, mission, setup)
    assert sorted(put) == ["r1", "r2", "r3", "r4"]
    assert setup.links[0].fences["r1"] == OWN  # type: ignore[attr-defined]
    (told,) = [note for note in notes if note.startswith("r1: the fence it held before: ")]
    held = json.loads(told.split(": ", 2)[2])
    assert held["enabled"] == 1.0 and len(held["items"]) == 3


def test_nobodys_fence_is_touched_unasked(tmp_path: Path) -> None:
    class Untouchable(FakeFleet):
        async def put_fence(self, robot, corners_m):  # type: ignore[no-untyped-def]
            raise AssertionError("nobody asked for that")

    mission = mission_with(tmp_path, False)
    fly(tmp_path, mission, setup_of(mission, Untouchable))


def test_preflight_gives_it_back_as_well(tmp_path: Path) -> None:
    mission = mission_with(tmp_path, True)
    setup = setup_of(mission)
    checks = jumploop.run(preflight(mission, setup, tmp_path, 5.0))
    assert setup.links[0].fences["r1"] == OWN  # type: ignore[attr-defined]
    assert not [check for check in checks if check.name == "fence" and check.level == "red"]


def test_a_fence_that_cannot_be_put_keeps_the_mission_from_starting(tmp_path: Path) -> None:
    class Full(FakeFleet):
        async def put_fence(self, robot, corners_m):  # type: ignore[no-untyped-def]
            if robot == "r3":
                raise DeviceTimeout("r3: does not answer")
            return await super().put_fence(robot, corners_m)

    mission = mission_with(tmp_path, True)
    setup = setup_of(mission, Full)
    with pytest.raises(VehicleRefused, match="r3: fence: r3: does not answer"):
        fly(tmp_path, mission, setup)
    assert setup.links[0].fences["r1"] == OWN  # type: ignore[attr-defined]


def test_one_that_cannot_be_given_back_is_named_with_what_it_held(tmp_path: Path) -> None:
    class Deaf(FakeFleet):
        async def restore_fence(self, stored):  # type: ignore[no-untyped-def]
            await asyncio.sleep(0)
            raise DeviceTimeout(f"{stored.robot}: does not answer")

    mission = mission_with(tmp_path, True)
    notes = fly(tmp_path, mission, setup_of(mission, Deaf))
    (told,) = [note for note in notes if note.startswith("r1: its own fence was not put back")]
    assert "5001" in told


def test_what_was_there_is_noted_before_it_is_replaced(tmp_path: Path) -> None:
    """A kill between the two must not lose it."""
    mission = mission_with(tmp_path, True)
    notes: list[str] = []

    class Cut(FakeFleet):
        async def put_fence(self, robot, corners_m):  # type: ignore[no-untyped-def]
            assert any(note.startswith(f"{robot}: {HELD_BEFORE}") for note in notes)
            await super().put_fence(robot, corners_m)

    setup = setup_of(mission, Cut)
    fences = VehicleFences(mission, {"r1": setup.links[0]}, lambda _, text: notes.append(text))
    assert jumploop.run(fences.put(["r1"])) == []


def test_after_a_kill_the_fence_that_was_there_before_the_mission_is_put_back(tmp_path: Path) -> None:
    mission = mission_with(tmp_path, True)
    setup = setup_of(mission)
    fleet, notes = setup.links[0], []
    links = {"r1": fleet, "r2": fleet}
    killed = VehicleFences(mission, links, lambda _, text: notes.append(text))
    jumploop.run(killed.put(["r1"]))  # and never restored
    resumed = VehicleFences(mission, links, lambda _, text: notes.append(text))
    resumed.remember([*notes, "r2: something else", "r9: the fence it held before: {}"])
    jumploop.run(resumed.put(["r1", "r2"]))
    assert fleet.fences["r1"] != OWN  # type: ignore[attr-defined]
    jumploop.run(resumed.restore())
    assert fleet.fences["r1"] == OWN  # type: ignore[attr-defined]
