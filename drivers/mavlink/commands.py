"""One command to one vehicle, until it answers: retries, and the answer matched to vehicle and command."""

import asyncio
from collections.abc import Callable
from typing import Any

from drivers.mavlink.codec import GROUND_STATION, Message, mavlink
from drivers.mavlink.vehicle import Vehicle
from fieldkit.clock import Clock
from fieldkit.errors import DeviceTimeout, VehicleRefused

TRIES = 10
WAIT_S = 0.5
"""Mission time to wait for an answer before asking again, as MAVSDK does."""
LONG_WAIT_S = 10.0
"""After the vehicle said IN_PROGRESS."""
WORDS_S = 1.0
"""A refusal's reason is in the status texts of the last second, and not older than the question."""
ABANDONED = -1
"""In place of an answer: a newer command has come."""

Result = int
Send = Callable[[Vehicle, Message], None]


class Commander:
    """Sends commands and waits for their COMMAND_ACK."""

    def __init__(self, clock: Clock, system_id: int, send: Send) -> None:
        self._clock = clock
        self._system_id = system_id
        self.send = send
        self._waiting: dict[tuple[int, int], asyncio.Future[Result]] = {}
        self._noted: dict[tuple[int, int], Result | None] = {}

    def note(self, vehicle: Vehicle, command: int) -> None:
        """From now on keep the answer to a command that nobody waits for: see `noted`."""
        self._noted[vehicle.system_id, command] = None

    def noted(self, vehicle: Vehicle, command: int) -> Result | None:
        """The answer kept since `note`; None where none has come."""
        return self._noted.get((vehicle.system_id, command))

    def abandon(self, vehicle: Vehicle) -> None:
        """Whoever waits for an answer of this vehicle looks at once whether that is still wanted."""
        for (system_id, _), future in self._waiting.items():
            if system_id == vehicle.system_id and not future.done():
                future.set_result(ABANDONED)

    def heard(self, ack: Message, system_id: int) -> None:
        """Take a COMMAND_ACK. Answers to other ground stations are not ours."""
        if ack.target_system not in (0, self._system_id) or ack.target_component not in (0, GROUND_STATION):
            return
        waiting = self._waiting.get((system_id, ack.command))
        if waiting is not None and not waiting.done():
            waiting.set_result(ack.result)
            return
        if (system_id, ack.command) in self._noted:
            self._noted[system_id, ack.command] = ack.result

    async def ask(
        self,
        vehicle: Vehicle,
        what: str,
        build: Callable[[int], Message],
        *,
        tries: int = TRIES,
        wait_s: float = WAIT_S,
        still: Callable[[], bool] = lambda: True,
        behind: Message | None = None,
    ) -> None:
        """Have a command accepted. `build` makes it for the n-th attempt; `what` names it in errors.

        `behind` goes out right behind each attempt; its answer is nobody's concern here.
        Stops asking as soon as `still` says no. Raises `VehicleRefused` with the vehicle's words, or
        `DeviceTimeout`.
        """
        asked_s = self._clock.elapsed_s()
        for attempt in range(tries):
            if not still():
                raise VehicleRefused(f"{vehicle.robot}: {what}: given up, a newer command came in between")
            result = await self._once(vehicle, build(attempt), wait_s, behind)
            if result is None or result == ABANDONED:
                continue
            if result == mavlink.MAV_RESULT_ACCEPTED:
                return
            if result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED and attempt < tries - 1:
                await self._clock.sleep(wait_s)
                continue
            raise VehicleRefused(await self._refusal(vehicle, what, result, asked_s))
        if not still():
            raise VehicleRefused(f"{vehicle.robot}: {what}: given up, a newer command came in between")
        raise DeviceTimeout(
            f"{vehicle.robot} (system {vehicle.system_id}): {what}: no answer to {tries} attempts; "
            "check the link"
        )

    async def _once(
        self, vehicle: Vehicle, message: Message, wait_s: float, behind: Message | None
    ) -> Result | None:
        key = (vehicle.system_id, message.command)
        future: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        self._waiting[key] = future
        try:
            self.send(vehicle, message)
            if behind is not None:
                self.send(vehicle, behind)
            answered = await wait_for(future, self._clock, wait_s)
            while answered and future.result() == mavlink.MAV_RESULT_IN_PROGRESS:
                future = self._waiting[key] = asyncio.get_running_loop().create_future()
                answered = await wait_for(future, self._clock, LONG_WAIT_S)
            return future.result() if answered else None
        finally:
            if self._waiting.get(key) is future:
                del self._waiting[key]

    async def _refusal(self, vehicle: Vehicle, what: str, result: Result, asked_s: float) -> str:
        since_s = max(asked_s, self._clock.elapsed_s() - WORDS_S)
        words = vehicle.words_since(since_s)
        if not words:  # the text may come just behind the answer
            await self._clock.sleep(0.3)
            words = vehicle.words_since(since_s)
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
