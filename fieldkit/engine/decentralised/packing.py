"""Observations as few bytes: numbers of variable length, poses as differences from the one before. Pure.

Numbers are little-endian groups of seven bits, signed ones in zigzag form (the varints of Protocol Buffers,
https://protobuf.dev/programming-guides/encoding/). Places are whole millimetres, headings tenths of a degree, levels
hundredths of a decibel, times steps of 0.1 ms. `quantised` gives an observation as it comes out of its bytes: a robot
logs its own in that form, so that everybody computes with the same bits.
"""

import math
from collections.abc import Sequence
from typing import Any, get_args, get_type_hints

from fieldkit.engine.decentralised.entries import STEP_NS, Entry, Observation, Part, Stream, stream_of
from fieldkit.errors import RecordingError
from fieldkit.messages import Operator, Pose, ReceiverState, RssReading, RssVia, VehicleMode, VehicleState

VIA: tuple[RssVia, ...] = get_args(RssVia)
MODES: tuple[VehicleMode, ...] = get_args(VehicleMode)
ACTIONS: tuple[Any, ...] = get_args(get_type_hints(Operator)["action"])
MM, TENTHS, HUNDREDTHS = 1_000, 10, 100
LARGEST = 2**63
"""Numbers beyond are no measurements of ours."""
LONGEST_TEXT = 120
"""Bytes of a reason or a frame's address; what is longer is cut."""


class Bytes:
    """Bytes being written."""

    def __init__(self) -> None:
        self.data = bytearray()

    def uint(self, number: int) -> None:
        """A number from 0 on. Raises `ValueError` for others."""
        if not 0 <= number < LARGEST:
            raise ValueError(f"packing: expected a number from 0 to 2^63, got {number}")
        while number > 0x7F:
            self.data.append(number & 0x7F | 0x80)
            number >>= 7
        self.data.append(number)

    def sint(self, number: int) -> None:
        """Any whole number."""
        self.uint(number * 2 if number >= 0 else -2 * number - 1)

    def text(self, text: str) -> None:
        """A short text; cut where it is long."""
        data = text.encode()[:LONGEST_TEXT].decode(errors="ignore").encode()
        self.uint(len(data))
        self.data += data


