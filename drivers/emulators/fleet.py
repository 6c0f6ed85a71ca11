"""Emulated rovers in the caller's event loop, each on a UDP socket of its own, with a link that can be made bad.

For many missions in a row under one loop's time (`fieldkit.jumploop`); `field` is the one in a process of its own.
What arrives at a rover is remembered where it matters: every target it has taken, with the moment.
"""

import asyncio
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, ClassVar, Self

import numpy as np

from drivers.emulators.rover import GUIDED, HOLD, MANUAL, RoverAutopilot
from drivers.mavlink.codec import Packer, mavlink
from drivers.mavlink.signing import Signer
from fieldkit import settings as given
from fieldkit.clock import Clock
from fieldkit.geo import FieldFrame
from fieldkit.world.bodies import car_for

STEP_S = 0.1
CAPTURED = 200
"""Frames an eavesdropper keeps."""


COMMAND_LONG, COMMAND_ACK, DO_SET_MODE = 76, 77, 176
HEADER, CHECKSUM, SIGNATURE, SIGNED = 10, 2, 13, 1
"""Of a MAVLink 2 frame, in bytes; the flag of a signed one. Source: https://mavlink.io/en/guide/serialization.html"""


def _frames(data: bytes) -> Iterator[bytes]:
    """The MAVLink 2 frames that a datagram of ours is made of."""
    at = 0
    while at + HEADER <= len(data):
        length = HEADER + data[at + 1] + CHECKSUM + (SIGNATURE if data[at + 2] & SIGNED else 0)
        yield data[at : at + length]
        at += length


