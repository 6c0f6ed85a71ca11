"""One command to one vehicle, until it answers: retries, and the answer matched to vehicle and command."""

import asyncio
from collections.abc import Callable
from typing import Any

from drivers.mavlink.codec import GROUND_STATION, Message, mavlink
from drivers.mavlink.vehicle import Vehicle
from fieldkit.clock import Clock
from fieldkit.errors import DeviceTimeout, VehicleRefused

TRIES = 5
WAIT_S = 1.0
"""Mission time to wait for an answer before asking again (MAVSDK 0.5 s, skybrush 2 s)."""
LONG_WAIT_S = 10.0
"""After the vehicle said IN_PROGRESS."""
WORDS_S = 1.0
"""A refusal's reason is in the status texts of about the last second."""

Result = int
Send = Callable[[Vehicle, Message], None]


class Commander:
    """Sends commands and waits for their COMMAND_ACK."""

    def __init__(self, clock: Clock, system_id: int, send: Send) -> None:
        self._clock = clock
        self._system_id = system_id
        self._send = send
        self._waiting: dict[tuple[int, int], asyncio.Future[Result]] = {}

    def heard(self, ack: Message, system_id: int) -> None:
        """Take a COMMAND_ACK. Answers to other ground stations are not ours."""
        if ack.target_system not in (0, self._system_id) or ack.target_component not in (0, GROUND_STATION):
            return
        waiting = self._waiting.get((system_id, ack.command))
        if waiting is not None and not waiting.done():
            waiting.set_result(ack.result)

    async def ask(
        self,
        vehicle: Vehicle,
        what: str,
        build: Callable[[int], Message],
        *,
        tries: int = TRIES,
        wait_s: float = WAIT_S,
        still: Callable[[], bool] = lambda: True,
    ) -> None:
        """Have a command accepted. `build` makes it for the n-th attempt; `what` names it in errors.

        Stops asking as soon as `still` says no. Raises `VehicleRefused` with the vehicle's words, or
        `DeviceTimeout`.
        """
        asked_s = self._clock.elapsed_s()
        for attempt in range(tries):
            if not still():
                raise VehicleRefused(f"{vehicle.robot}: {what}: given up, a newer command came in between")
            result = await self._once(vehicle, build(attempt), wait_s)
            if result is None:
                continue
            if result == mavlink.MAV_RESULT_ACCEPTED:
                return
            if result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED and attempt < tries - 1:
                await self._clock.sleep(wait_s)
                continue
            raise VehicleRefused(await self._refusal(vehicle, what, result, asked_s))
        raise DeviceTimeout(
            f"{vehicle.robot} (system {vehicle.system_id}): {what}: no answer to {tries} attempts; "
            "check the link"
        )

    async def _once(self, vehicle: Vehicle, message: Message, wait_s: float) -> Result | None:
        key = (vehicle.system_id, message.command)
        future: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        self._waiting[key] = future
        try:
            self._send(vehicle, message)
            answered = await wait_for(future, self._clock, wait_s)
            while answered and future.result() == mavlink.MAV_RESULT_IN_PROGRESS:
                future = self._waiting[key] = asyncio.get_running_loop().create_future()
                answered = await wait_for(future, self._clock, LONG_WAIT_S)
            return future.result() if answered else None
        finally:
            if self._waiting.get(key) is future:
                del self._waiting[key]

    async def _refusal(self, vehicle: Vehicle, what: str, result: Result, asked_s: float) -> str:
        words = vehicle.words_since(asked_s - WORDS_S)
        if not words:  # the text may come just behind the answer
            await self._clock.sleep(0.3)
            words = vehicle.words_since(asked_s - WORDS_S)
        enum = mavlink.enums["MAV_RESULT"]
        name = enum[result].name.removeprefix("MAV_RESULT_") if result in enum else str(result)
        return f"{vehicle.robot} (system {vehicle.system_id}): {what}: {name}" + (
            f": {words}" if words else ""
        )


async def wait_for(future: "asyncio.Future[Result]", clock: Clock, duration_s: float) -> bool:
    """Wait for a future in mission time; True if it is done. An answer that came with the deadline counts."""
    sleeper = asyncio.ensure_future(clock.sleep(duration_s))
    both: set[asyncio.Future[Any]] = {future, sleeper}
    try:
        await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
    finally:
        sleeper.cancel()
    return future.done()
