"""The fences that a mission puts into its vehicles, where its file asks for that, and what they held before.

What was there is told to `note` before it is replaced, and put back by `restore`: nobody's own fence is gone.
"""

import asyncio
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field

from fieldkit.checks import Check
from fieldkit.errors import DeviceError
from fieldkit.ports import Demands, StoredFence, VehicleLink
from mission.core.mission_file import Mission

Note = Callable[[str, str], None]
"""Level and text."""


def demands_of(mission: Mission) -> Demands:
    """What the vehicles are judged by."""
    corners = tuple(mission.vehicle_fence_m)
    return Demands(mission.safety.max_speed_m_s, corners, bool(corners), tuple(mission.fence_m))


@dataclass
class VehicleFences:
    """Puts fences into vehicles and takes them out again. `link_of` maps robots to their links."""

    mission: Mission
    link_of: Mapping[str, VehicleLink]
    note: Note
    _stored: list[StoredFence] = field(default_factory=list)

    async def put(self, robots: Sequence[str]) -> list[Check]:
        """Each robot's fence, all at once; nothing where the mission file does not ask for it. Red where one failed."""
        corners = self.mission.vehicle_fence_m
        if not corners:
            return []

        async def put(robot: str) -> Check | None:
            try:
                stored = await self.link_of[robot].put_fence(robot, corners)
            except DeviceError as error:
                return Check(
                    robot, "fence", "red", str(error), "try again; is another ground station uploading?"
                )
            self.note("info", f"{robot}: the fence it held before: {json.dumps(asdict(stored))}")
            self._stored.append(stored)
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