def _message_id(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


def _commands(data: bytes) -> set[int]:
    """The commands that a datagram asks for. A command's number stands behind its seven floats."""
    return {
        int.from_bytes(frame[HEADER + 28 : HEADER + 30], "little")
        for frame in _frames(data)
        if _message_id(frame) == COMMAND_LONG
    }


@dataclass(frozen=True, slots=True)
class FleetSpec:
    """What to emulate: robots by name, numbered from system id 1 in this order."""

    frame: FieldFrame
    starts_m: Mapping[str, tuple[float, float]]
    address: tuple[str, int]
    """Where telemetry goes."""
    seed: int
    max_speed_m_s: float = given.MAX_SPEED_M_S.default
    pose_noise_m: float = given.POSE_NOISE_M
    signing_key: bytes | None = None


@dataclass
class Target:
    """A place a rover was ordered to go to, and has set out for."""

    t_s: float
    east_m: float
    north_m: float


class EmulatedRover(asyncio.DatagramProtocol):
    """One rover on its socket."""

    def __init__(
        self, autopilot: RoverAutopilot, clock: Clock, rng: np.random.Generator, signer: Signer | None
    ) -> None:
        self.autopilot = autopilot
        self._clock = clock
        self._rng = rng
        self._signer = signer
        self._transport: asyncio.DatagramTransport | None = None
        self._captured: list[bytes] = []
        self._known_target: tuple[float, float] | None = None
        self.silent = False
        self.loss = 0.0
        """Share of datagrams lost, each way."""
        self.loses_acknowledgements = False
        """Whether its answers to commands are lost, all of them, while everything else passes."""
        self.on_stop: Callable[[], object] | None = None
        """Called when a datagram that may be a command to hold has come over the wire, lost or not."""
        self.targets: list[Target] = []

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, address: Any) -> None:
        if self.on_stop is not None and DO_SET_MODE in _commands(data):
            self.on_stop()
        if self._passes():
            self.send(self.autopilot.receive(data, self._clock.elapsed_s()))
            self._watch_target()

    def error_received(self, error: Exception) -> None:
        """Ignored: a radio would not know that nobody listens."""

    def update(self) -> None:
        """Time has passed."""
        self.send(self.autopilot.update(self._clock.elapsed_s()))

    def send(self, data: bytes) -> None:
        if self.loses_acknowledgements:
            data = b"".join(frame for frame in _frames(data) if _message_id(frame) != COMMAND_ACK)
        if data and self._passes() and self._transport is not None:
            self._transport.sendto(data)
            self._captured = [*self._captured[-CAPTURED:], data]

    def _passes(self) -> bool:
        return not self.silent and (self.loss <= 0 or self._rng.random() >= self.loss)

    def _watch_target(self) -> None:
        target = self.autopilot._target_m if self.autopilot.mode == GUIDED else None
        if target is not None and target != self._known_target:
            self.targets.append(Target(self._clock.elapsed_s(), *target))
        self._known_target = target

    @property
    def place_m(self) -> tuple[float, float]:
        """Where it really is."""
        return self.autopilot.body.east_m, self.autopilot.body.north_m

    @property
    def drives_for_us(self) -> bool:
        """Whether it is under way in the mode that takes our targets."""
        return self.autopilot.mode == GUIDED and self.autopilot.body.speed_m_s > 0.05

    @property
    def holds(self) -> bool:
        return self.autopilot.mode == HOLD

    # What can happen to it

    def reboot(self) -> None:
        self.autopilot.reboot(self._clock.elapsed_s())

    def step_clock(self, step_s: float) -> None:
        """Its boot clock jumps."""
        self.autopilot.boot_s -= step_s

    def taken_by_hand(self) -> None:
        """Somebody drives it by remote control."""
        self.autopilot.operator_sets(MANUAL)

    def forge(self) -> None:
        """Somebody else sends: made-up frames in its name, unsigned and wrongly signed, and its own once more."""
        if self._transport is None:
            return
        stranger = None
        if self._signer is not None:
            stranger = Signer(bytes(self._rng.bytes(32)), self._clock.now_ns, link_id=9)
        beat = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GROUND_ROVER, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 209, GUIDED, 4, 3
        )
        place = mavlink.MAVLink_global_position_int_message(
            round((self._clock.elapsed_s() - self.autopilot.boot_s) * 1e3),
            450_000_000,
            90_000_000,
            0,
            0,
            0,
            0,
            0,
            0,
        )
        for signer in (None, stranger):
            packer = Packer(self.autopilot.system_id, 1, signer)
            self._transport.sendto(packer.pack(beat) + packer.pack(place))
        for data in self._captured[-CAPTURED :: CAPTURED // 10]:
            self._transport.sendto(data)


@dataclass
class EmulatedFleet:
    """The rovers, while used as an async context manager."""

    spec_type: ClassVar = FleetSpec
    spec: FleetSpec
    clock: Clock
    rovers: dict[str, EmulatedRover] = field(default_factory=dict)
    closest_m: float = math.inf
    """The least true distance so far between two rovers of which one was under way for us."""

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        for number, (name, (east_m, north_m)) in enumerate(self.spec.starts_m.items(), start=1):
            rng = np.random.default_rng([self.spec.seed, number])
            body = car_for(east_m, north_m, 0.0, self.spec.max_speed_m_s)
            key = self.spec.signing_key
            signer = None if key is None else Signer(key, self.clock.now_ns, link_id=number)
            autopilot = RoverAutopilot(
                number, body, self.spec.frame, rng, pose_noise_m=self.spec.pose_noise_m, signer=signer
            )
            rover = EmulatedRover(autopilot, self.clock, rng, signer)
            await loop.create_datagram_endpoint(lambda rover=rover: rover, remote_addr=self.spec.address)  # type: ignore[misc]
            self.rovers[name] = rover
        self._task = asyncio.create_task(self._live(), name="emulated fleet")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._task.cancel()
        await asyncio.wait({self._task})
        for rover in self.rovers.values():
            if rover._transport is not None:
                rover._transport.close()

    async def _live(self) -> None:
        while True:
            for rover in self.rovers.values():
                rover.update()
            self._measure()
            await self.clock.sleep(STEP_S)

    def _measure(self) -> None:
        rovers = list(self.rovers.values())
        for later, one in enumerate(rovers):
            for other in rovers[:later]:
                if one.drives_for_us or other.drives_for_us:
                    self.closest_m = min(self.closest_m, math.dist(one.place_m, other.place_m))
