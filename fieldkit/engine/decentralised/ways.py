"""What a robot announces of where it may be, so that others keep clear of it although they hear of it late. Pure."""

from dataclasses import dataclass

from fieldkit.engine.decentralised.packing import MM, Bytes, Reader
from fieldkit.geometry.segments import Place, Segment

NO_WAY = 0
"""The number of no way."""


@dataclass(frozen=True, slots=True)
class Way:
    """Straight from `start_m` to `end_m`: until it announces another, the robot is on it, or stopped anywhere on it.

    One that stands announces where it stands, as a way of no length. One that `waits` stands at the start until all
    who need to have confirmed that they know of it.
    """

    number: int
    """The tick at which it was announced, by its robot's clock, or one more: each way has another."""
    start_m: Place
    end_m: Place
    speed_m_s: float = 0.0
    waits: bool = False

    @property
    def segment(self) -> Segment:
        return Segment(self.start_m, self.end_m, self.speed_m_s)


def write_way(out: Bytes, way: Way | None, tick: int) -> None:
    """Write it, to whole millimetres. `tick` is that of the message."""
    out.uint(0 if way is None else 1 + way.waits)
    if way is None:
        return
    out.sint(tick - way.number)
    out.uint(round(way.speed_m_s * MM))
    east_m, north_m = way.start_m
    for size_m in (east_m, north_m, way.end_m[0] - east_m, way.end_m[1] - north_m):
        out.sint(round(size_m * MM))


def read_way(reader: Reader, tick: int) -> Way | None:
    """Read what `write_way` has written. Raises `RecordingError` for bytes that are none."""
    kind = reader.choice((None, False, True))
    if kind is None:
        return None
    number, speed = tick - reader.sint(), reader.uint()
    east, north, more_east, more_north = (reader.sint() for _ in range(4))
    start_m, end_m = (east / MM, north / MM), ((east + more_east) / MM, (north + more_north) / MM)
    return Way(number, start_m, end_m, speed / MM, kind)
