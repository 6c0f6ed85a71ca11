"""What stands in robots' logs: observations, each with the time by which it is ordered, and parts of logs. Pure."""

from dataclasses import dataclass
from enum import IntEnum

from fieldkit.messages import Operator, Pose, ReceiverState, RssReading, VehicleState

STEP_NS = 100_000
"""Times in logs are whole steps of 0.1 ms: far below what clocks of robots agree to."""
Observation = RssReading | ReceiverState | Pose | VehicleState | Operator


class Stream(IntEnum):
    """The logs of one robot, the most urgent first."""

    ORDERS = 0
    HEARD = 1
    PLACES = 2


Key = tuple[str, Stream]
"""One log: whose, and which."""


def stream_of(event: Observation) -> Stream:
    """The log an observation belongs to."""
    if isinstance(event, Pose):
        return Stream.PLACES
    return Stream.HEARD if isinstance(event, RssReading) else Stream.ORDERS


@dataclass(frozen=True, slots=True)
class Entry:
    """One observation, and the time by which it is ordered among those of all robots."""

    order_ns: int
    event: Observation


@dataclass(frozen=True, slots=True)
class Part:
    """Consecutive entries of one log; `first` is the number of the first, counted from 0."""

    robot: str
    stream: Stream
    first: int
    entries: tuple[Entry, ...]

    @property
    def key(self) -> Key:
        return self.robot, self.stream
