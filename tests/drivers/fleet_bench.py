"""An open MAVLink fleet link with emulated rovers on the other side of real UDP sockets, time 10 times as fast."""

import asyncio
from contextlib import AsyncExitStack, asynccontextmanager

from benches import around, free_udp_port, rovers_on_udp, until

from drivers.mavlink.codec import Parser
from drivers.mavlink.fleet import MavlinkLink, open_link
from fieldkit.clock import ScaledClock
from fieldkit.messages import Pose, VehicleState, Waypoint
from fieldkit.testing import nothing_left

RATE = 10.0


class Team:
    """An open link with emulated rovers on the other side; everything the link has said."""

    def __init__(self, link: MavlinkLink, rovers, clock: ScaledClock, port: int) -> None:
        self.link, self.rovers, self.clock, self.port = link, rovers, clock, port
        self.items: list[Pose | VehicleState] = []
        self.beating = True

    def poses(self, robot="ada"):
        return [item for item in self.items if isinstance(item, Pose) and item.robot == robot]

    def states(self, robot="ada"):
        return [item for item in self.items if isinstance(item, VehicleState) and item.robot == robot]

    def mode(self, robot="ada"):
        states = self.states(robot)
        return states[-1].mode if states else None

    def texts(self, robot="ada"):
        return [state.text for state in self.states(robot)]

    def sent_to(self, rover, kind=None):
        """What the driver has sent to one rover, decoded."""
        found = Parser().parse(b"".join(rover.got))
        return [message for message in found if kind is None or message.get_type() == kind]

    async def sleep(self, mission_s):
        await self.clock.sleep(mission_s)


@asynccontextmanager
async def team(count=1, **options):
    clock, port = ScaledClock(RATE), free_udp_port()
    names = ["ada", "bob", "cyd", "dan"][:count]
    starts_m = {number + 1: (2.0 * number, 0.0) for number in range(count)}
    robots = {name: {"system_id": number + 1} for number, name in enumerate(names)}
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(nothing_left())
        failsafe = {"gcs_failsafe_s": 40.0} | options
        rovers = await stack.enter_async_context(rovers_on_udp(starts_m, clock, port, **failsafe))
        link = await stack.enter_async_context(open_link(f"udpin:127.0.0.1:{port}", robots, around(clock)))
        made = Team(link, rovers, clock, port)

        async def collect():
            async for item in link.events():
                made.items.append(item)

        async def beat():
            while True:
                if made.beating:
                    link.beat()
                await clock.sleep(1.0)

        tasks = [asyncio.create_task(collect()), asyncio.create_task(beat())]
        try:
            await until(lambda: all(made.poses(name) for name in names))
            yield made
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)


def here(**change):
    return Waypoint(**({"east_m": 1.0, "north_m": 3.0, "speed_m_s": 1.0} | change))


def is_command(data: bytes, command: int) -> bool:
    return any(getattr(message, "command", None) == command for message in Parser().parse(data))
