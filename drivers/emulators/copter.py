"""An emulated ArduCopter: takes off, flies at the height it is given, brakes, returns and lands.

Measured on ArduCopter 4.7 in simulation: altitude 0 is DENIED, on the ground it takes a place and does nothing, arms
and disarms itself after 10 s, in Brake its ground station failsafe does nothing (FS_OPTIONS 16), a target outside
its fence is FAILED.
"""

from drivers.emulators.autopilot import ACCEPTED, DENIED, FAILED, Autopilot
from drivers.emulators.fence import edge_ahead_m
from drivers.mavlink.codec import Message, mavlink
from fieldkit.world.bodies import Copter

STEP_S = 0.1
DISARM_S = 10.0
"""DISARM_DELAY: how long it stays armed on the ground."""
LANDED_S = 1.5
"""How long it stands before it is sure that it has landed."""
FRAMES_HOME, FRAMES_SEA = (3, 6), (0, 5)
"""MAV_FRAMEs by what their altitude counts from."""
NEAR_HOME_M = 0.5
GOES_ON_WITH_PILOT = 16
LAND, BRAKE, RTL = 9, 17, 6
NOT_ARMABLE = (LAND, BRAKE, RTL, 21)


class CopterAutopilot(Autopilot):
    """A copter."""

    body: Copter

    def __post_init__(self) -> None:
        super().__post_init__()
        self.parameters["WPNAV_SPEED"] = self.parameters["WPNAV_SPEED"] or 100.0 * self.body.max_speed_m_s
        self._speed_m_s = self.own_speed_m_s
        self._up_m: float | None = None
        self._ground_since_s: float | None = None

    @property
    def own_speed_m_s(self) -> float:
        """WPNAV_SPEED."""
        return self.parameters["WPNAV_SPEED"] / 100.0

    def _reposition(self, message: Message) -> int:
        if (message.x, message.y) == (0, 0) or abs(message.x) > 900_000_000:
            return DENIED
        if message.frame in FRAMES_HOME:
            up_m = message.z
        elif message.frame in FRAMES_SEA:
            up_m = message.z - self.frame.origin_alt_m
        else:
            return DENIED
        if up_m == 0 or (self.mode != self.profile.guided and not int(message.param2) & 1):
            return DENIED
        if self._beyond_fence(message.x, message.y):
            return FAILED
        if self.mode != self.profile.guided:
            self._change_mode(self.profile.guided)
        self._aim(message.x, message.y)
        self._up_m = up_m
        return ACCEPTED

    def _change_speed(self, speed_m_s: float) -> int:
        self._speed_m_s = speed_m_s
        return ACCEPTED

    def _take_off(self, up_m: float) -> int:
        ready = self.armed and self.body.on_ground and self.mode == self.profile.guided
        if not ready or up_m <= self.body.up_m:
            return FAILED
        self.body.up_m = 0.01  # off the ground
        self._target_m = (self.body.east_m, self.body.north_m)
        self._up_m, self._ground_since_s = up_m, None
        return ACCEPTED

    def _position_target(self, message: Message) -> None:
        """Without a height it is dropped without a word."""
        if self.mode != self.profile.guided or message.type_mask & 0x4 or self.body.on_ground:
            return
        self._aim(message.lat_int, message.lon_int)
        self._up_m = message.alt

    def _why_not_to_arm(self) -> str:
        return super()._why_not_to_arm() or ("GCS failsafe on" if self._station_lost else "")

    def _arm(self, wanted: bool) -> int:
        if wanted and not self.armed and self.mode in NOT_ARMABLE:
            self.say("Arm: Mode not armable", mavlink.MAV_SEVERITY_CRITICAL)
            return FAILED
        if not wanted and not self.body.on_ground:
            return FAILED  # only by force, which is a crash
        return super()._arm(wanted)

    def _change_mode(self, mode: int) -> None:
        super()._change_mode(mode)
        self._up_m = None

    def _gcs_failsafe(self) -> None:
        action = self.parameters["FS_GCS_ENABLE"]
        if self.body.on_ground:
            self.say("GCS Failsafe - Disarming")
            super()._arm(False)
        elif int(self.parameters["FS_OPTIONS"]) & GOES_ON_WITH_PILOT and self.mode == BRAKE:
            self.say("GCS Failsafe - Continuing Pilot Control")
        else:
            self.say("GCS Failsafe")
            self._change_mode({5.0: LAND, 7.0: BRAKE}.get(action, RTL))

    def _low_battery(self) -> None:
        if action := self.parameters["BATT_FS_LOW_ACT"]:
            self._change_mode({1.0: LAND}.get(action, RTL))

    def _beyond_fence(self, lat: int, lon: int) -> bool:
        fence = [self.frame.to_local(item.x / 1e7, item.y / 1e7)[:2] for item in self._fence_polygon()]
        place = self.frame.to_local(lat / 1e7, lon / 1e7)[:2]
        return bool(fence) and edge_ahead_m(place, place, fence) < 0

    # How it flies

    def _move(self, t_s: float) -> None:
        before_s, self._moved_s = self._moved_s, t_s
        if before_s is None:
            return
        self._steer()
        left_s = t_s - before_s
        while left_s > 1e-9:
            step_s = min(STEP_S, left_s)
            self.body.step(step_s)
            left_s -= step_s
        self._stand(t_s)

    def _steer(self) -> None:
        body = self.body
        if body.on_ground or not self.armed:
            body.stop()
        elif self.mode == self.profile.guided and self._target_m is not None and not self.trouble.stuck:
            body.go_to(*self._target_m, self._speed_m_s)
            body.climb_to(self._up_m)
        elif self.mode in self.profile.home:
            self._fly_home()
        elif self.mode == LAND:
            body.land()
        else:
            body.stop()

    def _fly_home(self) -> None:
        """Up to RTL_ALT, then home, then down."""
        body, up_m = self.body, self.parameters["RTL_ALT"] / 100.0
        off_m = ((body.east_m - self.home_m[0]) ** 2 + (body.north_m - self.home_m[1]) ** 2) ** 0.5
        if body.lands or off_m < NEAR_HOME_M:
            body.land()
        elif body.up_m < up_m - 0.1:
            body.stop()
            body.climb_to(up_m)
        else:
            body.go_to(*self.home_m, (self.parameters["RTL_SPEED"] or self.parameters["WPNAV_SPEED"]) / 100.0)

    def _stand(self, t_s: float) -> None:
        """Armed on the ground: it disarms itself, soon after a landing and later before a take-off."""
        if not self.body.on_ground or not self.armed:
            self._ground_since_s = None
            return
        self._ground_since_s = t_s if self._ground_since_s is None else self._ground_since_s
        landing = self.mode == LAND or self.mode in self.profile.home
        if t_s - self._ground_since_s >= (LANDED_S if landing else DISARM_S):
            super()._arm(False)

    def _relative_alt_mm(self) -> int:
        return round(self.body.up_m * 1e3)

    def _landed_state(self) -> int:
        result: int = (
            mavlink.MAV_LANDED_STATE_ON_GROUND if self.body.on_ground else mavlink.MAV_LANDED_STATE_IN_AIR
        )
        return result
