"""Missions, fences and rally points on a vehicle: uploaded item by item, and read back to be believed.

ArduPilot writes them in place: an upload that breaks off leaves a mixture of old and new. It asks with
MISSION_REQUEST (PX4 with MISSION_REQUEST_INT); both are answered with MISSION_ITEM_INT.
Protocol: https://mavlink.io/en/services/mission.html
"""

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.mavlink.codec import AUTOPILOT, GROUND_STATION, Message, mavlink
from drivers.mavlink.commands import wait_for
from fieldkit.clock import Clock
from fieldkit.errors import DeviceTimeout, VehicleRefused

MISSION = mavlink.MAV_MISSION_TYPE_MISSION
FENCE = mavlink.MAV_MISSION_TYPE_FENCE
RALLY = mavlink.MAV_MISSION_TYPE_RALLY
NAMES = {MISSION: "mission", FENCE: "fence", RALLY: "rally points"}
TRIES = 5
FIRST_WAIT_S = 1.5
ITEM_WAIT_S = 2.5
"""A vehicle that misses an item asks again after 1 s and gives up after 8 s."""
WHOLE_S = 60.0
WHOLE_TRIES = 3


@dataclass(frozen=True, slots=True)
class PlanItem:
    """One item: a MAV_CMD with its parameters and a place, degrees times 1e7."""

    command: int
    lat_e7: int
    lon_e7: int
    up_m: float = 0.0
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def agrees(self, other: "PlanItem") -> bool:
        """Whether a vehicle gave back what it was sent; its numbers are 32-bit floats."""
        numbers = zip((*self.params, self.up_m), (*other.params, other.up_m), strict=True)
        same = all(math.isclose(a, b, rel_tol=1e-5, abs_tol=1e-2) for a, b in numbers)
        return same and (self.command, self.lat_e7, self.lon_e7) == (
            other.command,
            other.lat_e7,
            other.lon_e7,
        )


class Inbox:
    """Messages of one vehicle that a conversation waits for."""

    def __init__(self, clock: Clock, kinds: Sequence[str]) -> None:
        self.kinds = frozenset(kinds)
        self._clock = clock
        self._messages: deque[Message] = deque(maxlen=1000)
        self._waiting: asyncio.Future[int] | None = None

    def put(self, message: Message) -> None:
        self._messages.append(message)
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(0)

    async def next(self, timeout_s: float) -> Message | None:
        """The next message, None if none came in time."""
        if not self._messages:
            self._waiting = asyncio.get_running_loop().create_future()
            await wait_for(self._waiting, self._clock, timeout_s)
        return self._messages.popleft() if self._messages else None


