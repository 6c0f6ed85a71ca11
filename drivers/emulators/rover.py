"""An autopilot as its telemetry shows it, an ArduRover by default: a state machine without a clock or a wire.

Answers, refusals and silences are those measured on ArduRover 4.7 in simulation: targets ignored without a
word outside GUIDED, DO_REPOSITION only as COMMAND_INT, HOLD that outlasts the failsafe which caused it.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from drivers.emulators.fence import edge_ahead_m
from drivers.emulators.plans import PlanStore
from drivers.emulators.profiles import ROVER, Profile, px4_mode
from drivers.mavlink.codec import Message, Packer, Parser, mavlink
from drivers.mavlink.signing import Signer
from fieldkit.geo import FieldFrame
from fieldkit.world.rover import Rover

MANUAL, HOLD, RTL, GUIDED = ROVER.manual, ROVER.hold, ROVER.home[0], ROVER.guided
"""ArduRover's, which is what is emulated unless a profile says otherwise."""
STALL_M = 3.0
"""How far before its own fence an ArduRover stops (measured: 2 to 3.5 m at 5 m/s)."""
STEP_S = 0.1
"""Longest step of the motion."""
POSITION_ONLY = 0x0DF8
"""Type mask of a position target: velocity, acceleration and yaw ignored."""
ACCELERATION_IGNORED = 0x01C0

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4

_DEFAULT_HZ = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 4.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: 0.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 0.0,
}


@dataclass
class Trouble:
    """What is wrong with the rover, set from outside."""

    gps_lost: bool = False
    stuck: bool = False
    prearm: str = ""
    """Why it will not arm, in the autopilot's words."""


