"""What is known of one vehicle, from what it says. Pure: no input or output, no clock.

Elapsed times `now_s` are the mission clock's `elapsed_s`, instants `now_ns` its `now_ns`.
"""

import math
from collections import deque
from typing import Literal

from drivers.mavlink.codec import Message, mavlink
from drivers.mavlink.modes import PX4, Firmware, firmware_of, flies
from drivers.mavlink.transport import Peer
from drivers.timebase import TimeBase
from fieldkit.geo import FieldFrame
from fieldkit.messages import Pose, VehicleMode, VehicleState
from fieldkit.settings import DRIFTS_M_S, STANDS_M_S

WARN_S = 2.0
LOST_S = 5.0
"""Age of the autopilot's heartbeat (1 Hz) at which the link counts as lost."""
STATE_EVERY_S = 1.0
SAME_ID_S = 3.0
"""A vehicle silent for this long may have moved to another address."""
FORGET_S = 10.0
SILENT_S = 1.4
"""A heartbeat of ours that is later: the shortest failsafe that a vehicle can be set to is not much longer."""
MAX_SPEAKERS = 8
REBOOT_BACK_MS = 1000
"""A boot clock further back than this means a reboot; less is a datagram out of order."""
TWO_CLOCKS = 3
"""A boot clock that goes back so often within `FORGET_S` is two vehicles' behind one address: none boots so fast."""
LATE_BEATS = 3
"""A vehicle beats once a second. So many beats later it no longer shows an order that a newer one has overtaken."""
NO_POSITION = (0, 0)
MAX_ROUND_TRIP_NS = 1_000_000_000
"""A slower answer says too little of a clock."""

Happening = Pose | VehicleState


