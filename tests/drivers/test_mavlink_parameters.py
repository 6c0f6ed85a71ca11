"""Parameters are asked for again until they are there, and by the wall's time where the mission's runs faster."""

import asyncio

from drivers.mavlink import parameters
from drivers.mavlink.codec import Message, mavlink
from fieldkit.clock import ScaledClock, wall_s

BUSY_S = 0.6
"""An emulated vehicle on a busy machine answers nothing for so long."""


class Late:
    """What a vehicle sends that is not asked often: `BUSY_S` late."""

    def __init__(self, clock: ScaledClock) -> None:
        self.clock, self.began_s, self.asked = clock, wall_s(), 0

    def send(self, message: Message) -> None:
        self.asked += 1

    async def next(self, timeout_s: float) -> Message | None:
        if wall_s() - self.began_s < BUSY_S:
            await self.clock.sleep(timeout_s)
            return None
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        return mavlink.MAVLink_param_value_message(b"FS_GCS_ENABLE", 1.0, kind, 1, 0)


def test_a_fast_clock_does_not_make_a_slow_machine_a_bad_link() -> None:
    late = Late(ScaledClock(20.0))
    names = ("FS_GCS_ENABLE",)
    reading = parameters.read(late.send, late, late.clock, 1, None, names)  # type: ignore[arg-type]
    assert asyncio.run(reading) == {"FS_GCS_ENABLE": 1.0}
    assert late.asked > 10
