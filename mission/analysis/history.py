"""A recorded mission as plain arrays: what reports and plots are made of. One pass through the file."""

from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.errors import RecordingError
from fieldkit.messages import (
    Detection,
    FloatArray,
    Hold,
    Operator,
    Plan,
    Pose,
    ReceiverState,
    RssReading,
    SourceEstimate,
    Tick,
    VehicleState,
)
from fieldkit.recording.reader import BeliefGrid, Recording, open_recording
from mission.core.mission_file import Mission
from mission.replay.replay import recorded_mission


@dataclass
class History:
    """A mission after the fact. Times `_s` count from the first tick."""

    path: Path
    recording: Recording
    mission: Mission
    start_ns: int = 0
    duration_s: float = 0.0
    tracks: dict[str, FloatArray] = field(default_factory=dict)
    """Robot to (n, 3): time s, east m, north m."""
    detections: list[tuple[float, Detection]] = field(default_factory=list)
    estimates: list[tuple[float, list[SourceEstimate]]] = field(default_factory=list)
    plans: list[tuple[float, Plan]] = field(default_factory=list)
    holds: list[tuple[float, Hold]] = field(default_factory=list)
    """What safety ordered."""
    notes: list[tuple[float, str, str]] = field(default_factory=list)
    """Time s, level, text."""
    said: list[tuple[float, Operator]] = field(default_factory=list)
    """What people said of where they stood: marks, and bearings they took."""
    left: list[tuple[float, float]] = field(default_factory=list)
    """Time s, probability that a source is left."""
    belief: BeliefGrid | None = None
    """The last belief kept."""
    modes: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    receivers: dict[str, list[tuple[float, bool, str]]] = field(default_factory=dict)
    """Robot to when its receiver went down or came back, and why."""
    readings: dict[str, int] = field(default_factory=dict)
    """Robot to how many readings it made."""
    truth: list[dict[str, float]] = field(default_factory=list)
    result: dict[str, Any] | None = None

    @property
    def final(self) -> list[SourceEstimate]:
        """The last estimates."""
        return self.estimates[-1][1] if self.estimates else []

    def down(self, robot: str) -> list[tuple[float, float]]:
        """(from s, to s) in which a receiver was down."""
        stretches: list[tuple[float, float]] = []
        since: float | None = None
        for t_s, up, _ in self.receivers.get(robot, ()):
            if not up and since is None:
                since = t_s
            elif up and since is not None:
                stretches.append((since, t_s))
                since = None
        return stretches if since is None else [*stretches, (since, self.duration_s)]

    @property
    def found(self) -> list[SourceEstimate]:
        return [source for source in self.final if source.state == "found"]


def read_history(log: Path | Recording) -> History:
    """Read a recording, whole or cut, opened already or not. Raises `RecordingError` for what is not one."""
    recording = log if isinstance(log, Recording) else open_recording(log)
    history = History(recording.path, recording, recorded_mission(recording))
    history.truth = list(recording.metadata.get("truth", []))
    poses: dict[str, list[tuple[int, float, float]]] = defaultdict(list)
    first_ns: int | None = None
    last_ns = 0
    later: list[tuple[int, Any, str]] = []
    for item in recording.items("event", "command", "detection", "sources", "plan", "belief", "note"):
        last_ns = max(last_ns, item.log_time_ns)
        value = item.value
        if isinstance(value, Tick):
            first_ns = value.t_ns if first_ns is None else first_ns
        elif isinstance(value, Pose):
            poses[value.robot].append((value.t_ns, value.east_m, value.north_m))
        else:
            later.append((item.log_time_ns, value, item.origin))
    if not poses and first_ns is None and not later:
        raise RecordingError(f"{history.path}: it holds no events, so there is nothing to report")
    history.start_ns = first_ns or 0
    history.duration_s = max(0.0, (last_ns - history.start_ns) * 1e-9)
    for robot, rows in sorted(poses.items()):
        track = np.array([((t - history.start_ns) * 1e-9, e, n) for t, e, n in rows])
        history.tracks[robot] = track
    for log_ns, value, origin in later:
        _sort(history, (log_ns - history.start_ns) * 1e-9, value, origin)
    history.belief = _last(recording)
    history.result = recording.result()
    return history


def _sort(history: History, t_s: float, value: Any, origin: str) -> None:
    match value:
        case Detection():
            history.detections.append(((value.t_ns - history.start_ns) * 1e-9, value))
        case Plan():
            history.plans.append((t_s, value))
        case Hold() if origin == "safety":
            history.holds.append((t_s, value))
        case VehicleState():
            modes = history.modes.setdefault(value.robot, [])
            mode = value.mode if value.link_up else "link down"
            if not modes or modes[-1][1] != mode:
                modes.append((t_s, mode))
        case ReceiverState():
            history.receivers.setdefault(value.robot, []).append((t_s, value.up, value.reason))
        case Operator(action="mark" | "bearing"):
            history.said.append(((value.t_ns - history.start_ns) * 1e-9, value))
        case RssReading():
            history.readings[value.robot] = history.readings.get(value.robot, 0) + 1
        case list() | tuple():
            history.estimates.append((t_s, list(value)))
        case _ if hasattr(value, "level"):
            history.notes.append((t_s, value.level, value.text))
        case _ if hasattr(value, "digest") and "probability_left" in value.values:
            history.left.append((t_s, value.values["probability_left"]))


def _last(recording: Recording) -> BeliefGrid | None:
    kept: BeliefGrid | None = None
    for grid in recording.beliefs():
        kept = grid
    return kept
