"""Events of the robots' logs to detections, where robots log a pose at every turn and drive straight in between.

A log so short is what robots can carry for hours. A transmission is handed on once every robot's place at that time
is known from a pose before and one after; until then it and all later ones wait, so the order is that of time.
"""

from bisect import bisect_left, insort

import numpy as np

from fieldkit.messages import Detection, Listening, Pose, RssReading


class TrackAssociator:
    """Stands in for `detections.Associator` in a `Replica`; readings of one transmission carry one time."""

    def __init__(self, robots: tuple[str, ...]) -> None:
        self.robots = robots
        self._t: dict[str, list[int]] = {robot: [] for robot in robots}
        self._poses: dict[str, list[Pose]] = {robot: [] for robot in robots}
        self._readings: dict[int, dict[str, RssReading]] = {}
        self._times: list[int] = []

    def pose(self, pose: Pose) -> None:
        """Take in a pose; they come in order of time, and one of a time that is known says nothing new."""
        times = self._t[pose.robot]
        if not times or pose.t_ns > times[-1]:
            times.append(pose.t_ns)
            self._poses[pose.robot].append(pose)

    def reading(self, reading: RssReading) -> None:
        """Take in a reading."""
        if reading.t_ns not in self._readings:
            insort(self._times, reading.t_ns)
        self._readings.setdefault(reading.t_ns, {})[reading.robot] = reading

    def advance(self, now_ns: int) -> tuple[list[Detection], list[Listening]]:
        """Detections of which every robot's place is known, in order of time."""
        known_ns = min((times[-1] if times else -(2**62)) for times in self._t.values())
        detections = []
        while self._times and self._times[0] <= min(now_ns, known_ns):
            t_ns = self._times.pop(0)
            detections.append(self._detection(t_ns, self._readings.pop(t_ns)))
        for robot, times in self._t.items():  # keep the last pose before whatever may still come
            old = bisect_left(times, min(now_ns, known_ns, *self._times[:1])) - 1
            if old > 0:
                del times[:old], self._poses[robot][:old]
        return detections, []

    def _detection(self, t_ns: int, readings: dict[str, RssReading]) -> Detection:
        place = np.array([self._at(robot, t_ns) for robot in self.robots])
        rss = np.array([readings[r].rss_dbm if r in readings else np.nan for r in self.robots])
        saturated = np.array([r in readings and readings[r].saturated for r in self.robots])
        return Detection(t_ns, self.robots, place, np.zeros(len(self.robots)), rss, saturated)

    def _at(self, robot: str, t_ns: int) -> tuple[float, float]:
        times, poses = self._t[robot], self._poses[robot]
        index = bisect_left(times, t_ns)
        after = poses[index]
        if index == 0 or after.t_ns == t_ns:
            return after.east_m, after.north_m
        before = poses[index - 1]
        share = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
        return (
            before.east_m + share * (after.east_m - before.east_m),
            before.north_m + share * (after.north_m - before.north_m),
        )
