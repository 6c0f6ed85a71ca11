"""A differential-drive robot that drives to a point: limited speed, acceleration and turn rate."""

import math
from dataclasses import dataclass


@dataclass(slots=True)
class Rover:
    """Kinematic state in the field frame; heading clockwise from north."""

    east_m: float
    north_m: float
    heading_deg: float = 0.0
    speed_m_s: float = 0.0
    max_speed_m_s: float = 0.4
    max_turn_deg_s: float = 90.0
    max_accel_m_s2: float = 0.5
    arrive_m: float = 0.05
    """Close enough to a target to stop."""
    target_m: tuple[float, float] | None = None
    target_speed_m_s: float = 0.0

    def go_to(self, east_m: float, north_m: float, speed_m_s: float) -> None:
        """Drive to a point and stop there; never faster than the robot can."""
        self.target_m = (east_m, north_m)
        self.target_speed_m_s = min(speed_m_s, self.max_speed_m_s)

    def stop(self) -> None:
        """Brake and stay."""
        self.target_m = None

    def step(self, dt_s: float) -> None:
        """Move on by `dt_s`. A wide heading error is turned away on the spot before driving."""
        wanted_speed = 0.0
        if self.target_m is not None:
            de, dn = self.target_m[0] - self.east_m, self.target_m[1] - self.north_m
            distance = math.hypot(de, dn)
            if distance <= self.arrive_m:
                self.target_m = None
            else:
                error = (math.degrees(math.atan2(de, dn)) - self.heading_deg + 180.0) % 360.0 - 180.0
                turn = max(-self.max_turn_deg_s * dt_s, min(self.max_turn_deg_s * dt_s, error))
                self.heading_deg = (self.heading_deg + turn) % 360.0
                left = abs(error - turn)
                if left < 60.0:
                    braking = math.sqrt(2.0 * self.max_accel_m_s2 * distance)
                    wanted_speed = min(self.target_speed_m_s, braking) * max(
                        0.2, math.cos(math.radians(left))
                    )
        change = self.max_accel_m_s2 * dt_s
        self.speed_m_s += max(-2 * change, min(change, wanted_speed - self.speed_m_s))
        self.speed_m_s = max(0.0, self.speed_m_s)
        heading = math.radians(self.heading_deg)
        travelled = self.speed_m_s * dt_s
        if self.target_m is not None:
            travelled = min(
                travelled, math.hypot(self.target_m[0] - self.east_m, self.target_m[1] - self.north_m)
            )
        self.east_m += travelled * math.sin(heading)
        self.north_m += travelled * math.cos(heading)
