"""An emulated ArduRover (or PX4 rover): which places and speeds it takes, how it drives, stops and returns.

Measured on ArduRover 4.7 in simulation: Guided is entered in a stop submode that takes no speed, targets outside
Guided are ignored without a word, DO_REPOSITION only as COMMAND_INT, HOLD outlasts the failsafe that caused it, it
returns at a speed of its own.
"""

from typing import Any

import numpy as np

from drivers.emulators.autopilot import (
    ACCEPTED,
    DENIED,
    FAILED,
    Autopilot,
)
from drivers.emulators.copter import CopterAutopilot
from drivers.emulators.fence import edge_ahead_m
from drivers.emulators.profiles import COPTER, ROVER, Profile
from drivers.mavlink.codec import Message
from fieldkit.geo import FieldFrame
from fieldkit.world.bodies import Copter

MANUAL, HOLD, RTL, GUIDED = ROVER.manual, ROVER.hold, ROVER.home[0], ROVER.guided
"""ArduRover's, which is what is emulated unless a profile says otherwise."""
STALL_M = 3.0
"""How far before its own fence an ArduRover stops (measured: 2 to 3.5 m at 5 m/s)."""
STEP_S = 0.1
"""Longest step of the motion."""
POSITION_ONLY = 0x0DF8
"""Type mask of a position target: velocity, acceleration and yaw ignored."""
ACCELERATION_IGNORED = 0x01C0
FRAMES = (0, 3, 5, 6)
"""MAV_FRAME_GLOBAL and its kin."""
DRIVES_HOME, HOLDS = (1.0, 3.0, 4.0), (2.0, 6.0)
"""FS_ACTION."""


class RoverAutopilot(Autopilot):
    """A rover. WP_SPEED, WP_RADIUS and TURN_RADIUS follow from its body."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if "WP_SPEED" in self.parameters:
            body: Any = self.body
            self.parameters |= {
                "WP_SPEED": self.parameters["WP_SPEED"] or body.max_speed_m_s,
                "WP_RADIUS": 2.0 * body.rest_m,
                "TURN_RADIUS": body.turn_radius_m,
            }
        self._speed_m_s = self.own_speed_m_s
        self._fence_e7: tuple[tuple[int, int], ...] = ()
        self._fence: list[tuple[float, float]] = []

    @property
    def own_speed_m_s(self) -> float:
        """WP_SPEED."""
        return self.parameters.get("WP_SPEED") or self.body.max_speed_m_s

    def _reposition(self, message: Message) -> int:
        if message.frame not in FRAMES or (message.x, message.y) == (0, 0) or abs(message.x) > 900_000_000:
            return DENIED
        if self.mode != self.profile.guided and not int(message.param2) & 1:
            return DENIED
        if self.mode != self.profile.guided:
            self._change_mode(self.profile.guided)
        if message.param1 > 0 and self._change_speed(message.param1) != ACCEPTED:
            return FAILED  # and the place is not taken
        self._aim(message.x, message.y)
        return ACCEPTED

    def _change_speed(self, speed_m_s: float) -> int:
        """Refused in the stop submode: while it has no way-point."""
        if not self.profile.modes_in_two_parts and (
            self.mode != self.profile.guided or self._target_m is None
        ):
            return FAILED
        self._speed_m_s = speed_m_s
        return ACCEPTED

    def _position_target(self, message: Message) -> None:
        """No acknowledgement, and no word outside GUIDED. Takes 0, 0 like any other place."""
        if self.mode != self.profile.guided or message.coordinate_frame not in (5, 6, 11):
            return
        if message.type_mask & ACCELERATION_IGNORED != ACCELERATION_IGNORED:
            self.say("Ignoring SET_POSITION_TARGET_GLOBAL_INT; set ACC_IGNORE in mask")
        elif not message.type_mask & 0x3 and abs(message.lat_int) <= 900_000_000:
            self._aim(message.lat_int, message.lon_int)

    def _change_mode(self, mode: int) -> None:
        super()._change_mode(mode)
        if mode in self.profile.home:
            self._target_m = self.home_m
            self._speed_m_s = self.parameters.get("RTL_SPEED") or self.own_speed_m_s

    def _gcs_failsafe(self) -> None:
        """FS_ACTION, unless it holds or returns already."""
        if self.mode == self.profile.hold and not self.profile.modes_in_two_parts:
            return
        self.say("GCS Failsafe")
        self._fail_over(self.parameters.get("FS_ACTION", 2.0))

    def _low_battery(self) -> None:
        self._fail_over(self.parameters.get("BATT_FS_LOW_ACT", 0.0))

    def _fail_over(self, action: float) -> None:
        if action in DRIVES_HOME:
            self._change_mode(self.profile.home[0])
        elif action in HOLDS:
            if self.profile.modes_in_two_parts:
                self._target_m = None
            self._change_mode(self.profile.hold)
        elif action:
            self._arm(False)

    # How it drives

    def _move(self, t_s: float) -> None:
        before_s, self._moved_s = self._moved_s, t_s
        if before_s is None:
            return
        steered = self.mode == self.profile.guided or self.mode in self.profile.home
        driving = self.armed and not self.trouble.stuck and steered and not self._stalls_at_fence()
        if driving and self._target_m is not None:
            self.body.go_to(*self._target_m, self._speed_m_s)
        elif not self.trouble.rolls_on:
            self.body.stop()
        left_s = t_s - before_s
        while left_s > 1e-9:
            step_s = min(STEP_S, left_s)
            self.body.step(step_s)
            left_s -= step_s

    def _fence_m(self) -> list[tuple[float, float]]:
        """Corners of its own fence, in metres; empty where none is enabled."""
        corners = tuple((item.x, item.y) for item in self._fence_polygon())
        if corners != self._fence_e7:
            self._fence_e7 = corners
            places = (self.frame.to_local(lat / 1e7, lon / 1e7) for lat, lon in corners)
            self._fence = [(east_m, north_m) for east_m, north_m, _ in places]
        return self._fence

    def _stalls_at_fence(self) -> bool:
        """AVOID_ENABLE 3: it stops about 3 m inside its fence, stays in GUIDED and says nothing."""
        if not (self.profile.avoids_fence and self.parameters.get("AVOID_ENABLE") and self._target_m):
            return False
        fence = self._fence_m()
        here = (self.body.east_m, self.body.north_m)
        braking_m = self.body.speed_m_s**2 / (4.0 * self.body.max_accel_m_s2)
        return bool(fence) and edge_ahead_m(here, self._target_m, fence) < STALL_M + braking_m


def make_autopilot(
    profile: Profile, system_id: int, body: Any, frame: FieldFrame, rng: np.random.Generator, **options: Any
) -> Autopilot:
    """The autopilot of a firmware on a body; a copter's firmware gets a copter's body where it has none."""
    if profile is not COPTER:
        return RoverAutopilot(system_id, body, frame, rng, **(options | {"profile": profile}))
    if not isinstance(body, Copter):
        body = Copter(body.east_m, body.north_m, body.heading_deg, max_speed_m_s=body.max_speed_m_s)
    return CopterAutopilot(system_id, body, frame, rng, **(options | {"profile": profile}))
