"""The fences that a mission puts into its vehicles, where its file asks for that, and what they held before.

What was there is given to `note` before it is replaced, and put back by `restore`: nobody's own fence is gone. A
mission that goes on after a kill `remember`s what the notes say, since what the vehicle holds by then is the mission's.
"""

import asyncio
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from fieldkit.checks import Check
from fieldkit.errors import DeviceError
from fieldkit.ports import Demands, StoredFence, VehicleLink
from mission.core.mission_file import Mission

HELD_BEFORE = "the fence it held before: "
"""Begins a note, after the robot's name; what follows is a `StoredFence` in JSON."""
Note = Callable[[str, str], None]
"""Level and text."""


def demands_of(mission: Mission) -> Demands:
    """What the vehicles are judged by."""
    corners = tuple(mission.vehicle_fence_m)
    turns_in_m = mission.safety.turn_radius_m if len(mission.safety.robots) > 1 else None
    return Demands(mission.safety.max_speed_m_s, corners, bool(corners), tuple(mission.fence_m), turns_in_m)


@dataclass
class VehicleFences:
    """Puts fences into vehicles and takes them out again. `link_of` maps robots to their links."""

    mission: Mission
    link_of: Mapping[str, VehicleLink]
    note: Note
    _stored: list[StoredFence] = field(default_factory=list)
    _before: dict[str, StoredFence] = field(default_factory=dict)
    """What vehicles held before an interrupted mission."""

    def remember(self, texts: Iterable[str]) -> None:
        """Take up what the notes of an interrupted mission say of fences. The first of a robot counts."""
        for text in texts:
            robot, found, held = text.partition(f": {HELD_BEFORE}")
            if found and robot in self.link_of and robot not in self._before:
                row = json.loads(held)
                items = tuple(tuple(float(value) for value in item) for item in row["items"])
                self._before[robot] = StoredFence(robot, row["enabled"], items)

    async def put(self, robots: Sequence[str]) -> list[Check]:
        """Each robot's fence, all at once; nothing where the mission file does not ask for it. Red where one failed."""
        corners = self.mission.vehicle_fence_m
        if not corners:
            return []

        async def put(robot: str) -> Check | None:
            try:
                link = self.link_of[robot]
                stored = self._before.get(robot) or await link.stored_fence(robot)
                self.note("info", f"{robot}: {HELD_BEFORE}{json.dumps(asdict(stored))}")
                self._stored.append(stored)
                await link.put_fence(robot, corners)
            except DeviceError as error:
                return Check(
                    robot, "fence", "red", str(error), "try again; is another ground station uploading?"
                )
            return None

        return [
            check for check in await asyncio.gather(*(put(robot) for robot in robots)) if check is not None
        ]

    async def restore(self) -> None:
        """Put back what was there; one that cannot be is named, with what it held."""
        stored, self._stored = self._stored, []

        async def restore(each: StoredFence) -> None:
            try:
                await self.link_of[each.robot].restore_fence(each)
            except DeviceError as error:
                held = json.dumps(asdict(each))
                self.note("error", f"{each.robot}: its own fence was not put back ({error}); it was {held}")

        await asyncio.gather(*(restore(each) for each in stored))
