"""HOLD ALL to 16 vehicles over bad links: every acknowledgement is lost, and 30 % of all datagrams both ways.

Real drivers on real sockets of this machine, real time, the runner's own dispatcher. Measured from the call that the
key makes: when the first frame of a stop reaches each vehicle's socket, and when each vehicle is in HOLD; while
way-points wait for their acknowledgement, while vehicles are being acquired, and while fences are being uploaded.
"""

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np

from fieldkit import plugins
from fieldkit.clock import RealClock, wall_s
from fieldkit.geo import FieldFrame
from fieldkit.messages import GoTo, Waypoint
from fieldkit.ports import DriverContext, VehicleLink
from mission.shell.dispatcher import Dispatcher
from mission.shell.setups import free_udp_port

ROBOTS = 16
ROUNDS = 6
LOSS = 0.3
LIMIT_S = 20.0
LOOK_S = 0.002
FIRST = {"go-to": 0.4, "acquire": 0.4, "upload": 0.4}
"""What is under way when the key is pressed, and for how long."""

Prepare = Callable[["_Bench"], Coroutine[Any, Any, None]]


def hold() -> dict[str, Any]:
    """Latencies in milliseconds for each thing that may be under way. Takes about two minutes."""
    return {name: asyncio.run(_rounds(name)) for name in FIRST}


class _Bench:
    """Vehicles, their links, and a dispatcher over them."""

    def __init__(self, fleet: Any, link: VehicleLink, clock: RealClock) -> None:
        self.fleet, self.link = fleet, link
        self.dispatcher = Dispatcher((link,), clock, lambda level, text: None)

    def each(self, east_m: float) -> None:
        """Everybody is sent somewhere."""
        for number, robot in enumerate(self.link.robots):
            self.dispatcher.order(robot, GoTo(0, robot, Waypoint(east_m, 2.0 + 2.0 * number, 1.0)))


async def _rounds(name: str) -> dict[str, Any]:
    first_ms: list[float] = []
    shown_ms: list[float] = []
    for number in range(ROUNDS):
        async with _bench(number) as bench:
            pressed, arrived, held = await _press(bench, name)
            first_ms += [1e3 * (arrived[robot] - pressed) for robot in arrived]
            shown_ms += [1e3 * (held.get(robot, pressed + LIMIT_S) - pressed) for robot in bench.link.robots]
    return {
        "vehicles": len(shown_ms),
        "first_frame_ms": _spread(first_ms),
        "in_hold_ms": _spread(shown_ms),
        "not_in_hold": sum(ms >= 1e3 * LIMIT_S for ms in shown_ms),
    }


@contextlib.asynccontextmanager
async def _bench(seed: int):  # type: ignore[no-untyped-def]
    clock, frame, port = RealClock(), FieldFrame(47.0, 8.0), free_udp_port()
    link: VehicleLink = plugins.load("fieldkit.vehicles", "mavlink")(
        f"udpin:127.0.0.1:{port}",
        {f"r{k}": {"system_id": k} for k in range(1, ROBOTS + 1)},
        DriverContext(clock, frame),
    )
    async with link:
        factory = plugins.load("fieldkit.emulators", "fleet")
        starts = {robot: (2.0, 2.0 + 2.0 * number) for number, robot in enumerate(link.robots)}
        spec = factory.spec_type(frame, starts, ("127.0.0.1", port), seed, max_speed_m_s=1.0)
        async with factory(spec, clock) as fleet:
            reading = asyncio.create_task(_drain(link))
            bench = _Bench(fleet, link, clock)
            try:
                yield bench
            finally:
                await bench.dispatcher.close()
                reading.cancel()
                await asyncio.wait({reading})


async def _press(bench: _Bench, name: str) -> tuple[float, dict[str, float], dict[str, float]]:
    """When the key was pressed, when a stop's first frame came to each vehicle, and when each was in HOLD."""
    async with bench.dispatcher.beating():
        await bench.dispatcher.acquire()
        bench.each(30.0)
        await asyncio.sleep(3.0)  # all are under way
        for rover in bench.fleet.rovers.values():
            rover.loss, rover.loses_acknowledgements = LOSS, True
        doing = await _begin(bench, name)
        await asyncio.sleep(FIRST[name])
        arrived: dict[str, float] = {}
        for robot, rover in bench.fleet.rovers.items():
            rover.on_stop = lambda robot=robot: arrived.setdefault(robot, wall_s())
        pressed = wall_s()
        bench.dispatcher.freeze(bench.link.robots, 0, "the benchmark")
        held: dict[str, float] = {}
        while len(held) < ROBOTS and wall_s() - pressed < LIMIT_S:
            await asyncio.sleep(LOOK_S)
            for robot, rover in bench.fleet.rovers.items():
                if rover.holds:
                    held.setdefault(robot, wall_s())
        for task in doing:
            task.cancel()
        await asyncio.gather(*doing, return_exceptions=True)
    return pressed, arrived, held


async def _begin(bench: _Bench, name: str) -> list[asyncio.Task[Any]]:
    """Have something under way that waits for answers that do not come."""
    if name == "go-to":
        bench.each(5.0)
        return []
    if name == "acquire":
        return [asyncio.create_task(bench.dispatcher.acquire())]
    corners = ((-5.0, -5.0), (60.0, -5.0), (60.0, 60.0), (-5.0, 60.0))
    return [asyncio.create_task(bench.link.put_fence(robot, corners)) for robot in bench.link.robots]


async def _drain(link: VehicleLink) -> None:
    async for _ in link.events():
        pass


def _spread(ms: list[float]) -> dict[str, float]:
    median, p99 = np.percentile(ms, [50, 99]) if ms else (float("nan"), float("nan"))
    return {"median": round(float(median), 1), "p99": round(float(p99), 1), "worst": round(max(ms), 1)}
