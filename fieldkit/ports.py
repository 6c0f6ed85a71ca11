"""The seams where hardware plugs in: small Protocols, found by entry-point name.

A driver is opened with `async with` and closed even when cancelled. Closing twice is harmless.
"""

import math
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self, runtime_checkable

from fieldkit.checks import Check
from fieldkit.clock import Clock
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, ReceiverState, RssReading, VehicleState, Waypoint


@dataclass(frozen=True, slots=True)
class DriverContext:
    """What every driver is handed besides its own options."""

    clock: Clock
    frame: FieldFrame
    tap: Callable[[str, bytes], None] | None = None
    """Called in the thread that reads, with a radio link's name and what came over it; None: nobody records it."""


@dataclass(frozen=True, slots=True)
class Demands:
    """What a mission asks of a vehicle: `VehicleLink.inspect` judges by it."""

    max_speed_m_s: float = math.inf
    fence_m: tuple[tuple[float, float], ...] = ()
    """Corners (east, north) of what a fence of the vehicle's own must be; empty: none is needed."""
    put_fence: bool = False
    """`fence_m` is in the vehicle: the mission has had it put there, and relies on it."""
    field_m: tuple[tuple[float, float], ...] = ()
    """Corners of where the mission drives; a fence of the vehicle's own must leave room for that."""
    turn_radius_m: float | None = None
    """How wide the mission takes it to turn; None: it is alone, and may turn as it likes."""


@dataclass(frozen=True, slots=True)
class Traits:
    """How a vehicle moves, read from itself; None where it does not say."""

    flies: bool = False
    arrive_m: float | None = None
    """Its own way-point radius."""
    turn_radius_m: float | None = None
    speed_m_s: float | None = None
    """Its speed where no order sets one."""
    return_m_s: float | None = None
    """On its own way home."""
    return_up_m: float | None = None
    """The altitude at which it returns."""


@dataclass(frozen=True, slots=True)
class StoredFence:
    """A vehicle's fence as it was before a mission changed it: what `stored_fence` gives and `restore_fence` takes.

    `items` are rows of command, latitude and longitude in degrees times 1e7, altitude, four parameters.
    """

    robot: str
    enabled: float | None
    items: tuple[tuple[float, ...], ...] = ()


class _Opened(Protocol):
    async def __aenter__(self) -> Self: ...

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


@runtime_checkable
class Receiver(_Opened, Protocol):
    """One robot's radio, listening.

    Opening raises `DeviceError` where the device is missing, busy, silent or the wrong one.
    """

    robot: str

    def readings(self) -> AsyncIterator[RssReading | ReceiverState]:
        """Readings in the order of reception, stamped at the frame, mixed with changes of the receiver's state.

        Ends when the receiver is closed. Loss of the device is a `ReceiverState(up=False)`, not an exception.
        """
        ...


