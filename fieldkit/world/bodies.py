"""How vehicles move, in simulated missions and behind emulated wires alike. Pure.

A rover turns on the spot, a car turns wide and rolls out, a copter climbs, flies and lands: one kinematic body, three
ways to steer it. The car is measured on ArduRover 4.7 (car-steered, from 1 m/s): after HOLD it rolls on for 0.9 to
1.5 m and 5 s, it rests up to 0.4 m from its way-point, and a way-point inside its turning circle is given up once it is
passed.
"""

import math
from dataclasses import dataclass

from fieldkit import settings as given

STANDS_M_S = 0.02
"""Slower than this it stands."""
ARRIVED_M = 0.02
"""So near to its target a copter hangs over it."""
WIDE_DEG = 60.0
"""One that turns on the spot drives on only when it points nearer to its target than this."""


@dataclass(slots=True)
class Body:
    """Place, heading (clockwise from north) and speed in the field frame; a target, and limits on how it gets there."""

    east_m: float
    north_m: float
    heading_deg: float = 0.0
    up_m: float = 0.0
    speed_m_s: float = 0.0
    max_speed_m_s: float = given.MAX_SPEED_M_S.default
    max_turn_deg_s: float = given.MAX_TURN_DEG_S.default
    max_accel_m_s2: float = 0.5
    target_m: tuple[float, float] | None = None
    target_speed_m_s: float = 0.0

    def go_to(self, east_m: float, north_m: float, speed_m_s: float) -> None:
        """Move to a point and stop there; never faster than the vehicle can."""
        self.target_m = (east_m, north_m)
        self.target_speed_m_s = min(speed_m_s, self.max_speed_m_s)

    def stop(self) -> None:
        """Brake and stay."""
        self.target_m = None

    def _offset_m(self, target_m: tuple[float, float]) -> tuple[float, float]:
        """How far east and north of here."""
        return target_m[0] - self.east_m, target_m[1] - self.north_m

    def _turn_towards(self, target_m: tuple[float, float], most_deg: float) -> float:
        """Turn by no more than that; by how many degrees it still points away from the target."""
        de, dn = self._offset_m(target_m)
        error = (math.degrees(math.atan2(de, dn)) - self.heading_deg + 180.0) % 360.0 - 180.0
        turn = max(-most_deg, min(most_deg, error))
        self.heading_deg = (self.heading_deg + turn) % 360.0
        return abs(error - turn)

    def _change_speed(self, wanted_m_s: float, dt_s: float, *, brakes: float) -> None:
        """Towards the speed that is wanted; it brakes so many times as hard as it accelerates."""
        change = self.max_accel_m_s2 * dt_s
        self.speed_m_s += max(-brakes * change, min(change, wanted_m_s - self.speed_m_s))
        self.speed_m_s = max(0.0, self.speed_m_s)

    def _braking_speed_m_s(self, distance_m: float) -> float:
        """From which it comes to rest within this distance."""
        return math.sqrt(2.0 * self.max_accel_m_s2 * distance_m)

    def _advance(self, travelled_m: float) -> None:
        heading = math.radians(self.heading_deg)
        self.east_m += travelled_m * math.sin(heading)
        self.north_m += travelled_m * math.cos(heading)


@dataclass(slots=True)
class Rover(Body):
    """A differential-drive robot: it turns wide errors away on the spot, and drives to a point."""

    arrive_m: float = 0.05
    """Close enough to a target to stop."""

    def step(self, dt_s: float) -> None:
        """Move on by `dt_s`."""
        if self.target_m is not None and math.hypot(*self._offset_m(self.target_m)) <= self.arrive_m:
            self.target_m = None
        wanted_m_s = 0.0
        if self.target_m is not None:
            left_deg = self._turn_towards(self.target_m, self.max_turn_deg_s * dt_s)
            if left_deg < WIDE_DEG:
                braking_m_s = self._braking_speed_m_s(math.hypot(*self._offset_m(self.target_m)))
                slower = max(0.2, math.cos(math.radians(left_deg)))
                wanted_m_s = min(self.target_speed_m_s, braking_m_s) * slower
        self._change_speed(wanted_m_s, dt_s, brakes=2.0)
        travelled_m = self.speed_m_s * dt_s
        if self.target_m is not None:
            travelled_m = min(travelled_m, math.hypot(*self._offset_m(self.target_m)))
        self._advance(travelled_m)