@dataclass
class RoverAutopilot:
    """One autopilot with the rover it drives. Times are seconds on the emulated world's scale."""

    system_id: int
    body: Rover
    frame: FieldFrame
    rng: np.random.Generator
    boot_s: float = -60.0
    pose_noise_m: float = 0.0
    """Standard deviation of each reported coordinate; the body's own position is exact."""
    gcs_failsafe_s: float = 6.5
    """HOLD when the ground station's heartbeat is older; 0 is FS_GCS_ENABLE off. Live from the first one."""
    battery_pct: float = 100.0
    trouble: Trouble = field(default_factory=Trouble)
    utc_s: float | None = None
    """UTC at time 0, from its GPS; None: it does not know."""
    signer: Signer | None = None
    profile: Profile = ROVER

    def __post_init__(self) -> None:
        self.mode = self.profile.hold
        self.armed = False
        self.home_m = (self.body.east_m, self.body.north_m)
        self._target: tuple[int, int] = (0, 0)
        self._target_m: tuple[float, float] | None = None
        self._speed_m_s = self.body.max_speed_m_s
        self._packer = Packer(self.system_id, 1, self.signer)
        self._parser = Parser(self.signer)
        self._out: list[Message] = []
        self._moved_s: float | None = None
        self._heartbeat_s: float | None = None
        """When the ground station's last heartbeat came."""
        self._failsafe = False
        self.plans = PlanStore()
        self._fence_e7: tuple[tuple[int, int], ...] = ()
        self._fence: list[tuple[float, float]] = []
        self.parameters = dict(self.profile.parameters)
        if "FS_GCS_ENABLE" in self.parameters:
            self.parameters["FS_GCS_ENABLE"] = 1.0 if self.gcs_failsafe_s else 0.0
        self._start_streams()

    def _start_streams(self) -> None:
        self._interval_s = {number: 1.0 / hz if hz else 0.0 for number, hz in _DEFAULT_HZ.items()}
        self._due_s = dict.fromkeys(_DEFAULT_HZ, -math.inf)

    # Outside

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Bytes from a ground station; what is sent back at once."""
        for message in self._parser.parse(data):
            if getattr(message, "target_system", 0) in (0, self.system_id):
                self._hear(message, t_s)
        return self._packed()

    def update(self, t_s: float) -> bytes:
        """Drive on to `t_s`; what is sent until then."""
        self._move(t_s)
        self._watch_ground_station(t_s)
        self._out += self.plans.update(t_s)
        for number, interval_s in self._interval_s.items():
            if interval_s > 0 and t_s >= self._due_s[number]:
                late = t_s - self._due_s[number] > interval_s
                self._due_s[number] = t_s + interval_s if late else self._due_s[number] + interval_s
                self._out.append(_STREAMS[number](self, t_s))
        return self._packed()

    def reboot(self, t_s: float) -> None:
        """Start afresh: disarmed, HOLD, default rates, a new boot clock."""
        self.boot_s, self.armed, self._heartbeat_s, self._failsafe = t_s, False, None, False
        self._change_mode(self.profile.hold)
        self._target, self._target_m = (0, 0), None
        self._start_streams()

    def operator_sets(self, mode: int) -> None:
        """Someone at the remote control changes the mode."""
        self._change_mode(mode)

    def lose_gps(self, lost: bool) -> None:
        """Without GPS the EKF fails over to HOLD, while dead-reckoned positions go on being sent."""
        self.trouble.gps_lost = lost
        if lost and self.armed:
            self.say("EKF variance")
            self.say("EKF failsafe")
            self._change_mode(self.profile.hold)

    def say(self, text: str, severity: int = mavlink.MAV_SEVERITY_WARNING) -> None:
        """Send a STATUSTEXT, in chunks of 50 characters as MAVLink 2 does it."""
        raw = text.encode("ascii", "replace")
        chunks = [raw[start : start + 50] for start in range(0, len(raw), 50)] or [b""]
        number = len(self._out) + 1 if len(chunks) > 1 else 0
        for index, chunk in enumerate(chunks):
            self._out.append(mavlink.MAVLink_statustext_message(severity, chunk, number, index))

    def _packed(self) -> bytes:
        out, self._out = self._out, []
        return b"".join(self._packer.pack(message) for message in out)

    # What it hears

    def _hear(self, message: Message, t_s: float) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.type == mavlink.MAV_TYPE_GCS:
            self._heartbeat_s = t_s
        elif kind == "COMMAND_LONG":
            self._ack(message, self._command_long(message, t_s))
        elif kind == "COMMAND_INT":
            self._ack(message, self._command_int(message))
        elif kind == "SET_POSITION_TARGET_GLOBAL_INT":
            self._position_target(message)
        elif kind.startswith("MISSION_"):
            self._out += self.plans.hear(message, t_s)
        elif kind in ("PARAM_REQUEST_READ", "PARAM_SET"):
            self._parameter(message)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            boot_ns = round((t_s - self.boot_s) * 1e9)
            self._out.append(mavlink.MAVLink_timesync_message(boot_ns, message.ts1))

    def _parameter(self, message: Message) -> None:
        """A parameter that is not there is not answered."""
        name = message.param_id
        if name not in self.parameters:
            return
        if message.get_type() == "PARAM_SET":
            self.parameters[name] = message.param_value
            if name == "FS_GCS_ENABLE" and message.param_value == 0:
                self.gcs_failsafe_s = 0.0
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        value = float(self.parameters[name])
        self._out.append(mavlink.MAVLink_param_value_message(name.encode(), value, kind, 1, 0))

    def _ack(self, command: Message, result: int) -> None:
        self._out.append(
            mavlink.MAVLink_command_ack_message(
                command.command, result, 0, 0, command.get_srcSystem(), command.get_srcComponent()
            )
        )

    def _command_long(self, message: Message, t_s: float) -> int:
        command = message.command
        if command == mavlink.MAV_CMD_DO_SET_MODE:
            return self._set_mode(self._asked_mode(message)) if int(message.param1) & 1 else DENIED
        if command == mavlink.MAV_CMD_DO_PAUSE_CONTINUE and self.profile.pauses:
            return ACCEPTED
        if command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            return self._arm(message.param1 == 1)
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(int(message.param1), message.param2, t_s)
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            if int(message.param1) not in _STREAMS:
                return FAILED
            self._out.append(_STREAMS[int(message.param1)](self, t_s))
            return ACCEPTED
        if command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
            return self._change_speed(message.param2)
        if command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return self._set_mode(self.profile.home[0])
        return UNSUPPORTED  # DO_REPOSITION too: only as COMMAND_INT

    def _command_int(self, message: Message) -> int:
        if message.command != mavlink.MAV_CMD_DO_REPOSITION:
            return UNSUPPORTED
        frames = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, mavlink.MAV_FRAME_GLOBAL_INT, 0, 3)
        if message.frame not in frames or (message.x, message.y) == (0, 0) or abs(message.x) > 900_000_000:
            return DENIED
        if self.mode != self.profile.guided and not int(message.param2) & 1:
            return DENIED
        if self.profile.refuses_outside_fence and self._beyond_fence(message.x, message.y):
            return FAILED
        if self.mode != self.profile.guided:
            self._change_mode(self.profile.guided)
        if message.param1 > 0:
            self._speed_m_s = message.param1
        self._aim(message.x, message.y)
        return ACCEPTED

    def _position_target(self, message: Message) -> None:
        """No acknowledgement, and no word outside GUIDED. Takes 0, 0 like any other place."""
        if self.mode != self.profile.guided or message.coordinate_frame not in (5, 6, 11):
            return
        if self.profile.needs_height and message.type_mask & 0x4:
            return
        if message.type_mask & ACCELERATION_IGNORED != ACCELERATION_IGNORED:
            self.say("Ignoring SET_POSITION_TARGET_GLOBAL_INT; set ACC_IGNORE in mask")
        elif not message.type_mask & 0x3 and abs(message.lat_int) <= 900_000_000:
            self._aim(message.lat_int, message.lon_int)

    def _aim(self, lat: int, lon: int) -> None:
        self._target = (lat, lon)
        east_m, north_m, _ = self.frame.to_local(lat / 1e7, lon / 1e7)
        self._target_m = (east_m, north_m)

    def _set_mode(self, mode: int) -> int:
        if mode not in self.profile.modes:
            return FAILED
        if mode == self.profile.auto:
            self.say("No Mission. Can't set AUTO.")
            return FAILED
        self._change_mode(mode)
        return ACCEPTED

    def _change_mode(self, mode: int) -> None:
        """A heartbeat goes out at once with the new mode."""
        if mode != self.mode:
            self._target_m = None
            self._speed_m_s = self.body.max_speed_m_s
        self.mode = mode
        if mode in self.profile.home:
            self._target_m = self.home_m
        self._out.append(self._heartbeat(0.0))

    def _arm(self, wanted: bool) -> int:
        if wanted and (self.trouble.prearm or self.trouble.gps_lost):
            self.say(f"Arm: {self.trouble.prearm or 'GPS 1: Bad fix'}", mavlink.MAV_SEVERITY_CRITICAL)
            return FAILED
        self.armed = wanted
        self._out.append(self._heartbeat(0.0))
        return ACCEPTED

    def _set_interval(self, number: int, interval_us: float, t_s: float) -> int:
        if number not in _STREAMS:
            return FAILED
        default_hz = _DEFAULT_HZ[number]
        default_s = 1.0 / default_hz if default_hz else 0.0
        self._interval_s[number] = default_s if interval_us == 0 else max(0.0, interval_us * 1e-6)
        self._due_s[number] = t_s
        return ACCEPTED

    def _change_speed(self, speed_m_s: float) -> int:
        if speed_m_s <= 0:
            return FAILED
        self._speed_m_s = speed_m_s
        return ACCEPTED

    # What it does

    def _move(self, t_s: float) -> None:
        before_s, self._moved_s = self._moved_s, t_s
        if before_s is None:
            return
        steered = self.mode == self.profile.guided or self.mode in self.profile.home
        driving = self.armed and not self.trouble.stuck and steered and not self._stalls_at_fence()
        if driving and self._target_m is not None:
            self.body.go_to(*self._target_m, self._speed_m_s)
        else:
            self.body.stop()
        left_s = t_s - before_s
        while left_s > 1e-9:
            step_s = min(STEP_S, left_s)
            self.body.step(step_s)
            left_s -= step_s

    def _asked_mode(self, message: Message) -> int:
        """DO_SET_MODE's mode: one number, or PX4's two."""
        if self.profile.modes_in_two_parts:
            return px4_mode(int(message.param2), int(message.param3))
        return int(message.param2)

    def _fence_m(self) -> list[tuple[float, float]]:
        """Corners of its own fence, in metres; empty where none is enabled."""
        if not self.parameters.get("FENCE_ENABLE"):
            return []
        corners = tuple((item.x, item.y) for item in self.plans.items.get(mavlink.MAV_MISSION_TYPE_FENCE, []))
        if corners != self._fence_e7:
            self._fence_e7 = corners
            places = (self.frame.to_local(lat / 1e7, lon / 1e7) for lat, lon in corners)
            self._fence = [(east_m, north_m) for east_m, north_m, _ in places]
        return self._fence

    def _beyond_fence(self, lat: int, lon: int) -> bool:
        east_m, north_m, _ = self.frame.to_local(lat / 1e7, lon / 1e7)
        fence = self._fence_m()
        return bool(fence) and edge_ahead_m((east_m, north_m), (east_m, north_m), fence) < 0

    def _stalls_at_fence(self) -> bool:
        """AVOID_ENABLE 3: it stops about 3 m inside its fence, stays in GUIDED and says nothing."""
        if not (self.profile.avoids_fence and self.parameters.get("AVOID_ENABLE") and self._target_m):
            return False
        fence = self._fence_m()
        here = (self.body.east_m, self.body.north_m)
        braking_m = self.body.speed_m_s**2 / (4.0 * self.body.max_accel_m_s2)
        return bool(fence) and edge_ahead_m(here, self._target_m, fence) < STALL_M + braking_m

    def _watch_ground_station(self, t_s: float) -> None:
        if not self.gcs_failsafe_s or self._heartbeat_s is None:
            return
        lost = t_s - self._heartbeat_s > self.gcs_failsafe_s
        if lost and not self._failsafe and self.armed:
            self._failsafe = True
            self.say("GCS Failsafe")
            self._change_mode(self.profile.hold)
        elif self._failsafe and not lost:
            self._failsafe = False
            self.say("GCS Failsafe Cleared")  # and stays in HOLD

    # What it sends

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
        present = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        health = 0 if self.trouble.prearm else present
        left = round(self.battery_pct)
        return mavlink.MAVLink_sys_status_message(
            present, present, health, 100, 12_000, -1, left, 0, 0, 0, 0, 0, 0
        )

    def _reported(self) -> tuple[int, int]:
        east_m, north_m = self.body.east_m, self.body.north_m
        if self.pose_noise_m > 0:
            noise_m = self.rng.normal(0.0, self.pose_noise_m, 2)
            east_m, north_m = east_m + noise_m[0], north_m + noise_m[1]
        lat_deg, lon_deg, _ = self.frame.to_geodetic(east_m, north_m)
        return round(lat_deg * 1e7), round(lon_deg * 1e7)

    def _global_position(self, t_s: float) -> Message:
        heading = math.radians(self.body.heading_deg)
        north_cm_s = round(100 * self.body.speed_m_s * math.cos(heading))
        east_cm_s = round(100 * self.body.speed_m_s * math.sin(heading))
        altitude_mm = round(self.frame.origin_alt_m * 1e3)
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(t_s),
            *self._reported(),
            altitude_mm,
            0,
            north_cm_s,
            east_cm_s,
            0,
            round(self.body.heading_deg * 100) % 36000,
        )

    def _gps_raw(self, t_s: float) -> Message:
        fix = mavlink.GPS_FIX_TYPE_NO_FIX if self.trouble.gps_lost else mavlink.GPS_FIX_TYPE_RTK_FIXED
        return mavlink.MAVLink_gps_raw_int_message(
            round(t_s * 1e6) % 2**63,
            fix,
            *self._reported(),
            round(self.frame.origin_alt_m * 1e3),
            80,
            120,
            round(self.body.speed_m_s * 100),
            65535,
            14,
            h_acc=round(self.pose_noise_m * 1e3),
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


_STREAMS: dict[int, Callable[[RoverAutopilot, float], Message]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: RoverAutopilot._heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: RoverAutopilot._sys_status,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: RoverAutopilot._gps_raw,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: RoverAutopilot._global_position,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: RoverAutopilot._system_time,
    mavlink.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT: RoverAutopilot._echo_target,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: RoverAutopilot._ekf_status,
}


def streams() -> Iterator[int]:
    """Message numbers an emulated rover can send at a rate."""
    yield from _STREAMS
