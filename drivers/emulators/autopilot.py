"""What every emulated autopilot says and answers, whatever it drives: a state machine without a clock or a wire.

Streams, texts, parameters, plans, arming and its checks. What moves, and which places it takes, is for `rover` and
`copter`. Answers, refusals and silences are those measured on ArduRover and ArduCopter 4.7 in simulation.
"""

import abc
import math
from dataclasses import dataclass, field

import numpy as np

from drivers.emulators.plans import PlanStore
from drivers.emulators.profiles import ROVER, Profile, px4_mode
from drivers.emulators.telemetry import DEFAULT_HZ, STREAMS, Telemetry, Trouble
from drivers.mavlink.codec import Message, Packer, Parser, mavlink
from drivers.mavlink.signing import Signer
from fieldkit.geo import FieldFrame
from fieldkit.world.bodies import Car, Copter
from fieldkit.world.wander import Wander

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = 0, 1, 2, 3, 4
FENCE_TYPE_POLYGON = 4
PREARM_EVERY_S = 30.0
"""How often it says by itself why it would not arm."""
LOW_BATTERY_S = 10.0
"""BATT_LOW_TIMER: how long its voltage has to be low."""
FULL_V, EMPTY_V = 12.6, 10.5


@dataclass
class Autopilot(Telemetry):
    """One autopilot with the body it drives. Times are seconds on the emulated world's scale."""

    system_id: int
    body: Car | Copter
    frame: FieldFrame
    rng: np.random.Generator
    boot_s: float = -60.0
    pose_noise_m: float = 0.0
    """Standard deviation of each reported coordinate; the body's own position is exact."""
    wander: Wander | None = None
    """An error of all reported positions."""
    gcs_failsafe_s: float = 6.5
    """Its failsafe acts when the ground station's heartbeat is older, with the parameters it starts with.

    0 is FS_GCS_ENABLE off. Live from the first heartbeat. Where world time runs faster than the wall's, it is longer
    than what the parameters say.
    """
    battery_pct: float = 100.0
    trouble: Trouble = field(default_factory=Trouble)
    utc_s: float | None = None
    """UTC at time 0, from its GPS; None: it does not know."""
    signer: Signer | None = None
    profile: Profile = ROVER

    def __post_init__(self) -> None:
        self.mode = self.profile.starts_in
        self.armed = False
        self.home_m = (self.body.east_m, self.body.north_m)
        self._target: tuple[int, int] = (0, 0)
        self._target_m: tuple[float, float] | None = None
        self._packer = Packer(self.system_id, 1, self.signer)
        self._parser = Parser(self.signer)
        self._out: list[Message] = []
        self._moved_s: float | None = None
        self._heartbeat_s: float | None = None
        """When the ground station's last heartbeat came."""
        self._failsafe = False
        self._station_lost = False
        self._low_since_s: float | None = None
        self._battery_failsafe = False
        self._said_s = -math.inf
        """When it last said why it would not arm."""
        self.plans = PlanStore()
        self.parameters = dict(self.profile.parameters)
        if "FS_GCS_ENABLE" in self.parameters and not self.gcs_failsafe_s:
            self.parameters["FS_GCS_ENABLE"] = 0.0
        self._speed_m_s = self.own_speed_m_s
        self._start_streams()

    def _start_streams(self) -> None:
        self._interval_s = {number: 1.0 / hz if hz else 0.0 for number, hz in DEFAULT_HZ.items()}
        self._due_s = dict.fromkeys(DEFAULT_HZ, -math.inf)

    # For the kinds of vehicles to fill in

    @property
    @abc.abstractmethod
    def own_speed_m_s(self) -> float:
        """Its speed where no order sets one."""

    @abc.abstractmethod
    def _move(self, t_s: float) -> None: ...

    @abc.abstractmethod
    def _reposition(self, message: Message) -> int: ...

    @abc.abstractmethod
    def _change_speed(self, speed_m_s: float) -> int: ...

    def _take_off(self, up_m: float) -> int:
        return UNSUPPORTED

    def _position_target(self, message: Message) -> None:
        """Nothing, without a word."""

    @abc.abstractmethod
    def _gcs_failsafe(self) -> None: ...

    @abc.abstractmethod
    def _low_battery(self) -> None: ...

    # Outside

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Bytes from a ground station; what is sent back at once."""
        for message in self._parser.parse(data):
            if getattr(message, "target_system", 0) in (0, self.system_id):
                self._hear(message, t_s)
        return self._packed()

    def update(self, t_s: float) -> bytes:
        """Go on to `t_s`; what is sent until then."""
        self._move(t_s)
        self._watch_ground_station(t_s)
        self._watch_battery(t_s)
        self._complain(t_s)
        self._out += self.plans.update(t_s)
        for number, interval_s in self._interval_s.items():
            if interval_s > 0 and t_s >= self._due_s[number]:
                late = t_s - self._due_s[number] > interval_s
                self._due_s[number] = t_s + interval_s if late else self._due_s[number] + interval_s
                self._out.append(STREAMS[number](self, t_s))
        return self._packed()

    def reboot(self, t_s: float) -> None:
        """Start afresh: disarmed, default rates, a new boot clock."""
        self.boot_s, self.armed, self._heartbeat_s, self._failsafe = t_s, False, None, False
        self._change_mode(self.profile.starts_in)
        self._target, self._target_m = (0, 0), None
        self._start_streams()
        self.say("GPS 1: detected u-blox", mavlink.MAV_SEVERITY_INFO)

    def operator_sets(self, mode: int) -> None:
        """Someone at the remote control changes the mode."""
        self._change_mode(mode)

    def lose_gps(self, lost: bool) -> None:
        """Without GPS the EKF fails over, while dead-reckoned positions go on being sent."""
        self.trouble.gps_lost = lost
        if lost and self.armed:
            self.say("EKF variance")
            self.say("EKF failsafe")
            self._change_mode(self.profile.blind)

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
            if message.get_srcSystem() == self.parameters.get("MAV_GCS_SYSID", message.get_srcSystem()):
                self._heartbeat_s = t_s
        elif kind == "COMMAND_LONG":
            self._ack(message, self._command_long(message, t_s))
        elif kind == "COMMAND_INT":
            reposition = message.command == mavlink.MAV_CMD_DO_REPOSITION
            self._ack(message, self._reposition(message) if reposition else UNSUPPORTED)
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
        if command == mavlink.MAV_CMD_RUN_PREARM_CHECKS:
            return self._run_prearm_checks(t_s)
        if command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_interval(int(message.param1), message.param2, t_s)
        if command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            if int(message.param1) not in STREAMS:
                return FAILED
            self._out.append(STREAMS[int(message.param1)](self, t_s))
            return ACCEPTED
        if command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
            return self._change_speed(message.param2) if message.param2 > 0 else FAILED
        if command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
            return self._set_mode(self.profile.home[0])
        if command == mavlink.MAV_CMD_NAV_TAKEOFF:
            return self._take_off(message.param7)
        if command == mavlink.MAV_CMD_DO_REPOSITION and self.profile.modes_in_two_parts:
            return self._pause(message)
        return UNSUPPORTED  # DO_REPOSITION too: only as COMMAND_INT

    def _pause(self, message: Message) -> int:
        """PX4: a reposition to nowhere is a stop."""
        if not math.isnan(message.param5) or self.trouble.refuses_hold:
            return DENIED
        self._target_m = None
        self._change_mode(self.profile.hold)
        return ACCEPTED

    def _asked_mode(self, message: Message) -> int:
        """DO_SET_MODE's mode: one number, or PX4's two."""
        if self.profile.modes_in_two_parts:
            return px4_mode(int(message.param2), int(message.param3))
        return int(message.param2)

    def _aim(self, lat: int, lon: int) -> None:
        self._target = (lat, lon)
        east_m, north_m, _ = self.frame.to_local(lat / 1e7, lon / 1e7)
        self._target_m = (east_m, north_m)
        self.body.begin_leg()

    def _set_mode(self, mode: int) -> int:
        if mode not in self.profile.modes or (mode == self.profile.hold and self.trouble.refuses_hold):
            return FAILED
        if mode == self.profile.auto:
            self.say("No Mission. Can't set AUTO.")
            return FAILED
        self._change_mode(mode)
        return ACCEPTED

    def _change_mode(self, mode: int) -> None:
        """A heartbeat goes out at once with the new mode. Every entry forgets target and speed."""
        if mode != self.mode:
            self._target_m = None
            self._speed_m_s = self.own_speed_m_s
        self.mode = mode
        self._out.append(self._heartbeat(0.0))

    def _fence_polygon(self) -> list[Message]:
        """Corners of the fence that it stays inside; empty where none is enabled."""
        if not self.parameters.get("FENCE_ENABLE"):
            return []
        return self.plans.items.get(mavlink.MAV_MISSION_TYPE_FENCE, [])

    # Arming

    def _why_not_to_arm(self) -> str:
        if self.trouble.prearm:
            return self.trouble.prearm.removeprefix("PreArm: ")
        if self.trouble.gps_lost:
            return "GPS 1: Bad fix"
        if self.parameters.get("FENCE_ENABLE") and not self._fence_polygon():
            return "Fences enabled, but none selected"
        return ""

    def _run_prearm_checks(self, t_s: float) -> int:
        if self.armed:
            return TEMPORARILY_REJECTED
        self._said_s = -math.inf
        self._complain(t_s)
        return ACCEPTED

    def _complain(self, t_s: float) -> None:
        """Why it would not arm: every 30 s, or when asked."""
        if not self.armed and t_s - self._said_s >= PREARM_EVERY_S and (why := self._why_not_to_arm()):
            self._said_s = t_s
            self.say(f"PreArm: {why}", mavlink.MAV_SEVERITY_CRITICAL)

    def _arm(self, wanted: bool) -> int:
        if wanted and not self.armed and (why := self._why_not_to_arm()):
            self.say(f"Arm: {why}", mavlink.MAV_SEVERITY_CRITICAL)
            return FAILED
        self.armed = wanted
        self._out.append(self._heartbeat(0.0))
        return ACCEPTED

    def _set_interval(self, number: int, interval_us: float, t_s: float) -> int:
        if number not in STREAMS:
            return FAILED
        default_hz = DEFAULT_HZ[number]
        default_s = 1.0 / default_hz if default_hz else 0.0
        self._interval_s[number] = default_s if interval_us == 0 else max(0.0, interval_us * 1e-6)
        self._due_s[number] = t_s
        return ACCEPTED

    # What it watches

    @property
    def _silence_s(self) -> float:
        """How long a ground station may be silent, by its parameters."""
        nominal = dict(self.profile.parameters)
        names = [name for name in ("FS_GCS_TIMEOUT", "FS_TIMEOUT", "COM_DL_LOSS_T") if name in nominal]
        longer = sum(self.parameters[name] for name in names) / sum(nominal[name] for name in names)
        return self.gcs_failsafe_s * longer

    def _watch_ground_station(self, t_s: float) -> None:
        off = self.parameters.get("FS_GCS_ENABLE") == 0 or self.parameters.get("NAV_DLL_ACT") == 0
        if off or not self.gcs_failsafe_s or self._heartbeat_s is None:
            return
        self._station_lost = lost = t_s - self._heartbeat_s > self._silence_s
        if lost and not self._failsafe and self.armed:
            self._failsafe = True
            self._gcs_failsafe()
        elif self._failsafe and not lost:
            self._failsafe = False
            self.say("GCS Failsafe Cleared")  # and stays in the mode it is in

    @property
    def battery_v(self) -> float:
        """Between full and empty with its charge, unless something is wrong with it."""
        if self.trouble.battery_v is not None:
            return self.trouble.battery_v
        return EMPTY_V + (FULL_V - EMPTY_V) * self.battery_pct / 100.0

    def _watch_battery(self, t_s: float) -> None:
        limit_v = self.parameters.get("BATT_LOW_VOLT", 0.0)
        low = limit_v > 0 and self.battery_v < limit_v and self.armed
        self._low_since_s = (t_s if self._low_since_s is None else self._low_since_s) if low else None
        if self._low_since_s is None:
            self._battery_failsafe = False
        elif t_s - self._low_since_s >= LOW_BATTERY_S and not self._battery_failsafe:
            self._battery_failsafe = True
            self.say(f"Battery 1 is low {self.battery_v:.2f}V used 0 mAh")
            self._low_battery()
