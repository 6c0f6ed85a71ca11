"""One recording replayed for the command line: checked, or with something changed and then compared."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.channel.antenna_file import read_antenna
from fieldkit.errors import DataError
from fieldkit.messages import Event, Plan
from fieldkit.recording.reader import Recording, open_recording
from mission.core.kernel import Kernel, Outcome
from mission.core.mission_file import Mission
from mission.replay.replay import recorded_mission, replay, same_antenna, what_if
from mission.shell.recorder import Follower

OnStep = Callable[[float, Event, Outcome, Kernel], None]


@dataclass(frozen=True, slots=True)
class Changes:
    """What is asked to be different from the mission as flown; nothing: the replay is a check."""

    antenna: Path | None = None
    belief: str | None = None
    planner: str | None = None
    keys: tuple[str, ...] = ()
    """`table.key=value` in the mission file."""
    what_if: bool = False

    @property
    def any(self) -> bool:
        return self.what_if or self.belief is not None or self.planner is not None or bool(self.keys)


def replay_one(
    log: Path | Recording,
    changes: Changes,
    *,
    until_s: float | None = None,
    on_step: OnStep | None = None,
    followers: Sequence[Follower] = (),
) -> dict[str, Any]:
    """Replay one recording; what came out as plain values. `on_step` and `followers` as for `mission.replay.replay`.

    Raises `ReplayMismatch` where a check fails, `DataError` where `until_s` lies outside the log or an antenna is
    given that the mission was not flown with.
    """
    recording = log if isinstance(log, Recording) else open_recording(log)
    log = recording.path
    lasts_s = recording.summary()["duration_s"] if until_s is not None else 0.0
    if until_s is not None and not 0.0 < until_s <= lasts_s:
        raise DataError(f"{log}: --until {until_s:g} s lies outside the log, which lasts {lasts_s:.1f} s")
    merged = "merged" in recording.metadata
    if "agent" in recording.metadata and not changes.any:
        raise DataError(
            f"{log}: is what {recording.metadata['agent']}'s agent saw and did, on more than it holds: replay the "
            "common.mcap beside it, or add --what-if to see what one computer would have made of this"
        )
    different = changes.any or merged
    mission = changed_mission(recording, changes)
    if changes.antenna is not None and not different:
        same_antenna(recording, mission, changes.antenna)
    plans: list[Plan] = []

    def keep(t_s: float, event: Event, outcome: Outcome, kernel: Kernel) -> None:
        if outcome.plan is not None:
            plans.append(outcome.plan)
        if on_step is not None:
            on_step(t_s, event, outcome, kernel)

    done = replay(
        recording, mission=mission, check=not different, until_s=until_s, on_step=keep, followers=followers
    )
    plain: dict[str, Any] = {
        "recording": str(log),
        "events": done.events,
        "compared": 0 if different else done.compared,
        "duration_s": round(done.duration_s, 3),
        "identical": None if different else True,
        "complete": done.complete,
        "missing": done.missing,
        "belief_hash": done.kernel.digest(),
        "commands_hash": done.kernel.commands_digest(),
        "sources": [plain_source(source) for source in done.kernel.sources()],
        "found_at_s": {str(ident): round(at_s, 1) for ident, at_s in done.kernel.found_at_s.items()},
        "times_real_time": round(done.duration_s / max(done.wall_s, 1e-9), 1),
        "verdict": _verdict(merged, different, done.complete, done.compared),
    }
    if different:
        plain["planner"] = compare_plans(recording, plans, until_s)
    return plain


def changed_mission(recording: Recording, changes: Changes) -> Mission:
    """The mission a recording was made with, changed as asked."""
    given = read_antenna(changes.antenna) if changes.antenna is not None else None
    text = changes.antenna.read_text(encoding="utf-8") if changes.antenna else ""
    mission = recorded_mission(recording, given, text)
    return what_if(mission, belief=changes.belief, planner=changes.planner, changes=changes.keys)


def _verdict(merged: bool, different: bool, complete: bool, compared: int) -> str:
    if merged:
        return "a merged recording holds no decisions: nothing was compared"
    if different:
        return "a what-if: belief and commands were not compared"
    if not complete:
        return f"the same belief and commands as recorded, as far as that is known ({compared} events)"
    return "the same belief and commands as recorded"


def compare_plans(recording: Recording, plans: list[Plan], until_s: float | None) -> dict[str, Any]:
    """How the planner's decisions differ from the mission's: plans made, and how far apart first way-points were.

    Robots stay on their recorded paths, so plans are compared by time: each of ours with the mission's last before it.
    """
    flown = [plan for _, _, plan in recording.plans()]
    if flown and until_s is not None:
        flown = [plan for plan in flown if (plan.t_ns - flown[0].t_ns) * 1e-9 <= until_s]
    apart_m: list[float] = []
    latest: dict[str, tuple[float, float]] = {}
    waiting = iter(flown)
    upcoming = next(waiting, None)
    for plan in plans:
        while upcoming is not None and upcoming.t_ns <= plan.t_ns:
            latest |= _first_places(upcoming)
            upcoming = next(waiting, None)
        for robot, place in _first_places(plan).items():
            if robot in latest:
                apart_m.append(float(np.hypot(place[0] - latest[robot][0], place[1] - latest[robot][1])))
    return {
        "plans": len(plans),
        "plans_flown": len(flown),
        "same_first_waypoints": sum(d < 0.01 for d in apart_m),
        "compared_first_waypoints": len(apart_m),
        "median_apart_m": round(float(np.median(apart_m)), 2) if apart_m else None,
    }


def _first_places(plan: Plan) -> dict[str, tuple[float, float]]:
    return {robot: (path[0].east_m, path[0].north_m) for robot, path in plan.paths.items() if path}


def plain_source(source: Any) -> dict[str, Any]:
    """A source estimate as plain numbers."""
    return {
        "ident": source.ident,
        "state": source.state,
        "east_m": round(source.east_m, 3),
        "north_m": round(source.north_m, 3),
        "sigma_m": round(float((source.cov_m2[0, 0] + source.cov_m2[1, 1]) / 2) ** 0.5, 3),
        "p_within_one_cell": round(source.p_here, 4),
        "receptions": round(source.receptions, 2),
        "rate_hz": round(source.rate_hz, 4),
        "note": source.note,
    }
