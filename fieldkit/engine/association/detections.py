"""Readings and poses in, one `Detection` per transmission out, with the robots that stayed silent.

Receptions that carry the same address and sequence number belong to one transmission; otherwise those within one
window of the first do; at most one per robot. A group is kept open for late arrivals before it is emitted.

A robot counts as listening when its receiver is up and its pose is known around that moment; otherwise it is absent
from the detection, not silent. It is absent as well where it heard something shortly before or after that may have
been the same transmission by a clock that is off: a wrong "heard nothing" misleads more than a missing one.
"""

import re
from bisect import bisect_left
from collections.abc import Container
from dataclasses import dataclass, field

import numpy as np

from fieldkit import settings as given
from fieldkit.messages import Detection, Listening, Pose, ReceiverState, RssReading

_KEEP_NS = 30_000_000_000
_NUMBERED = re.compile(r".*/[0-9a-f]{2}")
"""An address with the sequence number of IEEE 802.15.4-2015, 7.2.2.1. An address alone, or with a payload's checksum,
comes again with the sender's next packet: such ids may keep receptions apart but not join them."""
NUMBERED_REACH_NS = 500_000_000
"""How far apart in time receptions of one numbered frame may be: far under the 256 frames after which numbers recur."""
FLAT_ORIGINS = ("camera", "file")
"""Sources of positions that may have no height; then it is nought."""
CLOCK_OFF_WINDOWS = 3
"""A reception up to so many windows away may belong to the same transmission, heard by a clock that is off."""


def sender_of(frame_id: str | None) -> str | None:
    """The address in a frame's id: what stands before its number or its checksum."""
    return None if frame_id is None else re.split(r"[/#]", frame_id, maxsplit=1)[0] or None


Place = tuple[float, float, float, float, float]
"""East and north in metres, heading in degrees, height and deviation in metres."""


def _place(pose: Pose) -> Place:
    return pose.east_m, pose.north_m, pose.heading_deg, pose.up_m, pose.sigma_m


@dataclass
class PoseTrack:
    """Recent poses of one robot, in order of time."""

    max_gap_ns: int
    t_ns: list[int] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)

    def add(self, pose: Pose) -> None:
        """Keep a pose; one that is not newer than the last is dropped (a repeated or reordered report)."""
        if self.t_ns and pose.t_ns <= self.t_ns[-1]:
            return
        self.t_ns.append(pose.t_ns)
        self.poses.append(pose)
        if len(self.t_ns) > 64 and self.t_ns[32] < pose.t_ns - _KEEP_NS:
            del self.t_ns[:32], self.poses[:32]

    def place_at(self, t_ns: int) -> Place | None:
        """East, north, heading, height and deviation at `t_ns`; None where no pose is near enough to say.

        Between poses further apart than the gap, or further than half of it beyond the last one, nothing is known.
        """
        if not self.t_ns:
            return None
        index = bisect_left(self.t_ns, t_ns)
        if index < len(self.t_ns) and self.t_ns[index] == t_ns:
            pose = self.poses[index]
            return _place(pose)
        if index == len(self.t_ns) or index == 0:
            pose = self.poses[-1 if index else 0]
            near = abs(t_ns - pose.t_ns) <= self.max_gap_ns // 2
            return _place(pose) if near else None
        before, after = self.poses[index - 1], self.poses[index]
        if after.t_ns - before.t_ns > self.max_gap_ns:
            return None
        share = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
        turn = (after.heading_deg - before.heading_deg + 180.0) % 360.0 - 180.0
        return (
            before.east_m + share * (after.east_m - before.east_m),
            before.north_m + share * (after.north_m - before.north_m),
            (before.heading_deg + share * turn) % 360.0,
            before.up_m + share * (after.up_m - before.up_m),
            max(before.sigma_m, after.sigma_m),
        )


@dataclass
class _Group:
    t_ns: int
    readings: dict[str, RssReading]

    @property
    def frame_id(self) -> str | None:
        return next((r.frame_id for r in self.readings.values() if r.frame_id is not None), None)

    def may_be(self, other: "_Group", reach_ns: int) -> bool:
        """Whether both may be one transmission that clocks have torn apart: no robot heard both."""
        return (
            abs(self.t_ns - other.t_ns) <= reach_ns
            and self.readings.keys().isdisjoint(other.readings)
            and (self.frame_id is None or other.frame_id in (None, self.frame_id))
        )


