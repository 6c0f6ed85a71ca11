"""Compile the hot loops before anything moves: the first call of each takes seconds, on a new machine many.

What is loaded by then stays for good: the garbage collector need not look through it again in mid-mission.
"""

import gc

from fieldkit.messages import Pose, RssReading, Tick, VehicleState
from mission.core.kernel import Kernel
from mission.core.mission_file import Mission


def warm_up(mission: Mission) -> None:
    """Run a throw-away kernel of the same settings through a few made-up transmissions and plans."""
    kernel = Kernel(mission.kernel)
    engine = mission.kernel.engine
    heard_dbm = engine.antenna.threshold_dbm + 5.0
    for robot in engine.robots:
        kernel.step(VehicleState(0, robot, "guided", True))
    for second in range(8):
        t_ns = second * 1_000_000_000
        for index, robot in enumerate(engine.robots):
            east = (index + 0.5) / len(engine.robots) * engine.grid.size_east_m
            kernel.step(Pose(t_ns, robot, east, 0.3 * engine.grid.size_north_m))
        for robot in engine.robots[: 1 + second % 2]:
            kernel.step(RssReading(t_ns, robot, round(heard_dbm)))
        kernel.step(Tick(t_ns))
    del kernel
    gc.collect()
    gc.freeze()