class Vehicle:
    """One vehicle as heard on one link."""

    battery_v: float | None = None
    speed_m_s: float | None = None
    """Over ground, as measured."""
    flies = False
    on_ground: bool | None = None
    """None where it does not say."""
    up_m: float | None = None
    """Height above its home."""
    home_alt_m: float | None = None
    """Its home's height above the sea."""
    place: tuple[int, int] | None = None
    """Where it says it is, degrees times 1e7."""

    def __init__(self, robot: str, system_id: int, frame: FieldFrame, sigma_m: float = 0.0) -> None:
        self.robot = robot
        self.system_id = system_id
        self.peer: Peer | None = None
        """Latest address of the autopilot; None before the first heartbeat."""
        self.firmware: Firmware | None = None
        self.custom_mode = -1
        self.armed = False
        self.link_up = False
        self.heartbeat_s = -math.inf
        self.heartbeats = 0
        self.position_s = -math.inf
        self.battery_pct: float | None = None
        self.healthy_to_arm: bool | None = None
        self.gps_fix: int | None = None
        self.gps_eph: int | None = None
        """HDOP times 100; None where it does not say."""
        self.ekf_flags: int | None = None
        self.position_target: tuple[int, int] | None = None
        """Where it says it is going, degrees times 1e7."""
        self.position_target_s = -math.inf
        self.reboots = 0
        self.utc_ahead_s: float | None = None
        """Our clock's lead over the time it has from its GPS; None where it has none."""
        self.texts: deque[tuple[float, str, int]] = deque(maxlen=20)
        """(elapsed time, STATUSTEXT, MAV_SEVERITY), newest last."""
        self.lost_because = ""
        """Why it is not ours any more; empty where it never was, or is."""
        self.doubles: set[Peer] = set()
        """Addresses that claim the same system id; not empty means: do not steer."""
        self.owner: Literal["nobody", "us", "lost"] = "nobody"
        self._beat_s = math.nan
        self._silence = (0.0, -math.inf)
        """How long our heartbeat was last missing for longer than usual, and when that ended."""
        self.commanded: VehicleMode | None = None
        """The mode we asked for last."""
        self._confirmed = False
        self._overtaken: tuple[VehicleMode, int] | None = None
        """A mode we asked for and did not wait to see before we asked for another; heartbeats heard by then."""
        self._frames = self._lost = 0
        self._seq: int | None = None
        self._frame = frame
        self._sigma_m = sigma_m
        self._gps_sigma_m: float | None = None
        self._gps_good = True
        self._time = TimeBase()
        self._pose_t_ns = 0
        self._boot_ms: int | None = None
        self._backs_s: deque[float] = deque(maxlen=TWO_CLOCKS)
        """When its boot clock was last seen to go back."""
        self._heading_deg = 0.0
        self._speakers: dict[Peer, tuple[float, float, int]] = {}
        """Address to its first and last heartbeat and their number."""
        self._chunks: dict[int, str] = {}
        self._reported: tuple[object, ...] = ()
        self._reported_s = -math.inf
        self._why = ""

    # What it says

    def heard(self, message: Message, peer: Peer, now_s: float, now_ns: int) -> list[Happening]:
        """Take in a message of its autopilot; what that means to the mission."""
        kind = message.get_type()
        if peer == self.peer and kind in ("GLOBAL_POSITION_INT", "SYSTEM_TIME"):
            self._boot(message.time_boot_ms, now_s)
        if kind == "HEARTBEAT":
            self._heartbeat(message, peer, now_s)
        elif self.doubles or peer != self.peer:
            return []
        elif kind == "GLOBAL_POSITION_INT":
            return [*self._position(message, now_s, now_ns), *self._report(now_s, now_ns)]
        elif kind == "STATUSTEXT":
            self._text(message, now_s)
        elif kind == "EXTENDED_SYS_STATE":
            known = message.landed_state != mavlink.MAV_LANDED_STATE_UNDEFINED
            self.on_ground = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND if known else None
        elif kind == "SYS_STATUS":
            self._status(message)
        elif kind == "GPS_RAW_INT":
            self._gps(message)
        elif kind == "EKF_STATUS_REPORT":
            self.ekf_flags = message.flags
        elif kind == "POSITION_TARGET_GLOBAL_INT":
            self.position_target, self.position_target_s = (message.lat_int, message.lon_int), now_s
        elif kind == "SYSTEM_TIME" and message.time_unix_usec:
            self.utc_ahead_s = (now_ns - message.time_unix_usec * 1_000) * 1e-9
        return self._report(now_s, now_ns)

    def passed(self, now_s: float, now_ns: int) -> list[Happening]:
        """Time has passed: the link may be lost, the state may be due."""
        if self.link_up and now_s - self.heartbeat_s > LOST_S:
            self.link_up = False
            self._say(now_s, f"no heartbeat for {LOST_S:g} s: link lost")
            # Its own failsafe decides meanwhile; going on needs a new take-over.
            self._lose(f"its link was lost for {LOST_S:g} s")
        if self.doubles:
            self._forget_speakers(now_s)
        return self._report(now_s, now_ns) if self.peer is not None else []

    def _heartbeat(self, message: Message, peer: Peer, now_s: float) -> None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return
        self._watch_for_double(peer, now_s)
        if peer != self.peer:
            return
        if not self.link_up:
            self.link_up = True
            self._say(now_s, "link up" if self.heartbeats == 0 else "link is back")
        self.heartbeat_s = now_s
        self.heartbeats += 1
        self.firmware, self.flies = firmware_of(message), flies(message)
        self.custom_mode = message.custom_mode
        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self._check_ownership(now_s)

    def _watch_for_double(self, peer: Peer, now_s: float) -> None:
        """Follow a vehicle that moved to another address; notice two vehicles that share one system id.

        They differ in this: one that moved is silent at its old address before it speaks at the new one.
        """
        if self.peer is None or (peer != self.peer and now_s - self.heartbeat_s > SAME_ID_S):
            self.peer = peer
        first_s, _, count = self._speakers.get(peer, (now_s, now_s, 0))
        self._speakers[peer] = (first_s, now_s, count + 1)
        self._forget_speakers(now_s)
        mine = self._speakers.get(self.peer, (now_s, now_s, 0))
        doubles = {
            other
            for other, (first_s, last_s, count) in self._speakers.items()
            if other != self.peer and min(count, mine[2]) >= 2 and first_s < mine[1] and mine[0] < last_s
        }
        if self._has_two_clocks(now_s):
            doubles.add(self.peer)
        if doubles - self.doubles:
            where = f"{self.peer} and {min(doubles)}" if doubles != {self.peer} else f"both at {self.peer}"
            self._say(now_s, f"two vehicles have system id {self.system_id}: {where}")
            self._lose(self._why)
        self.doubles = doubles

    def _has_two_clocks(self, now_s: float) -> bool:
        """Whether two vehicles speak from one address, through a router or a shared radio."""
        return len(self._backs_s) == TWO_CLOCKS and now_s - self._backs_s[0] < FORGET_S

    def _forget_speakers(self, now_s: float) -> None:
        """Addresses silent for a while, and the oldest of many, are forgotten."""
        kept = [(peer, times) for peer, times in self._speakers.items() if now_s - times[1] < FORGET_S]
        self._speakers = dict(kept[-MAX_SPEAKERS:])
        self.doubles &= self._speakers.keys()

    def beaten(self, now_s: float) -> None:
        """Our heartbeat leaves for it."""
        if now_s - self._beat_s > SILENT_S:
            self._silence = (now_s - self._beat_s, now_s)
        self._beat_s = now_s

    def _silent_s(self, now_s: float) -> float:
        """For how long it has not heard us, now or a moment ago; 0: it has."""
        last_s, ended_s = self._silence
        present_s = now_s - self._beat_s if now_s - self._beat_s > SILENT_S else 0.0
        return max(present_s, last_s if now_s - ended_s < FORGET_S else 0.0)

    def _check_ownership(self, now_s: float) -> None:
        is_ours = self.actual_mode == self.commanded
        if self.owner == "us" and self._confirmed and not is_ours and not self._shows_the_order_before():
            mode, silent_s = self._mode_words(), self._silent_s(now_s)
            if silent_s:  # nobody may look for a stranger where this computer was too slow
                why = f"went to {mode}: its failsafe, or someone else; no heartbeat of ours for {silent_s:.0f} s"
            else:
                why = f"someone else put it in {mode}"
            self._say(now_s, f"{why}: no longer ours to steer")
            self._lose(self._why)
        self._confirmed = self._confirmed or is_ours

    def _shows_the_order_before(self) -> bool:
        """Whether it is where we sent it last but one: it shows orders a heartbeat late, the newest not yet."""
        if self._overtaken is None:
            return False
        mode, heard = self._overtaken
        return mode == self.actual_mode and self.heartbeats - heard <= LATE_BEATS

    def _position(self, message: Message, now_s: float, now_ns: int) -> list[Happening]:
        # A better estimate of the offset may set the clock back a little; poses stay in order.
        t_ns = max(self._time.heard(message.time_boot_ms * 1_000_000, now_ns), self._pose_t_ns + 1)
        self._pose_t_ns = t_ns
        self.speed_m_s = math.hypot(message.vx, message.vy) / 100.0
        # A rover's is no height above ground: ArduRover's simulator at 400 m above the sea says 400 m "above home".
        self.up_m = message.relative_alt / 1000.0 if self.flies else 0.0
        self.home_alt_m = (message.alt - message.relative_alt) / 1000.0
        self.place = (message.lat, message.lon)
        if (message.lat, message.lon) == NO_POSITION or not self._gps_good:
            return []
        self.position_s = now_s
        if message.hdg != 65535:
            self._heading_deg = message.hdg / 100.0
        east_m, north_m, _ = self._frame.to_local(message.lat / 1e7, message.lon / 1e7)
        sigma_m = self._sigma_m or self._gps_sigma_m or 0.0
        return [
            Pose(t_ns, self.robot, east_m, north_m, self.up_m, self._heading_deg % 360.0, sigma_m, "mavlink")
        ]

    def count(self, peer: Peer, seq: int) -> None:
        """Note a frame's number: gaps are frames lost. Behind a router that drops some this is too dark."""
        if peer != self.peer:
            return
        missing = 0 if self._seq is None else (seq - self._seq - 1) % 256
        if missing < 128:  # more is a frame out of order, or a restart
            self._lost += missing
            self._seq = seq
        self._frames += 1

    @property
    def loss(self) -> float:
        """Share of its frames that did not arrive."""
        return self._lost / max(1, self._lost + self._frames)

    def _status(self, message: Message) -> None:
        self.battery_pct = float(message.battery_remaining) if message.battery_remaining >= 0 else None
        known = 0 < message.voltage_battery < 65535
        self.battery_v = message.voltage_battery / 1000.0 if known else None
        bit = mavlink.MAV_SYS_STATUS_PREARM_CHECK
        if message.onboard_control_sensors_present & bit:
            self.healthy_to_arm = bool(message.onboard_control_sensors_health & bit)

    def _gps(self, message: Message) -> None:
        """Without a fix the autopilot goes on sending dead-reckoned positions that look fresh."""
        self.gps_fix = message.fix_type
        self.gps_eph = None if message.eph == 65535 else message.eph
        self._gps_good = message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX
        self._gps_sigma_m = message.h_acc / 1000.0 if message.h_acc else None

    def _boot(self, boot_ms: int, now_s: float) -> None:
        if self._boot_ms is not None and boot_ms < self._boot_ms - REBOOT_BACK_MS:
            self._backs_s.append(now_s)
            self._time.clear()
            self.position_target = None
            self.reboots += 1
            self._say(now_s, "it has rebooted")
            if self.owner != "nobody":  # the mode after the boot came first, and looked like somebody else's
                self.give_up(self._why)
            self._boot_ms = boot_ms
        self._boot_ms = max(boot_ms, self._boot_ms or 0)

    def _text(self, message: Message, now_s: float) -> None:
        """Long texts come in chunks of 50 characters; one shorter than that is the last."""
        text = message.text.rstrip("\0")
        if message.id:
            text = self._chunks.pop(message.id, "") + text if message.chunk_seq else text
            if len(message.text) >= 50:
                self._chunks = {message.id: text}
                return
        self._say(now_s, text, message.severity)

    def _say(self, now_s: float, text: str, severity: int = mavlink.MAV_SEVERITY_WARNING) -> None:
        self.texts.append((now_s, text, severity))
        self._why = text

    def _lose(self, why: str) -> None:
        """It is no longer ours, if it was."""
        if self.owner == "us":
            self.owner, self.lost_because = "lost", why

    def take(self) -> None:
        """It is ours from now on, in no mode that we asked for yet."""
        self.owner, self.commanded, self.lost_because = "us", None, ""

    def give_up(self, why: str) -> None:
        """It is whoever's takes it."""
        self.owner, self.lost_because = "lost", why

    # Its clock

    @property
    def clock_in_doubt(self) -> bool:
        """It may have stood still: everything it says looks old. Only a round trip separates that from a slow link."""
        return self._time.in_doubt

    def clock_measured(self, sent_ns: int, theirs_ns: int, received_ns: int) -> None:
        """Its boot clock read `theirs_ns` between two moments of mission time: learn the offset from that."""
        if received_ns - sent_ns < MAX_ROUND_TRIP_NS:
            self._time.learn((sent_ns + received_ns) // 2 - theirs_ns, received_ns)

    # What we make of it

    @property
    def actual_mode(self) -> VehicleMode:
        """The mode it is in, whoever chose it."""
        if self.firmware is None:
            return "unknown"
        mode = self.firmware.meaning(self.custom_mode)
        if self.firmware is PX4 and mode == "hold" and self.commanded == "guided":
            return "guided"  # PX4 executes a reposition inside its hold mode
        return mode

    @property
    def mode(self) -> VehicleMode:
        """The mode as the mission may read it: `other` where somebody else has, or has taken, the vehicle."""
        actual = self.actual_mode
        if self.owner == "lost" or (self.owner == "nobody" and actual == "guided"):
            return "other"
        return actual

    def command(self, mode: VehicleMode) -> None:
        """Note that we are asking for a mode: until it is confirmed, another one is no loss of ownership."""
        if mode != self.commanded and self.commanded is not None and not self._confirmed:
            self._overtaken = self.commanded, self.heartbeats
        if mode != self.commanded or self.actual_mode != mode:
            self.commanded, self._confirmed = mode, False

    def words_since(self, then_s: float) -> str:
        """What it has complained of since then, for an error message; chatter (notices, information) is left out."""
        worst = mavlink.MAV_SEVERITY_WARNING
        return "; ".join(text for t_s, text, severity in self.texts if t_s >= then_s and severity <= worst)

    def _mode_words(self) -> str:
        return self.actual_mode if self.actual_mode != "other" else f"mode {self.custom_mode}"

    @property
    def _rolls(self) -> bool:
        """Whether it is in its hold mode and moves: that it has come to stand is said at once."""
        most_m_s = DRIFTS_M_S if self.flies else STANDS_M_S
        return self.actual_mode == "hold" and (self.speed_m_s or 0.0) > most_m_s

    def _report(self, now_s: float, now_ns: int) -> list[Happening]:
        """The state, if it changed or is due."""
        if self.peer is None:
            return []
        now = (
            self.mode, self.armed, self.link_up, self.on_ground, self._why, self.lost_because, self._rolls
        )  # fmt: skip
        if now == self._reported and now_s - self._reported_s < STATE_EVERY_S:
            return []
        self._reported, self._reported_s = now, now_s
        return [
            VehicleState(
                now_ns, self.robot, self.mode, self.armed, self.link_up, self.battery_pct, self._why,
                self.battery_v, self.speed_m_s, self.flies, self.on_ground, self.lost_because,
            )
        ]  # fmt: skip
