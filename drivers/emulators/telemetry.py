"""What an emulated autopilot says of itself, message by message."""

import abc
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.emulators.profiles import Profile
from drivers.mavlink.codec import Message, mavlink
from fieldkit.geo import FieldFrame
from fieldkit.world.bodies import Car, Copter
from fieldkit.world.wander import Wander

PRESENT = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_GEOFENCE
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
"""Ground stations take a missing bit for a fault: without these they show a fence breach and arming checks off."""

DEFAULT_HZ = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 0.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 0.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.0,
}


@dataclass
class Trouble:
    """What is wrong with the vehicle, set from outside."""

    gps_lost: bool = False
    stuck: bool = False
    refuses_hold: bool = False
    """It answers FAILED where it is asked to hold, and goes on."""
    rolls_on: bool = False
    """It shows that it holds, and goes on where it went: a slope, or a drive that hangs."""
    prearm: str = ""
    """Why it will not arm, in the autopilot's words."""
    battery_v: float | None = None
    """Its voltage, where that says something else than its charge does."""


class Telemetry(abc.ABC):
    """The messages of one autopilot, from what it is and does."""

    body: Car | Copter
    frame: FieldFrame
    rng: np.random.Generator
    boot_s: float
    pose_noise_m: float
    wander: Wander | None
    battery_pct: float
    trouble: Trouble
    utc_s: float | None
    profile: Profile
    mode: int
    armed: bool
    _target: tuple[int, int]

    @property
    @abc.abstractmethod
    def battery_v(self) -> float: ...

    @abc.abstractmethod
    def _why_not_to_arm(self) -> str: ...

    @abc.abstractmethod
    def _fence_polygon(self) -> list[Message]: ...

    def _boot_ms(self, t_s: float) -> int:
        return max(0, round((t_s - self.boot_s) * 1e3))

    def _heartbeat(self, _: float) -> Message:
        base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        base |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        state = mavlink.MAV_STATE_ACTIVE if self.armed else mavlink.MAV_STATE_STANDBY
        return mavlink.MAVLink_heartbeat_message(
            self.profile.vehicle_type, self.profile.autopilot, base, self.mode, state, 3
        )

    def _sys_status(self, _: float) -> Message:
        health = PRESENT
        if self._why_not_to_arm():
            health &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
        if self.trouble.gps_lost:
            health &= ~(mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_AHRS)
        enabled = PRESENT
        if not self._fence_polygon():
            enabled &= ~mavlink.MAV_SYS_STATUS_GEOFENCE
        if not self.armed:
            enabled &= ~mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        voltage_mv, left = round(self.battery_v * 1e3), round(self.battery_pct)
        return mavlink.MAVLink_sys_status_message(
            PRESENT, enabled, health, 100, voltage_mv, -1, left, 0, 0, 0, 0, 0, 0
        )

    def _reported(self, t_s: float) -> tuple[int, int]:
        east_m, north_m = self.body.east_m, self.body.north_m
        if self.wander is not None:
            east_off_m, north_off_m = self.wander.at(t_s)
            east_m, north_m = east_m + east_off_m, north_m + north_off_m
        if self.pose_noise_m > 0:
            noise_m = self.rng.normal(0.0, self.pose_noise_m, 2)
            east_m, north_m = east_m + noise_m[0], north_m + noise_m[1]
        lat_deg, lon_deg, _ = self.frame.to_geodetic(east_m, north_m)
        return round(lat_deg * 1e7), round(lon_deg * 1e7)

    def _global_position(self, t_s: float) -> Message:
        heading = math.radians(self.body.heading_deg)
        north_cm_s = round(100 * self.body.speed_m_s * math.cos(heading))
        east_cm_s = round(100 * self.body.speed_m_s * math.sin(heading))
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(t_s),
            *self._reported(t_s),
            round((self.frame.origin_alt_m + self.body.up_m) * 1e3),
            self._relative_alt_mm(),
            north_cm_s,
            east_cm_s,
            0,
            round(self.body.heading_deg * 100) % 36000,
        )

    def _relative_alt_mm(self) -> int:
        """ArduRover's simulator gives the height above the sea here, without a word."""
        return round((self.frame.origin_alt_m + self.body.up_m) * 1e3)

    def _gps_raw(self, t_s: float) -> Message:
        fix = mavlink.GPS_FIX_TYPE_NO_FIX if self.trouble.gps_lost else mavlink.GPS_FIX_TYPE_RTK_FIXED
        return mavlink.MAVLink_gps_raw_int_message(
            round(t_s * 1e6) % 2**63,
            fix,
            *self._reported(t_s),
            round((self.frame.origin_alt_m + self.body.up_m) * 1e3),
            80,
            120,
            round(self.body.speed_m_s * 100),
            65535,
            14,
            h_acc=round(1e3 * math.hypot(self.pose_noise_m, self.wander.sigma_m if self.wander else 0.0)),
        )

    def _ekf_status(self, _: float) -> Message:
        """Without GPS the horizontal position is no longer absolute."""
        flags = 0x0327 | (0 if self.trouble.gps_lost else mavlink.ESTIMATOR_POS_HORIZ_ABS)
        return mavlink.MAVLink_ekf_status_report_message(flags, 0.05, 0.05, 0.05, 0.05, 0.0)

    def _system_time(self, t_s: float) -> Message:
        utc_us = 0 if self.utc_s is None else round((self.utc_s + t_s) * 1e6)
        return mavlink.MAVLink_system_time_message(utc_us, self._boot_ms(t_s))

    def _echo_target(self, t_s: float) -> Message:
        return mavlink.MAVLink_position_target_global_int_message(
            self._boot_ms(t_s), 0, 0xFDF8, *self._target, 0, 0, 0, 0, 0, 0, 0, 0, 0
        )

    def _landed_state(self) -> int:
        result: int = mavlink.MAV_LANDED_STATE_UNDEFINED
        return result

    def _extended_state(self, _: float) -> Message:
        return mavlink.MAVLink_extended_sys_state_message(0, self._landed_state())


STREAMS: dict[int, Callable[[Telemetry, float], Message]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: Telemetry._heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: Telemetry._sys_status,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: Telemetry._gps_raw,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: Telemetry._global_position,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: Telemetry._system_time,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: Telemetry._echo_target,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: Telemetry._ekf_status,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: Telemetry._extended_state,
}
"""What it can send at a rate, by message number."""
