"""The start of a mission: every vehicle heard, judged fit, and made ours. Nothing moves before that."""

import asyncio
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass

from fieldkit.clock import Clock
from fieldkit.errors import DeviceError, DeviceTimeout, VehicleRefused
from mission.core.fleet import Robot
from mission.core.mission_file import Mission
from mission.safety.rules import Safety
from mission.shell.dispatcher import Dispatcher, Note
from mission.shell.preflight import judge_heights, judge_places, refused
from mission.shell.vehicle_fences import VehicleFences, demands_of

READY_TIMEOUT_S = 60.0
LOOK_S = 0.2


@dataclass(frozen=True, slots=True)
class Start:
    """The steps of a start, in the order they are called."""

    mission: Mission
    clock: Clock
    dispatcher: Dispatcher
    note: Note
    fences: VehicleFences
    override: str = ""
    """Why the mission may start although a vehicle's check is red; typed by the operator."""

    async def until_heard(
        self, robots: Mapping[str, Robot], resumed_ns: int, waited: Callable[[int], None]
    ) -> set[str]:
        """Robots still not heard when the time to wait is over. A mission that begins waits for all of them.

        A resumed one goes on without those. `waited` is given the time while nothing comes. Raises `DeviceTimeout`.
        """
        deadline_s = self.clock.elapsed_s() + READY_TIMEOUT_S
        while missing := _missing(robots, resumed_ns):
            if self.clock.elapsed_s() > deadline_s:
                text = _not_heard(missing, self.mission.safety.on_foot)
                if not resumed_ns or len(missing) == len(robots):
                    raise DeviceTimeout(text)
                self.note("warning", f"{text} The mission goes on without")
                break
            await self.clock.sleep(LOOK_S)
            waited(self.clock.now_ns())  # silence is no step of the clock
        return set(missing)

    async def inspect(
        self, robots: Mapping[str, Robot], absent: set[str], *, resumed: bool
    ) -> dict[str, str]:
        """Vehicles that would not stop by themselves, or are not ready otherwise, keep the mission from starting.

        A mission that is resumed goes on without them: robots that are not ready, and why.
        """
        present = {robot: link for robot, link in self.dispatcher.link_of.items() if robot not in absent}
        checks = await self.fences.put(list(present))
        asked = [link.inspect(robot, demands_of(self.mission)) for robot, link in present.items()]
        checks += [check for found in await asyncio.gather(*asked) for check in found]
        poses = {name: robot.pose for name, robot in robots.items() if robot.pose is not None}
        ours = robots.keys() - absent
        checks += [check for check in judge_places(self.mission, poses) if check.robot in ours]
        flies = {name: robot.vehicle.flies for name, robot in robots.items() if robot.vehicle is not None}
        checks += [check for check in judge_heights(self.mission, flies) if check.robot in ours]
        for check in checks:
            if check.level != "green":
                self.note("warning", f"{check.robot}: {check.name} {check.level}: {check.found}")
        if not (reasons := refused(checks)):
            return {}
        if resumed and not self.override:
            red = {
                check.robot: f"{check.name}: {check.found}"
                for check in checks
                if check.level == "red" and check.robot in robots
            }
            if len(red.keys() | absent) < len(robots):
                return red
        if not self.override:
            raise VehicleRefused(
                f"the vehicles are not ready to start, nothing has moved:\n{reasons}\n"
                "Mend that, or give a reason to start all the same: --override 'why it is safe'"
            )
        self.note("warning", f"started in spite of red checks: {self.override}")
        return {}

    async def acquire(
        self, robots: Mapping[str, Robot], safety: Safety, absent: Mapping[str, str], *, resumed: bool
    ) -> dict[str, str]:
        """Make the vehicles ours. Robots that stay out of the mission until the operator resumes them, and why.

        `absent` are those that are not to be acquired, and why. A mission that begins needs all of them, and raises
        what one that refuses raises. A resumed one adopts what
        was armed; what is disarmed or refuses waits for the operator and does not keep the others from going on.
        """
        if not resumed:
            await self.dispatcher.acquire()
            return {}
        waits = dict(absent) | {
            name: "it is disarmed"
            for name, robot in robots.items()
            if name not in absent and robot.vehicle is not None and not robot.vehicle.armed
        }
        ordered = {name for name, robot in safety.robots.items() if robot.ordered}
        names = [name for name in safety.robots if name not in ordered | waits.keys()]
        asked = [self.dispatcher.acquire([name]) for name in names]
        for name, outcome in zip(names, await asyncio.gather(*asked, return_exceptions=True), strict=True):
            if isinstance(outcome, DeviceError):
                waits[name] = str(outcome)
            elif outcome is not None:
                raise outcome
        return waits


def _not_heard(missing: list[str], on_foot: Container[str]) -> str:
    """Who is missing, and what to look at: of a vehicle something else than of a person."""
    waited, said = f"in {READY_TIMEOUT_S:.0f} s", []
    if vehicles := [name for name in missing if name not in on_foot]:
        said.append(
            f"no telemetry from {', '.join(vehicles)} {waited}: is the vehicle on, does it send to the address in the "
            "mission file, are its system id and signing key right, has it a position fix?"
        )
    if people := [name for name in missing if name in on_foot]:
        said.append(
            f"no position of {', '.join(people)} {waited}: is the satellite receiver on, and where the sky is free?"
        )
    return " ".join(said)


def _missing(robots: Mapping[str, Robot], resumed_ns: int) -> list[str]:
    """Robots whose position or vehicle has not been heard since the mission went on."""
    return [
        name
        for name, robot in robots.items()
        if robot.pose is None
        or robot.vehicle is None
        or min(robot.pose.t_ns, robot.vehicle.t_ns) <= resumed_ns
    ]