@runtime_checkable
class VehicleLink(_Opened, Protocol):
    """One link (socket or serial port) with one or many vehicles on it."""

    robots: tuple[str, ...]

    def events(self) -> AsyncIterator[Pose | VehicleState]:
        """Poses and states of the vehicles on this link. Ends when the link is closed."""
        ...

    def beat(self) -> None:
        """Tell the vehicles we are alive. Called from the steering loop, so that it stops when steering does."""
        ...

    async def acquire_control(self, robot: str, *, arm: bool = True) -> None:
        """Make the vehicle ours to steer and armed. Raises `VehicleRefused` with the vehicle's own words.

        With `arm` False one that is disarmed stays so.
        """
        ...

    async def inspect(self, robot: str, demands: Demands = Demands()) -> list[Check]:
        """Whether the vehicle is fit for a mission, its own failsafes first. Nothing is armed, moved or changed."""
        ...

    async def traits(self, robot: str) -> Traits:
        """How the vehicle moves, read from itself. Raises `DeviceTimeout` where it is not heard."""
        ...

    async def stored_fence(self, robot: str) -> StoredFence:
        """The vehicle's own fence as it is. Raises `DeviceTimeout` where it cannot be read."""
        ...

    async def put_fence(self, robot: str, corners_m: Sequence[tuple[float, float]]) -> None:
        """Put corners (east, north) into the vehicle as its own fence and enable it. What was there is gone.

        Raises `VehicleRefused` or `DeviceTimeout`.
        """
        ...

    async def restore_fence(self, stored: StoredFence) -> None:
        """Put back what `stored_fence` read. Raises `VehicleRefused` or `DeviceTimeout`."""
        ...

    def release(self, robot: str) -> None:
        """Give the vehicle up to whoever steers it next: nothing more is sent to it, until `acquire_control`."""
        ...

    def stop(self, robot: str) -> None:
        """Tell the vehicle to hold, now: the first frame has left when this returns, and it is repeated.

        Nothing is waited for and nothing raised: `hold` says whether it was done. Needs no ownership.
        """
        ...

    async def hold(self, robot: str) -> None:
        """`stop`, and return when the vehicle itself says it holds. Raises `DeviceTimeout`.

        Given up or cancelled, the hold is repeated all the same, until another order takes its place.
        """
        ...

    async def take_off(self, robot: str, up_m: float) -> None:
        """Climb to an altitude above home; returns when it is there. It is under our control and armed already.

        Raises `VehicleRefused` (also where it does not fly) or `DeviceTimeout`.
        """
        ...

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        """Send one way-point and have it acknowledged. Raises `VehicleRefused` or `DeviceTimeout`.

        One that flies goes to `up_m` above its home, and refuses to where it would touch the ground.
        """
        ...

    async def return_home(self, robot: str) -> None:
        """Send the vehicle home by its own means. Raises `VehicleRefused` or `DeviceTimeout`."""
        ...

    async def land(self, robot: str) -> None:
        """Have one that flies land where it is; returns when it shows that it does. It disarms itself once down.

        Raises `VehicleRefused` or `DeviceTimeout`.
        """
        ...


@runtime_checkable
class PositionSource(_Opened, Protocol):
    """Where robots are, from something that is not their own telemetry: an overhead camera, a file."""

    robots: tuple[str, ...]

    def poses(self) -> AsyncIterator[Pose]:
        """Poses as they are known. A robot that is hidden or inconsistent is absent, not wrong."""
        ...


@runtime_checkable
class Network(_Opened, Protocol):
    """What the agents of robots talk over. Whoever is in reach may hear what is published; nothing is promised."""

    where: str
    """In words, where it looks for others."""

    @property
    def unresolved(self) -> Mapping[str, str]:
        """Addresses whose names cannot be resolved at present, and why. They are tried on."""
        ...

    def publish(self, data: bytes, *, urgent: bool = False) -> None:
        """Send to all in reach. Waits for nobody; what cannot leave is lost. Urgent messages go before others."""
        ...

    def greet(self, data: bytes) -> None:
        """Send to all in reach, of whatever topic: who is here. As `publish` otherwise."""
        ...

    def messages(self) -> AsyncIterator[bytes]:
        """What others of the topic publish, and all greetings, as it comes. Ends when the network is closed."""
        ...


class NetworkFactory(Protocol):
    """What an entry point in `fieldkit.networks` names. Those of one `topic` hear each other."""

    def __call__(self, topic: str, options: Mapping[str, Any], around: DriverContext) -> Network: ...


class ReceiverFactory(Protocol):
    """What an entry point in `fieldkit.receivers` names."""

    def __call__(self, robot: str, options: Mapping[str, Any], around: DriverContext) -> Receiver: ...


class PositionSourceFactory(Protocol):
    """What an entry point in `fieldkit.positions` names."""

    def __call__(self, options: Mapping[str, Any], around: DriverContext) -> PositionSource: ...


class VehicleLinkFactory(Protocol):
    """What an entry point in `fieldkit.vehicles` names: robots that share an address share one link.

    `robots` maps a robot's name to its own options (for MAVLink: `system_id`).
    """

    def __call__(
        self, address: str, robots: Mapping[str, Mapping[str, Any]], around: DriverContext
    ) -> VehicleLink: ...
