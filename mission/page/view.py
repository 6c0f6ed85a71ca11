"""What the page shows, built up from the same stream that is recorded: live missions and recordings look alike.

A `View` is a `Follower`. `frame` is the present, `history` what a browser that has just come needs besides, and
`news` what has happened since it was last asked. Everything is plain and JSON-ready; units are in the names.
Lists are bounded: long ones are thinned, so that a day costs no more memory than an hour.
"""

import base64
import contextlib
import math
import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from fieldkit.geometry.polygons import margin_m
from fieldkit.messages import (
    CallOperator,
    Command,
    Detection,
    EndMission,
    Event,
    FloatArray,
    GoTo,
    Hold,
    Operator,
    Plan,
    Pose,
    ReceiverState,
    SourceEstimate,
    Tick,
    VehicleState,
)
from mission.core.mission_file import Mission
from mission.maps.present import Latest
from mission.page.exposure import Exposure
from mission.safety.monitor import Watched, reserve_of

GRID_SIDE = 128
"""Most cells along a side of a grid that is sent; larger ones are reduced, a block to its largest value."""
TRACK_POINTS = 1500
SERIES_POINTS = 600
KEPT = 300
"""Detections and notes a new browser gets."""
NORMAL_90 = 2.146
"""90 % of a plane normal lies within this many standard deviations."""
_NUMBERS = re.compile(r"\d+(\.\d+)?")

Answers = Callable[[], Mapping[str, tuple[str, str]]]
Alarms = Callable[[], Sequence[str]]
"""What the operator must know at once, in words, as long as it lasts."""


