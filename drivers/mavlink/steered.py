"""One vehicle of ours and what we are doing with it; the messages that set its rates and send it somewhere."""

import math
from dataclasses import dataclass, field

from drivers.mavlink.codec import Message, mavlink
from drivers.mavlink.modes import PX4
from drivers.mavlink.plans import Inbox
from drivers.mavlink.vehicle import Vehicle
from fieldkit.errors import DeviceTimeout, VehicleRefused
from fieldkit.geo import FieldFrame
from fieldkit.messages import Waypoint

RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 0.5,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 0.5,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
}
"""What we want to hear, how often."""
TARGET_TOLERANCE = 10
"""Degrees times 1e7: the vehicle echoes its target exactly; a centimetre of slack."""
ECHO_S = 1.5
"""The echo of a target comes once a second."""
RESENDS = 3
LEAST_UP_M = 1.0
"""A vehicle that flies is sent no lower: ArduCopter denies altitude 0, and below this it would touch the ground."""


@dataclass
class Steered:
    """What we are doing with one vehicle."""

    vehicle: Vehicle
    orders: int = 0
    """Counts commands that change what it should do: an older one gives up."""
    under_way: int = 0
    """How many are waiting to be confirmed."""
    target: tuple[int, int] | None = None
    target_s: float = -math.inf
    speed_m_s: float | None = None
    resent: int = 0
    rates_asked_s: float = -math.inf
    waypoint: Waypoint | None = None
    must_hold: bool = False
    """It was ordered to hold, and nothing else since: ordered again while it still drives where we sent it."""
    hold_unseen_until_s: float = -math.inf
    """Until then a hold that it has not shown yet is repeated, whatever mode it is in."""
    hold_ordered_s: float = -math.inf
    hold_seen: int = 0
    """Heartbeats heard when it was ordered: only a later one can show the hold."""
    inboxes: list[Inbox] = field(default_factory=list)
    time_asked: int | None = None
    """The mark of a TIMESYNC that is to settle a doubt in its clock."""

    def goes_elsewhere(self, now_s: float) -> bool:
        """Whether it is ours, under way, and says that it is going somewhere else than we sent it."""
        vehicle, said = self.vehicle, self.vehicle.position_target
        if self.target is None or said is None or self.under_way:
            return False
        if vehicle.owner != "us" or vehicle.actual_mode != "guided":
            return False
        fresh = vehicle.position_target_s >= self.target_s + ECHO_S
        apart = max(abs(said[0] - self.target[0]), abs(said[1] - self.target[1]))
        return fresh and apart > TARGET_TOLERANCE and self.resent < RESENDS

    def must_be_ordered_to_hold(self, now_s: float) -> bool:
        """Whether a hold has to go out again: not shown yet, or it still follows our last way-point."""
        vehicle = self.vehicle
        if not self.must_hold or vehicle.firmware is None:
            return False
        if vehicle.actual_mode == "hold":
            # PX4 shows its hold mode on its way to a way-point: only what it has shown besides ends the repeating.
            unseen = math.isfinite(self.hold_unseen_until_s)
            return now_s < self.hold_unseen_until_s or (unseen and vehicle.firmware is PX4)
        return now_s < self.hold_unseen_until_s or (vehicle.link_up and vehicle.actual_mode == "guided")

    def newer_order(self) -> int:
        """What went before is off; the number of the order that takes its place."""
        self.orders += 1
        self.target = None
        self.must_hold = False
        self.hold_unseen_until_s = -math.inf
        return self.orders


def refuse_double(vehicle: Vehicle) -> None:
    """Raise `VehicleRefused` where two vehicles answer to one system id."""
    if vehicle.doubles:
        raise VehicleRefused(
            f"{vehicle.robot}: two vehicles have system id {vehicle.system_id}; give each its own "
            "(MAV_SYSID or SYSID_THISMAV) and start again"
        )


def must_be_ours(vehicle: Vehicle) -> None:
    """Raise `DeviceTimeout` or `VehicleRefused` unless the vehicle is ours to drive now."""
    refuse_double(vehicle)
    if not vehicle.link_up:
        raise DeviceTimeout(f"{vehicle.robot}: its link is lost")
    if vehicle.owner != "us":
        why = (vehicle.owner == "lost" and vehicle.lost_because) or "its control was not acquired"
        raise VehicleRefused(f"{vehicle.robot}: not ours to steer: {why}")
    if not vehicle.armed:
        raise VehicleRefused(f"{vehicle.robot}: is disarmed")


def degrees_e7(robot: str, waypoint: Waypoint, frame: FieldFrame) -> tuple[int, int]:
    """Latitude and longitude of a way-point, times 1e7. Raises `VehicleRefused` for a place that is none."""
    numbers = (waypoint.east_m, waypoint.north_m, waypoint.up_m, waypoint.speed_m_s)
    if not all(math.isfinite(number) for number in numbers) or waypoint.speed_m_s <= 0:
        raise VehicleRefused(f"{robot}: {waypoint} is no place to go")
    lat_deg, lon_deg, _ = frame.to_geodetic(waypoint.east_m, waypoint.north_m, waypoint.up_m)
    lat, lon = round(lat_deg * 1e7), round(lon_deg * 1e7)
    # ArduRover takes 0, 0 from a position target and sets off for the Gulf of Guinea.
    if (lat, lon) == (0, 0) or abs(lat) > 900_000_000:
        raise VehicleRefused(f"{robot}: {waypoint} is at latitude {lat_deg}, longitude {lon_deg}: refused")
    return lat, lon


def must_be_high_enough(vehicle: Vehicle, up_m: float) -> None:
    """Raise `VehicleRefused` for a height at which a vehicle that flies would touch the ground."""
    if vehicle.flies and not up_m >= LEAST_UP_M:
        raise VehicleRefused(
            f"{vehicle.robot}: flies, and {up_m:g} m above its home is no height to fly at: at least "
            f"{LEAST_UP_M:g} m"
        )


def interval(vehicle: Vehicle, number: int, rate_hz: float, attempt: int) -> Message:
    """Asks for a message at a rate."""
    command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    return mavlink.MAVLink_command_long_message(
        vehicle.system_id, 1, command, attempt, number, 1e6 / rate_hz, 0, 0, 0, 0, 0
    )


def reposition(vehicle: Vehicle, lat: int, lon: int, up_m: float) -> Message:
    """Integers, never COMMAND_LONG: a float32 longitude is off by metres. The altitude is above home.

    The speed goes by DO_CHANGE_SPEED behind it. ArduRover in Guided has no way-point yet and answers a reposition
    that carries a speed with FAILED; it does not go there.
    """
    frame, height_m = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, up_m if vehicle.flies else 0.0
    if vehicle.firmware is PX4:  # takes the number for a height above the sea, whatever the frame says
        frame, home_m = mavlink.MAV_FRAME_GLOBAL_INT, vehicle.home_alt_m
        height_m = home_m + up_m if vehicle.flies and home_m is not None else math.nan
    change_mode = mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
    return mavlink.MAVLink_command_int_message(
        vehicle.system_id, 1, frame, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, change_mode, 0, math.nan, lat, lon,
        height_m,
    )  # fmt: skip


def change_speed(vehicle: Vehicle, speed_m_s: float, attempt: int) -> Message:
    """Ground speed; ArduRover takes it only while it has a way-point."""
    command = mavlink.MAV_CMD_DO_CHANGE_SPEED
    return mavlink.MAVLink_command_long_message(
        vehicle.system_id, 1, command, attempt, 1, speed_m_s, -1, 0, 0, 0, 0
    )
