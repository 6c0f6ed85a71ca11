"""What was seen of one robot in one picture, and whether it is to be believed as its pose.

A robot that is hidden or inconsistent has no pose: seen twice, of the wrong size or shape, or further from its last
place than it can have gone. A far jump is believed once it has been seen to stay for `CONFIRM` pictures.
"""

import math
from dataclasses import dataclass

import numpy as np

from drivers.camera.view import View
from fieldkit import settings as given
from fieldkit.messages import FloatArray

PIXEL_SIGMA = 0.35
"""Standard deviation of a mark's centre in pixels, each axis, in noise and blur."""
WRONG_SIZE = 0.2
"""Relative error of a mark's measured size from which it is not believed: half of it may be hidden."""
NOT_SQUARE = 1.15
"""Ratio of a marker's longest to its shortest side from which a corner must be wrong."""
CONFIRM = 3


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A robot in the picture. `front_px` and `rear_px` (2,) are two points ahead of and behind its middle."""

    robot: str
    front_px: FloatArray
    rear_px: FloatArray
    corners_px: FloatArray | None = None
    """(4, 2) of a square marker: front left, front right, rear right, rear left."""


@dataclass(frozen=True, slots=True)
class Fix:
    """A robot's place in one picture."""

    robot: str
    east_m: float
    north_m: float
    heading_deg: float
    sigma_m: float


@dataclass(frozen=True, slots=True)
class Body:
    """What is known of a robot's mark."""

    mark_m: float | None = None
    """A marker's side, or the distance of front and rear patch; checked where given."""
    height_m: float = 0.0
    """Of the mark above the ground."""
    front_deg: float = 0.0
    """The robot's front, degrees clockwise from the mark's."""


class Judge:
    """Turns what was seen into fixes; remembers where each robot was."""

    def __init__(
        self, view: View, bodies: dict[str, Body], max_speed_m_s: float = given.SEEN_SPEED_M_S
    ) -> None:
        self._view = view
        self._bodies = bodies
        self._max_speed_m_s = max_speed_m_s
        self._last: dict[str, tuple[float, Fix]] = {}
        self._jump: dict[str, tuple[int, Fix]] = {}
        self.inconsistent: dict[str, str] = {}
        """Robot to why it was not believed in the last picture."""

    def judge(self, seen: list[Seen], t_s: float) -> list[Fix]:
        """The robots whose pose in this picture is sure, one fix each."""
        self.inconsistent = {}
        names = [each.robot for each in seen]
        fixes = []
        for each in seen:
            if names.count(each.robot) > 1:
                self.inconsistent[each.robot] = "seen twice"
                continue
            fix = self._fix(each)
            if fix is not None and self._follows(fix, t_s):
                fixes.append(fix)
        return fixes

    def last_m(self, robot: str) -> tuple[float, float] | None:
        """Where a robot was last believed to be."""
        known = self._last.get(robot)
        return None if known is None else (known[1].east_m, known[1].north_m)

    def _fix(self, seen: Seen) -> Fix | None:
        body = self._bodies[seen.robot]
        front, rear = self._view.to_field(np.vstack([seen.front_px, seen.rear_px]), body.height_m)
        if not np.all(np.isfinite([front, rear])):
            self.inconsistent[seen.robot] = "beyond the horizon"
            return None
        if reason := self._wrong(seen, body, float(np.hypot(*(front - rear)))):
            self.inconsistent[seen.robot] = reason
            return None
        middle_px = (
            (seen.front_px + seen.rear_px) / 2 if seen.corners_px is None else crossing(seen.corners_px)
        )
        middle = self._view.to_field(middle_px[None, :], body.height_m)[0]
        ahead = front - rear
        heading = (math.degrees(math.atan2(ahead[0], ahead[1])) + body.front_deg) % 360.0
        sigma_m = math.hypot(PIXEL_SIGMA * self._view.metres_per_pixel(middle_px), self._view.rms_m, 0.005)
        return Fix(seen.robot, float(middle[0]), float(middle[1]), heading % 360.0, sigma_m)

    def _wrong(self, seen: Seen, body: Body, length_m: float) -> str:
        if body.mark_m is not None and abs(length_m / body.mark_m - 1.0) > WRONG_SIZE:
            return f"{length_m:.2f} m long where {body.mark_m:g} m was expected"
        if seen.corners_px is None:
            return ""
        corners = self._view.to_field(seen.corners_px, body.height_m)
        sides = np.hypot(*(corners - np.roll(corners, 1, axis=0)).T)
        if not np.max(sides) < NOT_SQUARE * np.min(sides):
            return "not square"
        return ""

    def _follows(self, fix: Fix, t_s: float) -> bool:
        known = self._last.get(fix.robot)
        if known is not None:
            reach_m = 0.3 + self._max_speed_m_s * max(0.0, t_s - known[0])
            if _apart_m(known[1], fix) > reach_m:
                count, before = self._jump.get(fix.robot, (0, fix))
                count = count + 1 if _apart_m(before, fix) < 0.5 else 1
                self._jump[fix.robot] = (count, fix)
                if count < CONFIRM:
                    self.inconsistent[fix.robot] = "further from its last place than it can have gone"
                    return False
        self._jump.pop(fix.robot, None)
        self._last[fix.robot] = (t_s, fix)
        return True


def crossing(corners: FloatArray) -> FloatArray:
    """(2,) where the diagonals of a quadrilateral (4, 2) cross: the middle of a square seen in perspective."""
    a, b, c, d = corners
    first, second = c - a, d - b
    cross = first[0] * second[1] - first[1] * second[0]
    if abs(cross) < 1e-9:
        return np.asarray(corners.mean(axis=0))
    share = ((b - a)[0] * second[1] - (b - a)[1] * second[0]) / cross
    return np.asarray(a + share * first)


def _apart_m(one: Fix, other: Fix) -> float:
    return math.hypot(one.east_m - other.east_m, one.north_m - other.north_m)