class View:
    """See the module. Not for several threads."""

    def __init__(
        self, mission: Mission, answers: Answers = dict, kept: int | None = KEPT, alarms: Alarms = tuple
    ) -> None:
        self.mission = mission
        self._answers, self._alarms = answers, alarms
        engine = mission.kernel.engine
        self._robots = {name: Watched(name) for name in engine.robots}
        self._seen_ns: dict[str, int] = {}
        self._commands: dict[str, tuple[str, str]] = {}
        self._calls: dict[str, str] = {}
        self._paths: dict[str, list[list[float]]] = {}
        self._doing: dict[str, str] = {}
        self._sources: list[SourceEstimate] = []
        self._now_ns = 0
        self._start_ns: int | None = None
        self._left = 1.0
        self._count = 0
        self._end = ""
        self._areas: list[list[tuple[float, float]]] = [list(p) for p in mission.file.field.keep_out]
        self._marks: list[dict[str, Any]] = []
        """Where people say that a transmitter is."""
        self._targets: dict[str, list[float]] = {}
        """Robot to the way-point it is sent to now."""
        self._exposure = Exposure(engine)
        self.latest = Latest(mission)
        """The present, for other maps."""
        self.background: dict[str, Any] | None = None
        self.files: list[list[str]] = [["GeoJSON", "sources.geojson"], ["KML", "present.kml"]]
        """What can be saved of it: a word, and where it is answered."""
        """Pictures under the map."""
        self.tracks: dict[str, list[tuple[float, float, float]]] = {name: [] for name in engine.robots}
        """Robot to (s, east, north), thinned."""
        self.series: list[dict[str, Any]] = []
        """Over time: probability that one is left, and of each source."""
        self.detections: deque[dict[str, Any]] = deque(maxlen=kept)
        self.notes: deque[dict[str, Any]] = deque(maxlen=kept)
        self._news: deque[dict[str, Any]] = deque(maxlen=kept or 10_000)
        self._grids: dict[str, dict[str, Any]] = {}

    # -- a follower ------------------------------------------------------------------------------------------

    def event(self, inbox_number: int, log_time_ns: int, event: Event) -> None:
        """Take in an event."""
        self.latest.event(inbox_number, log_time_ns, event)
        self._now_ns = max(self._now_ns, log_time_ns)
        robot = self._robots.get(getattr(event, "robot", None) or "")
        match event:
            case Pose() if robot is not None:
                robot.see(event, self.mission.safety)
                self._seen_ns[robot.name] = log_time_ns
            case VehicleState() if robot is not None:
                robot.vehicle = event
                if event.link_up:
                    self._seen_ns[robot.name] = log_time_ns
            case ReceiverState() if robot is not None:
                robot.hear(event)
            case Operator():
                self._operator(event)
            case Tick():
                self._tick(event.t_ns)
            case _:
                pass

    def command(self, inbox_number: int, log_time_ns: int, command: Command, origin: str = "kernel") -> None:
        """Take in a command that safety let pass."""
        if origin != "safety":
            return
        if isinstance(command, EndMission):
            self._end = command.reason
            return
        robot = self._robots.get(command.robot)
        if robot is None:
            return
        match command:
            case GoTo(_, _, waypoint):
                self._commands[robot.name] = ("go to", f"{waypoint.east_m:.1f}, {waypoint.north_m:.1f} m")
                self._targets[robot.name] = [round(waypoint.east_m, 2), round(waypoint.north_m, 2)]
            case Hold(_, _, reason):
                same = _is_same(self._commands.get(robot.name), ("hold", reason))
                if not same and not reason.startswith("operator"):
                    self._announce(f"{robot.name} holds: {reason}", log_time_ns)
                self._commands[robot.name] = ("hold", reason)
                self._targets.pop(robot.name, None)
                self._paths.pop(robot.name, None)
            case CallOperator(_, _, reason):
                self._calls[robot.name] = reason
            case _:
                self._announce(f"{robot.name} sets out for home: {command.reason}", log_time_ns)
                self._commands[robot.name] = ("return", command.reason)
                self._targets.pop(robot.name, None)
                self._paths.pop(robot.name, None)

    def detection(self, inbox_number: int, log_time_ns: int, detection: Detection) -> None:
        """Take in a transmission as the team heard it."""
        self._count += 1
        heard = {
            robot: round(float(rss), 1)
            for robot, rss in zip(detection.robots, detection.rss_dbm, strict=True)
            if not math.isnan(rss)
        }
        row = {"t_s": self._at_s(detection.t_ns), "heard_dbm": heard, "listening": list(detection.robots)}
        self.detections.append(row)
        self._news.append({"detection": row})

    def sources(self, inbox_number: int, log_time_ns: int, sources: Sequence[SourceEstimate]) -> None:
        """Take in what is believed of the sources."""
        self.latest.sources(inbox_number, log_time_ns, sources)
        self._sources = list(sources)
        self._point(log_time_ns)

    def plan(self, inbox_number: int, log_time_ns: int, plan: Plan) -> None:
        """Take in a plan."""
        for robot, path in plan.paths.items():
            self._paths[robot] = [[round(w.east_m, 2), round(w.north_m, 2)] for w in path]
        self._doing.update(plan.purpose)

    def belief(
        self,
        inbox_number: int,
        log_time_ns: int,
        values: FloatArray | None = None,
        *,
        cell_m: float = 1.0,
        digest: str = "",
        numbers: Mapping[str, float] | None = None,
    ) -> None:
        """Take in the belief over the field (n_north, n_east)."""
        if numbers and "probability_left" in numbers:
            self._left = numbers["probability_left"]
            self._point(log_time_ns)
        if values is not None:
            self._grids["belief"] = grid("belief", values, cell_m)
            self._grids["exposure"] = grid(
                "exposure", self._exposure.searched(), self._exposure.cell_m, scale=1.0
            )

    def note(self, level: Any, text: str, log_time_ns: int = 0) -> None:
        """Take in a line of the log."""
        row = {"t_s": self._at_s(log_time_ns or self._now_ns), "level": str(level), "text": text}
        self.notes.append(row)
        self._news.append({"note": row})

    def _announce(self, text: str, log_time_ns: int) -> None:
        """A decision of safety's among the notes; the recording has it as a command."""
        self.note("info", text, log_time_ns)

    def flush(self) -> None:
        """Nothing waits here."""

    # -- what is shown ---------------------------------------------------------------------------------------

    def hello(self) -> dict[str, Any]:
        """What does not change: the field, the robots, their teams."""
        field = self.mission.file.field
        return {
            "kind": "hello",
            "mission": self.mission.file.name,
            "field": {
                "east_m": field.size_east_m,
                "north_m": field.size_north_m,
                "fence_m": [list(corner) for corner in self.mission.fence_m],
                "margin_m": self.mission.safety.fence_margin_m,
            },
            "robots": [
                {"name": name, "team": number, "on_foot": name in self.mission.safety.on_foot}
                for number, team in enumerate(self.mission.kernel.engine.teams)
                for name in team
            ],
            "pose_timeout_s": self.mission.safety.pose_timeout_s,
            "background": self.background,
            "files": self.files,
        }

    def frame(self) -> dict[str, Any]:
        """The present."""
        return {
            "kind": "frame",
            "t_s": self._at_s(self._now_ns),
            "left": round(self._left, 4),
            "detections": self._count,
            "end": self._end,
            "robots": [self._robot(robot) for robot in self._robots.values()],
            "sources": [_source(source) for source in self._sources],
            "areas_m": self._areas,
            "marks": self._marks,
            "alarms": list(self._alarms()),
        }

    def grids(self) -> list[dict[str, Any]]:
        """Belief and exposure that have changed since this was last asked."""
        changed = [each for each in self._grids.values() if not each.get("sent")]
        for each in changed:
            each["sent"] = True
        return [{key: value for key, value in each.items() if key != "sent"} for each in changed]

    def all_grids(self) -> list[dict[str, Any]]:
        """Belief and exposure as they are."""
        return [{k: v for k, v in each.items() if k != "sent"} for each in self._grids.values()]

    @property
    def now_s(self) -> float:
        """Seconds since the start."""
        return self._at_s(self._now_ns)

    def news(self) -> list[dict[str, Any]]:
        """Detections and notes since this was last asked."""
        news = list(self._news)
        self._news.clear()
        return news

    def history(self) -> list[dict[str, Any]]:
        """Messages that bring a new browser up to date."""
        return [
            {
                "kind": "history",
                "tracks": {name: [list(p) for p in track] for name, track in self.tracks.items()},
                "series": self.series,
                "detections": list(self.detections),
                "notes": list(self.notes),
            },
            *self.all_grids(),
        ]

    # -- taking events ------------------------------------------------------------------------------------------

    def _tick(self, now_ns: int) -> None:
        if self._start_ns is None:
            self._start_ns = now_ns
        t_s = self._at_s(now_ns)
        fresh_ns = round(self.mission.safety.pose_timeout_s * 1e9)
        places = []
        for name, robot in self._robots.items():
            if robot.pose is None or now_ns - robot.pose.t_ns > fresh_ns:
                continue
            here = (robot.pose.east_m, robot.pose.north_m)
            track = self.tracks[name]
            if not track or math.dist(track[-1][1:], here) > 0.05:
                track.append((round(t_s, 1), round(here[0], 2), round(here[1], 2)))
                thin(track, TRACK_POINTS)
            if robot.radio_down_ns is None:
                places.append(here)
        self._exposure.listen(places, now_ns)

    def _operator(self, event: Operator) -> None:
        if event.action == "mark":
            self._mark(event)
            return
        if event.action == "exclude" and len(event.area_m) >= 3:
            self._areas.append([tuple(corner) for corner in event.area_m])  # type: ignore[misc]
        for name, robot in self._robots.items():
            if event.robot not in (None, name):
                continue
            if event.action in ("hold", "return", "release", "withdraw"):
                robot.ordered = event.action
                self._paths.pop(name, None)
            elif event.action == "resume":
                robot.ordered = ""
                self._calls.pop(name, None)

    def _mark(self, event: Operator) -> None:
        """A person's word, where they stand; of somebody whose place is not known it says nothing."""
        robot = self._robots.get(event.robot or "")
        if robot is not None and robot.place_m is not None:
            east_m, north_m = robot.place_m
            self._marks.append({"by": robot.name, "east_m": round(east_m, 2), "north_m": round(north_m, 2)})

    def _point(self, t_ns: int) -> None:
        known = {str(s.ident): round(s.p_here, 3) for s in self._sources}
        row = {"t_s": self._at_s(t_ns), "left": round(self._left, 4), "p": known}
        self.series.append(row)
        self._news.append({"point": row})
        thin(self.series, SERIES_POINTS)

    def _at_s(self, t_ns: int) -> float:
        return 0.0 if self._start_ns is None else round((t_ns - self._start_ns) * 1e-9, 2)

    def _robot(self, robot: Watched) -> dict[str, Any]:
        pose, vehicle, name = robot.pose, robot.vehicle, robot.name
        order, answer = self._answers().get(name, ("", ""))
        command, why = self._commands.get(name, ("", ""))
        return {
            "name": name,
            "east_m": None if pose is None else round(pose.east_m, 3),
            "north_m": None if pose is None else round(pose.north_m, 3),
            "heading_deg": None if pose is None else round(pose.heading_deg, 1),
            "pose_age_s": None if pose is None else round((self._now_ns - pose.t_ns) * 1e-9, 1),
            "link_age_s": None
            if name not in self._seen_ns
            else round((self._now_ns - self._seen_ns[name]) * 1e-9, 1),
            "link_up": vehicle is not None and vehicle.link_up,
            "mode": "unknown" if vehicle is None else vehicle.mode,
            "armed": vehicle is not None and vehicle.armed,
            "battery_pct": None if vehicle is None else vehicle.battery_pct,
            "reserve_pct": round(reserve_of(robot, self.mission.safety), 1),
            "fence_m": None
            if robot.place_m is None
            else round(margin_m(robot.place_m, self.mission.fence_m), 2),
            "text": "" if vehicle is None else vehicle.text,
            "radio_up": robot.radio_down_ns is None,
            "ordered": robot.ordered,
            "call": self._calls.get(name, ""),
            "doing": self._doing.get(name, ""),
            "command": command,
            "why": why,
            "answer": answer if order else "",
            "path_m": self._paths.get(name, []),
            "target_m": self._targets.get(name),
        }