@dataclass
class PlanTalk:
    """A conversation with one vehicle about one of its plans."""

    robot: str
    system_id: int
    kind: int
    send: Callable[[Message], None]
    inbox: Inbox
    clock: Clock
    own_id: int

    async def upload(self, items: Sequence[PlanItem]) -> None:
        """Send the items and read them back. Raises `VehicleRefused`, `DeviceTimeout`.

        One that breaks off is read back all the same, for only its last answer may be lost, and else sent again.
        """
        for attempt in range(WHOLE_TRIES):
            try:
                await self._upload_once(items)
                return
            except DeviceTimeout:
                with contextlib.suppress(DeviceTimeout):
                    if self._agrees(items, await self.download()):
                        return
                if attempt == WHOLE_TRIES - 1:
                    raise

    async def _upload_once(self, items: Sequence[PlanItem]) -> None:
        if not items:
            await self._clear()
        else:
            await self._send_all(items)
        held = await self.download()
        if not self._agrees(items, held):
            raise VehicleRefused(
                f"{self.robot}: the {NAMES[self.kind]} read back is not the one sent "
                f"({len(held)} items for {len(items)}); send it again before starting"
            )

    def _agrees(self, items: Sequence[PlanItem], held: Sequence[PlanItem]) -> bool:
        first = 1 if self.kind == MISSION else 0  # ArduPilot keeps item 0 of a mission for home
        return len(held) == len(items) and all(
            a.agrees(b) for a, b in zip(items[first:], held[first:], strict=True)
        )

    async def _send_all(self, items: Sequence[PlanItem]) -> None:
        """Answer what the vehicle asks for until it has all. Raises `VehicleRefused`, `DeviceTimeout`.

        A vehicle that cancels has heard nothing of us for 8 s (ArduPilot): the link failed, it refuses nothing.
        """
        count = mavlink.MAVLink_mission_count_message(self.system_id, AUTOPILOT, len(items), self.kind)
        began_s, last, quiet = self.clock.elapsed_s(), -1, 0
        self.send(count)
        while self.clock.elapsed_s() - began_s < WHOLE_S and quiet < TRIES:
            message = await self._next(FIRST_WAIT_S if last < 0 else ITEM_WAIT_S)
            if message is None:
                quiet += 1
                if last < 0:
                    self.send(count)
            elif message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                quiet = 0
                if 0 <= message.seq < len(items):
                    last = max(last, message.seq)
                    self.send(self._item(message.seq, items[message.seq]))
            elif message.get_type() == "MISSION_ACK":
                if message.type == mavlink.MAV_MISSION_OPERATION_CANCELLED:
                    break
                if self._is_final(message.type, last, len(items)):
                    return
        raise DeviceTimeout(
            f"{self.robot}: uploading the {NAMES[self.kind]} broke off after item {last} of {len(items)}; "
            "what it holds now may be a mixture: upload again"
        )

    def _is_final(self, result: int, last: int, count: int) -> bool:
        """Whether an acknowledgement ends the upload well; raises if it ends it badly."""
        if result == mavlink.MAV_MISSION_ACCEPTED:
            return last == count - 1
        if result == mavlink.MAV_MISSION_INVALID_SEQUENCE:
            return False  # a duplicate on the way; ArduPilot goes on
        enum = mavlink.enums["MAV_MISSION_RESULT"]
        name = enum[result].name.removeprefix("MAV_MISSION_") if result in enum else str(result)
        raise VehicleRefused(f"{self.robot}: refuses the {NAMES[self.kind]}: {name}")

    def _item(self, number: int, item: PlanItem) -> Message:
        frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT if self.kind != FENCE else mavlink.MAV_FRAME_GLOBAL
        return mavlink.MAVLink_mission_item_int_message(
            self.system_id,
            AUTOPILOT,
            number,
            frame,
            item.command,
            0,
            1,
            *item.params,
            item.lat_e7,
            item.lon_e7,
            item.up_m,
            self.kind,
        )

    async def _clear(self) -> None:
        for _ in range(TRIES):
            self.send(mavlink.MAVLink_mission_clear_all_message(self.system_id, AUTOPILOT, self.kind))
            message = await self._next(FIRST_WAIT_S)
            if message is not None and message.get_type() == "MISSION_ACK" and message.type == 0:
                return
        raise DeviceTimeout(f"{self.robot}: does not answer when ordered to clear its {NAMES[self.kind]}")

    async def download(self) -> list[PlanItem]:
        """What the vehicle holds. Raises `DeviceTimeout`."""
        ask = mavlink.MAVLink_mission_request_list_message(self.system_id, AUTOPILOT, self.kind)
        count = (await self._asked(ask, lambda m: m.get_type() == "MISSION_COUNT")).count
        items = []
        for number in range(count):
            ask = mavlink.MAVLink_mission_request_int_message(self.system_id, AUTOPILOT, number, self.kind)
            message = await self._asked(
                ask,
                lambda m, number=number: m.get_type() == "MISSION_ITEM_INT" and m.seq == number,  # type: ignore[misc]
            )
            params = (message.param1, message.param2, message.param3, message.param4)
            items.append(PlanItem(message.command, message.x, message.y, message.z, params))
        if count:
            self.send(mavlink.MAVLink_mission_ack_message(self.system_id, AUTOPILOT, 0, self.kind))
        return items

    async def _asked(self, question: Message, answers: Callable[[Message], bool]) -> Message:
        for _ in range(TRIES):
            self.send(question)
            deadline_s = self.clock.elapsed_s() + FIRST_WAIT_S
            while (left_s := deadline_s - self.clock.elapsed_s()) > 0:
                message = await self._next(left_s)
                if message is not None and answers(message):
                    return message
        raise DeviceTimeout(f"{self.robot}: does not answer questions about its {NAMES[self.kind]}")

    async def _next(self, timeout_s: float) -> Message | None:
        """The next message of this conversation: about this plan, and meant for us."""
        deadline_s = self.clock.elapsed_s() + timeout_s
        while (left_s := deadline_s - self.clock.elapsed_s()) > 0:
            message = await self.inbox.next(left_s)
            if message is None:
                return None
            ours = message.target_system in (0, self.own_id) and message.target_component in (
                0,
                GROUND_STATION,
            )
            if ours and message.mission_type == self.kind:
                return message
        return None


KINDS = ("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK", "MISSION_COUNT", "MISSION_ITEM_INT")


def polygon_fence(corners_e7: Sequence[tuple[int, int]]) -> list[PlanItem]:
    """A fence the vehicle must stay inside: corners as latitude, longitude times 1e7, at least three."""
    if len(corners_e7) < 3:
        raise ValueError(f"a fence needs three corners, got {len(corners_e7)}")
    vertex = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    count = float(len(corners_e7))
    return [PlanItem(vertex, lat, lon, params=(count, 0.0, 0.0, 0.0)) for lat, lon in corners_e7]
