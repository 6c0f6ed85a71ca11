"""What each robot's time went into: searching, on a ridge or a candidate, on the way, held."""

from dataclasses import dataclass

import numpy as np

from mission.analysis.history import History

Stretch = tuple[str, float, float, str]
"""Robot, from s, to s, on what."""

KINDS = {
    "ridge": "on a ridge",
    "resolve": "on a candidate",
    "search": "searching",
    "held": "held",
    "wait": "waiting",
}
"""First word of a purpose to what a reader calls it; other words are their own name. `walk`, `patrol` and the like are
planners that know no ridges: their time is off-ridge."""


def kind(purpose: str) -> str:
    """What a purpose such as "resolve 3" is called."""
    word = purpose.split(" ", 1)[0].rstrip(":")
    return KINDS.get(word, word)


def stretches(history: History) -> list[Stretch]:
    """What each robot was on, from the plans, cut by safety's holds."""
    rows: list[Stretch] = []
    for robot in history.tracks:
        marks = [(t, plan.purpose[robot]) for t, plan in history.plans if robot in plan.purpose]
        marks += [(t, "held") for t, hold in history.holds if hold.robot == robot]
        marks.sort(key=lambda mark: mark[0])
        for index, (t, purpose) in enumerate(marks):
            end = marks[index + 1][0] if index + 1 < len(marks) else history.duration_s
            if rows and rows[-1][0] == robot and rows[-1][3] == purpose:
                rows[-1] = (robot, rows[-1][1], end, purpose)
            else:
                rows.append((robot, t, end, purpose))
    return rows


@dataclass(frozen=True, slots=True)
class Use:
    """One robot's mission."""

    robot: str
    distance_m: float
    readings: int
    share: dict[str, float]
    """What its time went into, as shares of the mission."""
    down_s: float
    """Its receiver was down for so long."""

    @property
    def on_ridge(self) -> float:
        """Share of the time on a ridge or a candidate: where the belief is high."""
        return self.share.get(KINDS["ridge"], 0.0) + self.share.get(KINDS["resolve"], 0.0)

    @property
    def held(self) -> float:
        return self.share.get(KINDS["held"], 0.0)

    @property
    def off_ridge(self) -> float:
        """Share of the time that was neither."""
        return max(0.0, 1.0 - self.on_ridge - self.held)


def use(history: History, rows: list[Stretch]) -> list[Use]:
    """Each robot's mission in numbers."""
    found = []
    whole_s = max(history.duration_s, 1e-9)
    for robot, track in history.tracks.items():
        share: dict[str, float] = {}
        for name, start_s, end_s, purpose in rows:
            if name == robot:
                share[kind(purpose)] = share.get(kind(purpose), 0.0) + (end_s - start_s) / whole_s
        steps = np.hypot(np.diff(track[:, 1]), np.diff(track[:, 2]))
        down_s = sum(end - start for start, end in history.down(robot))
        found.append(Use(robot, float(steps.sum()), history.readings.get(robot, 0), share, down_s))
    return found