def _source(source: SourceEstimate) -> dict[str, Any]:
    """A source with the half axes (m) of its 90 % ellipse, and their turn counter-clockwise from east (deg)."""
    values, vectors = np.linalg.eigh(source.cov_m2)
    a, b = NORMAL_90 * np.sqrt(np.maximum(values[::-1], 0.0))
    turn = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1]))
    plain = asdict(source)
    return {
        "ident": source.ident,
        "state": source.state,
        "east_m": round(source.east_m, 2),
        "north_m": round(source.north_m, 2),
        "half_axes_m": [_finite(a), _finite(b)],
        "turn_deg": round(turn, 1),
        "p": round(source.p_here, 3),
        "receptions": round(source.receptions, 1),
        "power_db": _finite(source.power_db),
        "rate_hz": _finite(plain["rate_hz"], 4),
        "note": source.note,
    }


def _is_same(before: tuple[str, str] | None, now: tuple[str, str]) -> bool:
    """Whether a command is the one before, but for its numbers: ages count up while nothing happens."""
    return before is not None and _NUMBERS.sub("", " ".join(before)) == _NUMBERS.sub("", " ".join(now))


def _finite(value: float, digits: int = 2) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None


def grid(name: str, values: FloatArray, cell_m: float, scale: float | None = None) -> dict[str, Any]:
    """A grid (n_north, n_east) as bytes, row 0 south: the square root of the share of `scale` or of its largest."""
    block = max(1, math.ceil(max(values.shape) / GRID_SIDE))
    if block > 1:
        rows, columns = (-(-n // block) * block for n in values.shape)
        padded = np.zeros((rows, columns))
        padded[: values.shape[0], : values.shape[1]] = values
        values = padded.reshape(rows // block, block, columns // block, block).max(axis=(1, 3))
    largest = float(np.nanmax(values)) if scale is None else scale
    share = np.clip(np.nan_to_num(values) / largest, 0.0, 1.0) if largest > 0 else np.zeros_like(values)
    data = np.round(255.0 * np.sqrt(share)).astype(np.uint8)
    return {
        "kind": "grid",
        "name": name,
        "n_east": int(values.shape[1]),
        "n_north": int(values.shape[0]),
        "cell_m": cell_m * block,
        "largest": largest,
        "data": base64.b64encode(data.tobytes()).decode("ascii"),
    }


def number_or(value: object, otherwise: float) -> float:
    """A number that came from a browser, or else another."""
    with contextlib.suppress(TypeError, ValueError):
        number = float(value)  # type: ignore[arg-type]  # what is no number raises
        if number == number:
            return number
    return otherwise


def thin(rows: list[Any], most: int) -> None:
    """Drop every second of the older rows when there are too many: the shape stays, recent ones are all there."""
    if len(rows) > most:
        older = len(rows) * 3 // 4
        del rows[1:older:2]
