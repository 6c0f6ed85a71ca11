"""The seams where hardware plugs in: small Protocols, found by entry-point name.

A driver is opened with `async with` and closed even when cancelled. Closing twice is harmless.
"""

from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self, runtime_checkable

from fieldkit.checks import Check
from fieldkit.clock import Clock
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, ReceiverState, RssReading, VehicleState, Waypoint


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What every driver is handed besides its own options."""

    clock: Clock
    frame: FieldFrame
    tap: Callable[[str, bytes], None] | None = None
    """Told the name of a radio's link and what came over it, in whatever thread read it; None: nobody records it."""


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

    async def take_over(self, robot: str, *, arm: bool = True) -> None:
        """Make the vehicle ours to steer and armed. Raises `VehicleRefused` with the vehicle's own words.

        With `arm` False one that is disarmed stays so.
        """
        ...

    async def inspect(self, robot: str, fence_m: Sequence[tuple[float, float]] = ()) -> list[Check]:
        """Whether the vehicle is fit for a mission, its own failsafes first. Nothing is armed, nothing moves.

        With `fence_m` (corners east, north) that is put into the vehicle as its own fence, and read back.
        """
        ...

    def release(self, robot: str) -> None:
        """Give the vehicle up to whoever steers it next: nothing more is sent to it, until `take_over`."""
        ...

    async def goto(self, robot: str, waypoint: Waypoint) -> None:
        """Send one way-point and have it acknowledged. Raises `VehicleRefused` or `DeviceTimeout`."""
        ...

    async def hold(self, robot: str) -> None:
        """Stop the vehicle; returns when the vehicle itself says it holds. Raises `DeviceTimeout`."""
        ...

    async def return_home(self, robot: str) -> None:
        """Send the vehicle home by its own means. Raises `VehicleRefused` or `DeviceTimeout`."""
        ...


@runtime_checkable
class PositionSource(_Opened, Protocol):
    """Where robots are, from something that is not their own telemetry: an overhead camera, a file."""

    robots: tuple[str, ...]

    def poses(self) -> AsyncIterator[Pose]:
        """Poses as they are known. A robot that is hidden or doubtful is absent, not wrong."""
        ...


class ReceiverFactory(Protocol):
    """What an entry point in `fieldkit.receivers` names."""

    def __call__(self, robot: str, options: Mapping[str, Any], around: Surroundings) -> Receiver: ...


class PositionSourceFactory(Protocol):
    """What an entry point in `fieldkit.positions` names."""

    def __call__(self, options: Mapping[str, Any], around: Surroundings) -> PositionSource: ...


class VehicleLinkFactory(Protocol):
    """What an entry point in `fieldkit.vehicles` names: robots that share an address share one link.

    `robots` maps a robot's name to its own options (for MAVLink: `system_id`).
    """

    def __call__(
        self, address: str, robots: Mapping[str, Mapping[str, Any]], around: Surroundings
    ) -> VehicleLink: ...
