"""The judge of faults: what happened to the vehicles and what is in the recordings, not what the mission thinks.

The reckoning of separation is another one than safety's: stepped through in time, from the recording alone.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fieldkit.errors import FieldkitError
from fieldkit.messages import GoTo
from fieldkit.recording.reader import open_recording
from fieldkit.world.sources import TransientSource
from mission.core.mission_file import Mission
from mission.replay.replay import replay

if TYPE_CHECKING:
    from mission.lab.study.fault_flight import Flight

ROUNDING_M = 0.02


def measure(flight: "Flight", sources: tuple[TransientSource, ...]) -> dict[str, Any]:
    runner = flight.runner
    assert runner is not None
    cell_m = flight.mission.kernel.engine.grid.cell_m
    finds = [source for source in runner.kernel.sources() if source.state == "found"]
    near = [
        any(max(abs(f.east_m - s.east_m), abs(f.north_m - s.north_m)) <= cell_m for f in finds)
        for s in sources
    ]
    stray = [
        f
        for f in finds
        if all(math.hypot(f.east_m - s.east_m, f.north_m - s.north_m) > 2 * cell_m for s in sources)
    ]
    last_fault_s = max((fault.at_s for fault in flight.faults), default=0.0)
    touched = {fault.robot for fault in flight.faults}
    others = [name for name in flight.fleet.rovers if name not in touched]
    went_on = any(
        target.t_s > last_fault_s for name in others for target in flight.fleet.rovers[name].targets
    )
    return {
        "end_reason": runner.end_reason,
        "found": sum(near),
        "sources": len(sources),
        "false_finds": len(stray),
        "fence_breaches": _fence_breaches(flight),
        "separation_breaches": _separation_breaches(flight),
        "closest_m": flight.fleet.closest_m,
        "not_held": flight.not_held,
        "resumed_wrongly": flight.resumed_wrongly,
        "others_stopped": bool(
            flight.faults and others and flight.ended_s > last_fault_s + 60.0 and not went_on
        ),
        "unreadable": [problem for path in flight.recordings if (problem := _unreadable(path))],
        "interventions": runner.safety.interventions,
        "ended_s": flight.ended_s,
    }


def _fence_breaches(flight: "Flight") -> int:
    """Targets that vehicles took on the wire, nearer to the fence or to closed ground than way-points must be."""
    safety = flight.mission.safety
    allowed = safety.bounds.wider(max(0.0, safety.fence_margin_m - ROUNDING_M))
    return sum(
        allowed.clearance_m((target.east_m, target.north_m)) < -ROUNDING_M
        for rover in flight.fleet.rovers.values()
        for target in rover.targets
    )


def _separation_breaches(flight: "Flight") -> int:
    """Way-points let pass that would have brought two robots too near, each driving straight from where it said it was.

    Stepped through in time, from the recording alone: another reckoning than the one safety uses.
    """
    try:
        recording = open_recording(flight.recordings[-1])
        return _count_near(recording, flight.mission)
    except FieldkitError:
        return 0


def _count_near(recording: Any, mission: Mission) -> int:
    limit_m = mission.safety.near_m
    place: dict[str, np.ndarray] = {}
    heading: dict[str, tuple[np.ndarray, float]] = {}
    breaches = 0
    for step in recording.steps():
        event = step.event
        if type(event).__name__ == "Pose":
            place[event.robot] = np.array([event.east_m, event.north_m])
        allowed = [c for origin, c in step.commands if origin == "safety"]
        for command in allowed:
            if isinstance(command, GoTo):
                target = np.array([command.waypoint.east_m, command.waypoint.north_m])
                heading[command.robot] = (target, max(command.waypoint.speed_m_s, 0.01))
            elif (robot := getattr(command, "robot", None)) is not None:
                heading.pop(robot, None)
        sent = [c.robot for c in allowed if isinstance(c, GoTo) and c.robot in place]
        for robot in sent:
            breaches += any(
                _would_meet(robot, other, place, heading, limit_m) for other in place if other != robot
            )
    return breaches


def _would_meet(
    one: str,
    other: str,
    place: dict[str, np.ndarray],
    heading: dict[str, tuple[np.ndarray, float]],
    limit_m: float,
) -> bool:
    """Whether two robots that drive on as ordered come nearer than the limit, and nearer than they are."""
    now_m = float(np.hypot(*(place[one] - place[other])))
    t_s = np.arange(0.0, 60.0, 0.1)[:, None]
    gap_m = np.hypot(*(_driven(one, place, heading, t_s) - _driven(other, place, heading, t_s)).T)
    return bool(gap_m.min() < min(limit_m, now_m - 0.02))


def _driven(
    robot: str, place: dict[str, np.ndarray], heading: dict[str, tuple[np.ndarray, float]], t_s: np.ndarray
) -> np.ndarray:
    """(k, 2) places at times (k, 1)."""
    here = place[robot]
    if robot not in heading:
        return np.broadcast_to(here, (len(t_s), 2))
    target, speed_m_s = heading[robot]
    length_m = float(np.hypot(*(target - here)))
    share = np.minimum(1.0, t_s * speed_m_s / max(length_m, 1e-9))
    return np.asarray(here + share * (target - here))


def _unreadable(path: Path) -> str:
    """Why a recording cannot be replayed as far as it goes; empty when it can."""
    try:
        replay(path)
    except FieldkitError as error:
        return f"{path.name}: {error}"
    return ""