@dataclass(slots=True)
class Car(Body):
    """A rover that is steered like a car. Its size is in its numbers."""

    max_speed_m_s: float = 0.6
    turn_radius_m: float = 0.2
    """0: turns on the spot, as tracks do."""
    rest_m: float = 0.08
    """How far from its way-point it counts as there, and stops."""
    coast_s: float = 0.4
    """It rolls out with this time constant: from 1 m/s so many metres."""
    _from_m: tuple[float, float] = (0.0, 0.0)
    _done_m: tuple[float, float] | None = None
    """The target it has arrived at, or given up."""

    def begin_leg(self) -> None:
        """A way-point has been given anew: the leg starts here, also where it is the same place."""
        self._from_m = (self.east_m, self.north_m)
        self.target_m = self._done_m = None

    def go_to(self, east_m: float, north_m: float, speed_m_s: float) -> None:
        """Drive to a point and stop there; never faster than the vehicle can."""
        place = (east_m, north_m)
        self.target_speed_m_s = min(speed_m_s, self.max_speed_m_s)
        if place != self._done_m and place != self.target_m:
            self.begin_leg()
            self.target_m = place

    def stop(self) -> None:
        """Roll out and stay."""
        self.target_m = self._done_m = None

    def step(self, dt_s: float) -> None:
        """Move on by `dt_s`."""
        if self.target_m is not None and self._is_there(self.target_m):
            self._done_m, self.target_m = self.target_m, None
        if self.target_m is None:
            self.speed_m_s *= math.exp(-dt_s / self.coast_s)
            self.speed_m_s = 0.0 if self.speed_m_s < STANDS_M_S else self.speed_m_s
        else:
            self._steer(self.target_m, dt_s)
        self._advance(self.speed_m_s * dt_s)

    def _is_there(self, target_m: tuple[float, float]) -> bool:
        """Near enough, or past the line through the way-point across the leg."""
        de, dn = self.east_m - target_m[0], self.north_m - target_m[1]
        along = de * (target_m[0] - self._from_m[0]) + dn * (target_m[1] - self._from_m[1])
        return math.hypot(de, dn) <= self.rest_m or along > 0

    def _steer(self, target_m: tuple[float, float], dt_s: float) -> None:
        rate_deg_s = self.max_turn_deg_s
        if self.turn_radius_m > 0:
            rate_deg_s = min(rate_deg_s, math.degrees(self.speed_m_s / self.turn_radius_m))
        left_deg = self._turn_towards(target_m, rate_deg_s * dt_s)
        to_go_m = max(0.0, math.hypot(*self._offset_m(target_m)) - self.rest_m)
        slower = max(0.4, math.cos(math.radians(left_deg)))
        if self.turn_radius_m <= 0 and left_deg > WIDE_DEG:
            slower = 0.0
        braking_m_s = self._braking_speed_m_s(to_go_m) + STANDS_M_S
        self._change_speed(min(self.target_speed_m_s * slower, braking_m_s), dt_s, brakes=2.0)


def car_sized(east_m: float, north_m: float, heading_deg: float = 0.0) -> Car:
    """The rover of ArduPilot's own simulator, about."""
    return Car(
        east_m,
        north_m,
        heading_deg,
        max_speed_m_s=6.0,
        turn_radius_m=1.8,
        rest_m=0.4,
        coast_s=1.2,
        max_accel_m_s2=1.0,
    )


def car_for(east_m: float, north_m: float, heading_deg: float, max_speed_m_s: float) -> Car:
    """A rover as large as its speed suggests: at 0.4 m/s one for a room, from 1.5 m/s on about a simulator's.

    What turns wide, rests off its way-point and rolls on grows with the speed, as it does from robot to robot.
    """
    return Car(
        east_m,
        north_m,
        heading_deg,
        max_speed_m_s=max_speed_m_s,
        turn_radius_m=min(1.8, 0.5 * max_speed_m_s),
        rest_m=min(0.4, 0.2 * max_speed_m_s),
        coast_s=min(1.2, max(0.4, 0.8 * max_speed_m_s)),
    )


@dataclass(slots=True)
class Copter(Body):
    """A copter: flies straight to a point at a height, brakes, and comes down where it is ordered to."""

    max_speed_m_s: float = 10.0
    max_accel_m_s2: float = 1.0
    brake_m_s2: float = 2.5
    climb_m_s: float = 2.5
    sink_m_s: float = 1.5
    land_m_s: float = 0.5
    target_up_m: float | None = None
    lands: bool = False

    @property
    def on_ground(self) -> bool:
        return self.up_m <= 0.0

    def begin_leg(self) -> None:
        """A copter needs no run-up."""

    def climb_to(self, up_m: float | None) -> None:
        """Go to a height, or stay at this one."""
        self.target_up_m, self.lands = up_m, False

    def go_to(self, east_m: float, north_m: float, speed_m_s: float) -> None:
        """Fly to above a point and stay there."""
        self.target_m, self.lands = (east_m, north_m), False
        self.target_speed_m_s = min(speed_m_s, self.max_speed_m_s)

    def stop(self) -> None:
        """Brake and stay, at this height."""
        self.target_m = self.target_up_m = None
        self.lands = False

    def land(self) -> None:
        """Brake, and come down here."""
        self.target_m = self.target_up_m = None
        self.lands = True

    def step(self, dt_s: float) -> None:
        """Move on by `dt_s`."""
        if self.lands:
            self.up_m = max(0.0, self.up_m - (self.land_m_s if self.up_m < 10.0 else self.sink_m_s) * dt_s)
        elif self.target_up_m is not None:
            self.up_m += max(-self.sink_m_s * dt_s, min(self.climb_m_s * dt_s, self.target_up_m - self.up_m))
        if self.on_ground:
            self.speed_m_s = 0.0
            return
        if self.target_m is None:
            self.speed_m_s = max(0.0, self.speed_m_s - self.brake_m_s2 * dt_s)
        else:
            self._fly(self.target_m, dt_s)
        self._advance(self.speed_m_s * dt_s)

    def _fly(self, target_m: tuple[float, float], dt_s: float) -> None:
        de, dn = self._offset_m(target_m)
        distance = math.hypot(de, dn)
        if distance < ARRIVED_M:
            self.east_m, self.north_m, self.speed_m_s = *target_m, 0.0
            return
        self.heading_deg = math.degrees(math.atan2(de, dn)) % 360.0
        wanted = min(self.target_speed_m_s, self._braking_speed_m_s(distance), distance / dt_s)
        self._change_speed(wanted, dt_s, brakes=4.0)
        self.speed_m_s = min(self.speed_m_s, distance / dt_s)