class Reader:
    """Bytes being read. Raises `RecordingError` where they are not what was written."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def is_done(self) -> bool:
        return self._at >= len(self._data)

    def uint(self) -> int:
        number = shift = 0
        while True:
            if self._at >= len(self._data) or shift > 63:
                raise RecordingError("agents: a message is cut, or none of ours")
            byte = self._data[self._at]
            self._at += 1
            number |= (byte & 0x7F) << shift
            if byte < 0x80:
                return number
            shift += 7

    def sint(self) -> int:
        number = self.uint()
        return number // 2 if number % 2 == 0 else -(number + 1) // 2

    def text(self) -> str:
        size = self.uint()
        data = self._data[self._at : self._at + size]
        if len(data) < size or size > LONGEST_TEXT:
            raise RecordingError("agents: a text in a message is cut, or none of ours")
        self._at += size
        try:
            return data.decode()
        except UnicodeDecodeError:
            raise RecordingError("agents: a text in a message is no UTF-8") from None

    def choice(self, choices: Sequence[Any]) -> Any:
        """One of these, by its number."""
        number = self.uint()
        if number >= len(choices):
            raise RecordingError(f"agents: a message names choice {number} of {len(choices)}")
        return choices[number]


def quantised(event: Observation) -> Observation:
    """The observation as everybody will have it. Raises `ValueError` for numbers that are none."""
    out = Bytes()
    t_ns = event.t_ns // STEP_NS * STEP_NS
    _write_event(out, event, t_ns, None)
    return _read_event(Reader(bytes(out.data)), event.robot or "", stream_of(event), t_ns, None)


def pack_part(out: Bytes, part: Part, robots: Sequence[str], base_ns: int) -> None:
    """Write a part; times count from `base_ns`, which the reader must know. `quantised` entries survive exactly."""
    out.uint(robots.index(part.robot) * len(Stream) + part.stream)
    out.uint(part.first)
    out.uint(len(part.entries))
    last_ns, last = base_ns, None
    for entry in part.entries:
        out.sint((entry.order_ns - last_ns) // STEP_NS)
        _write_event(out, entry.event, entry.order_ns, last)
        last_ns, last = entry.order_ns, entry.event if isinstance(entry.event, Pose) else None


def unpack_part(reader: Reader, robots: Sequence[str], base_ns: int) -> Part:
    """Read a part. Raises `RecordingError` for bytes that hold none."""
    number, first, count = reader.uint(), reader.uint(), reader.uint()
    if number >= len(robots) * len(Stream):
        raise RecordingError(f"agents: a message is about robot {number // len(Stream)} of {len(robots)}")
    robot, stream = robots[number // len(Stream)], Stream(number % len(Stream))
    last_ns, last = base_ns, None
    entries = []
    for _ in range(count):
        last_ns += reader.sint() * STEP_NS
        event = _read_event(reader, robot, stream, last_ns, last)
        last = event if isinstance(event, Pose) else None
        entries.append(Entry(last_ns, event))
    return Part(robot, stream, first, tuple(entries))


def _write_event(out: Bytes, event: Observation, order_ns: int, last: Pose | None) -> None:
    late = (event.t_ns // STEP_NS) - order_ns // STEP_NS
    match event:
        case Pose():
            _write_pose(out, event, late, last)
        case RssReading():
            _write_reading(out, event, late)
        case ReceiverState():
            out.uint(0)
            out.sint(late)
            out.uint(event.up)
            out.text(event.reason)
        case VehicleState():
            out.uint(1)
            out.sint(late)
            _write_vehicle(out, event)
        case Operator():
            out.uint(2)
            out.sint(late)
            write_order(out, event)


def _read_event(reader: Reader, robot: str, stream: Stream, order_ns: int, last: Pose | None) -> Observation:
    if stream == Stream.PLACES:
        return _read_pose(reader, robot, order_ns, last)
    if stream == Stream.HEARD:
        return _read_reading(reader, robot, order_ns)
    kind = reader.uint()
    t_ns = order_ns + reader.sint() * STEP_NS
    match kind:
        case 0:
            return ReceiverState(t_ns, robot, bool(reader.uint()), reader.text())
        case 1:
            return _read_vehicle(reader, t_ns, robot)
        case 2:
            return read_order(reader, t_ns)
    raise RecordingError(f"agents: expected an order or a state, got kind {kind}")


def _write_pose(out: Bytes, pose: Pose, late: int, last: Pose | None) -> None:
    before = last or Pose(0, "", 0.0, 0.0, origin="")
    up, sigma = _whole(pose.up_m, MM), _whole(pose.sigma_m, MM)
    higher = up - _whole(before.up_m, MM)
    differs = (late != 0, higher != 0, sigma != _whole(before.sigma_m, MM), pose.origin != before.origin)
    out.uint(sum(flag << bit for bit, flag in enumerate(differs)))
    out.sint(_whole(pose.east_m, MM) - _whole(before.east_m, MM))
    out.sint(_whole(pose.north_m, MM) - _whole(before.north_m, MM))
    turn = _whole(pose.heading_deg, TENTHS) - _whole(before.heading_deg, TENTHS)
    out.sint((turn + 1800) % 3600 - 1800)
    if differs[0]:
        out.sint(late)
    if differs[1]:
        out.sint(higher)
    if differs[2]:
        out.uint(sigma)
    if differs[3]:
        out.text(pose.origin)


def _read_pose(reader: Reader, robot: str, order_ns: int, last: Pose | None) -> Pose:
    before = last or Pose(0, "", 0.0, 0.0, origin="")
    flags = reader.uint()
    east = _whole(before.east_m, MM) + reader.sint()
    north = _whole(before.north_m, MM) + reader.sint()
    heading = (_whole(before.heading_deg, TENTHS) + reader.sint()) % 3600
    t_ns = order_ns + (reader.sint() * STEP_NS if flags & 1 else 0)
    up = _whole(before.up_m, MM) + (reader.sint() if flags & 2 else 0)
    sigma = reader.uint() if flags & 4 else _whole(before.sigma_m, MM)
    origin = reader.text() if flags & 8 else before.origin
    return Pose(t_ns, robot, east / MM, north / MM, up / MM, heading / TENTHS, sigma / MM, origin)


def _write_reading(out: Bytes, reading: RssReading, late: int) -> None:
    optional = (reading.channel, reading.frame_id, reading.lqi, reading.sensitivity_dbm)
    flags = sum((value is not None) << bit for bit, value in enumerate(optional))
    out.uint(flags | bool(late) << 4 | reading.saturated << 5)
    out.sint(_whole(reading.rss_dbm, HUNDREDTHS))
    out.uint(VIA.index(reading.via))
    if late:
        out.sint(late)
    if reading.channel is not None:
        out.sint(reading.channel)
    if reading.frame_id is not None:
        out.text(reading.frame_id)
    if reading.lqi is not None:
        out.sint(reading.lqi)
    if reading.sensitivity_dbm is not None:
        out.sint(_whole(reading.sensitivity_dbm, HUNDREDTHS))


def _read_reading(reader: Reader, robot: str, order_ns: int) -> RssReading:
    flags = reader.uint()
    rss, via = reader.sint(), reader.choice(VIA)
    t_ns = order_ns + (reader.sint() * STEP_NS if flags & 16 else 0)
    channel = reader.sint() if flags & 1 else None
    frame_id = reader.text() if flags & 2 else None
    lqi = reader.sint() if flags & 4 else None
    weakest = reader.sint() / HUNDREDTHS if flags & 8 else None
    saturated = bool(flags & 32)
    return RssReading(t_ns, robot, rss / HUNDREDTHS, via, channel, frame_id, lqi, saturated, weakest)


def _write_vehicle(out: Bytes, state: VehicleState) -> None:
    on_ground = 0 if state.on_ground is None else 1 + state.on_ground
    out.uint(state.armed | state.link_up << 1 | state.flies << 2 | on_ground << 3)
    out.uint(MODES.index(state.mode))
    for value, parts in ((state.battery_pct, TENTHS), (state.battery_v, HUNDREDTHS), (state.speed_m_s, MM)):
        out.uint(0 if value is None else 1 + max(0, _whole(value, parts)))
    out.text(state.text)
    out.text(state.reason)


def _read_vehicle(reader: Reader, t_ns: int, robot: str) -> VehicleState:
    flags, mode = reader.uint(), reader.choice(MODES)
    numbers: list[float | None] = []
    for parts in (TENTHS, HUNDREDTHS, MM):
        value = reader.uint()
        numbers.append((value - 1) / parts if value else None)
    return VehicleState(
        t_ns,
        robot,
        mode,
        bool(flags & 1),
        bool(flags & 2),
        battery_pct=numbers[0],
        text=reader.text(),
        battery_v=numbers[1],
        speed_m_s=numbers[2],
        flies=bool(flags & 4),
        on_ground=None if not flags >> 3 else flags >> 3 == 2,
        reason=reader.text(),
    )


def write_order(out: Bytes, order: Operator) -> None:
    """An operator's order, its time apart."""
    out.uint(ACTIONS.index(order.action))
    out.text(order.robot or "")
    out.text(order.reason)
    out.uint(0 if order.source is None else 1 + order.source)
    out.uint(len(order.area_m))
    for corner in order.area_m:
        for value in corner:
            out.sint(_whole(value, MM))


def read_order(reader: Reader, t_ns: int) -> Operator:
    """An operator's order."""
    action, robot, reason, source = reader.choice(ACTIONS), reader.text(), reader.text(), reader.uint()
    area_m = tuple((reader.sint() / MM, reader.sint() / MM) for _ in range(reader.uint()))
    return Operator(t_ns, action, robot or None, reason, source - 1 if source else None, area_m)


def _whole(value: float, parts: int) -> int:
    if not math.isfinite(value):
        raise ValueError(f"packing: expected a number, got {value}")
    return round(value * parts)