class Associator:
    """Turns the stream of readings, receiver states and poses into detections and stretches of listening."""

    def __init__(
        self,
        robots: tuple[str, ...],
        *,
        window_s: float = given.WINDOW_S.default,
        lateness_s: float = given.LATENESS_S.default,
        max_pose_gap_s: float = given.POSE_GAP_S.default,
        silence_step_s: float = given.SILENCE_STEP_S,
        flying: Container[str] = (),
    ) -> None:
        """`flying`: robots that leave the ground. Of them positions without a height are no positions."""
        self.robots = robots
        self.without_height: dict[str, str] = {}
        """Robots that fly though their positions have no height, and where those come from."""
        self._flying = flying
        self.late_readings = 0
        """Readings that came after their time had been closed; they are dropped and counted."""
        self._window_ns = round(window_s * 1e9)
        self._lateness_ns = round(lateness_s * 1e9)
        self._silence_ns = round(silence_step_s * 1e9)
        self._tracks = {robot: PoseTrack(round(max_pose_gap_s * 1e9)) for robot in robots}
        self._up: dict[str, list[tuple[int, bool]]] = {robot: [(-(2**62), True)] for robot in robots}
        self._open: list[_Group] = []
        self._closed: list[_Group] = []
        self._silent_until_ns: int | None = None
        self._closed_ns = -(2**62)

    def pose(self, pose: Pose) -> None:
        """Take in a pose of one of our robots."""
        if pose.robot not in self._tracks:
            return
        if pose.up_m == 0.0 and pose.origin in FLAT_ORIGINS and pose.robot in self._flying:
            # On the ground it would seem to hear from where it is not.
            self.without_height[pose.robot] = pose.origin
            return
        self._tracks[pose.robot].add(pose)

    def receiver(self, state: ReceiverState) -> None:
        """Take in that a receiver went down or came back."""
        if state.robot in self._up:
            self._up[state.robot].append((state.t_ns, state.up))

    def reading(self, reading: RssReading) -> None:
        """Take in a reading; absurd ones (not finite, positive, below -150 dBm) and energy scans are ignored."""
        if reading.robot not in self._tracks or not -150.0 <= reading.rss_dbm <= 0.0 or reading.via == "ed":
            return
        if reading.t_ns < self._closed_ns:
            self.late_readings += 1
            return
        group = self._same_number(reading) or self._within_window(reading)
        if group is None:
            self._open.append(_Group(reading.t_ns, {reading.robot: reading}))
        else:
            group.readings[reading.robot] = reading

    def _same_number(self, reading: RssReading) -> _Group | None:
        """The group of the same numbered frame nearest in time."""
        if reading.frame_id is None or not _NUMBERED.fullmatch(reading.frame_id):
            return None
        same = [
            group
            for group in self._open
            if group.frame_id == reading.frame_id
            and reading.robot not in group.readings
            and abs(reading.t_ns - group.t_ns) <= NUMBERED_REACH_NS
        ]
        return min(same, key=lambda group: abs(reading.t_ns - group.t_ns), default=None)

    def _within_window(self, reading: RssReading) -> _Group | None:
        """The first group in time whose window the reading falls in, unless both name different frames."""
        for group in self._open:
            same_frame = reading.frame_id is None or group.frame_id in (None, reading.frame_id)
            near = abs(reading.t_ns - group.t_ns) <= self._window_ns
            if near and same_frame and reading.robot not in group.readings:
                return group
        return None

    def advance(self, now_ns: int) -> tuple[list[Detection], list[Listening]]:
        """What can be said for sure at `now_ns`: closed detections in order of time, and listening up to then."""
        horizon_ns = now_ns - self._lateness_ns
        ready = sorted(
            (g for g in self._open if g.t_ns + self._window_ns <= horizon_ns), key=lambda g: g.t_ns
        )
        self._open = [g for g in self._open if g.t_ns + self._window_ns > horizon_ns]
        self._closed_ns = max(self._closed_ns, horizon_ns - self._window_ns)
        reach_ns = CLOCK_OFF_WINDOWS * self._window_ns
        # Old ones go only afterwards: after a long time without a look, what closes now needs them still.
        self._closed += ready
        detections = [detection for group in ready if (detection := self._detection(group)) is not None]
        self._closed = [g for g in self._closed if g.t_ns >= self._closed_ns - 2 * reach_ns]
        return detections, self._listening(horizon_ns)

    def _is_up(self, robot: str, t_ns: int) -> bool:
        up = True
        for since_ns, state in self._up[robot]:
            if since_ns > t_ns:
                break
            up = state
        return up

    def _where(self, t_ns: int) -> tuple[tuple[str, ...], list[Place]]:
        names, places = [], []
        for robot in self.robots:
            if self._is_up(robot, t_ns) and (place := self._tracks[robot].place_at(t_ns)) is not None:
                names.append(robot)
                places.append(place)
        return tuple(names), places

    def _detection(self, group: _Group) -> Detection | None:
        names, places = self._where(group.t_ns)
        rss = np.array([group.readings[n].rss_dbm if n in group.readings else np.nan for n in names])
        if np.isnan(rss).all():  # heard only by robots whose place is unknown
            return None
        out_of_step = self._out_of_step(group)
        keep = [index for index, name in enumerate(names) if name not in out_of_step]
        names, rss = tuple(names[index] for index in keep), rss[keep]
        place = np.array(places)[keep]
        saturated = np.array([n in group.readings and group.readings[n].saturated for n in names])
        return Detection(
            group.t_ns,
            names,
            place[:, :2].copy(),
            place[:, 2].copy(),
            rss,
            saturated,
            up_m=place[:, 3].copy(),
            sigma_m=place[:, 4].copy(),
            sender=sender_of(group.frame_id),
        )

    def _out_of_step(self, group: _Group) -> set[str]:
        """Robots that heard something near in time which may have been this transmission."""
        reach_ns = CLOCK_OFF_WINDOWS * self._window_ns
        return {
            robot
            for other in (*self._closed, *self._open)
            if other is not group and group.may_be(other, reach_ns)
            for robot in other.readings
        }

    def _listening(self, horizon_ns: int) -> list[Listening]:
        if self._silent_until_ns is None:
            if any(track.t_ns for track in self._tracks.values()):
                self._silent_until_ns = horizon_ns
            return []
        stretches = []
        while self._silent_until_ns + self._silence_ns <= horizon_ns:
            t0 = self._silent_until_ns
            self._silent_until_ns = t1 = t0 + self._silence_ns
            names, places = self._where((t0 + t1) // 2)
            if names:
                place = np.array(places)
                heading_deg, up_m, sigma_m = place[:, 2].copy(), place[:, 3].copy(), place[:, 4].copy()
                stretches.append(Listening(t0, t1, names, place[:, :2].copy(), up_m, heading_deg, sigma_m))
        return stretches
