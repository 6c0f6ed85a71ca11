"""What the page shows, built up from the same stream that is recorded: live missions and recordings look alike.

A `View` is a `Follower`. `frame` is the present, `history` what a browser that has just come needs besides, and
`news` what has happened since it was last asked. Everything is plain and JSON-ready; units are in the names.
Lists are bounded: long ones are thinned, so that a day costs no more memory than an hour.
"""

import math
import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeVar

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
from mission.maps.background import BackgroundShown
from mission.maps.present import Latest
from mission.page.exposure import Exposure
from mission.page.grids import grid
from mission.page.protocol import (
    Ends,
    Frame,
    Grid,
    GridName,
    Heard,
    History,
    LiveHello,
    MarkedPlace,
    News,
    Note,
    PastHello,
    Place,
    Point,
    Robot,
    SavedAs,
    Source,
    TrackPoint,
    _Hello,
)
from mission.safety.monitor import Watched, reserve_of

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
Ordered = tuple[Literal["", "go to", "hold", "return"], str]
"""A command, and where to or why."""
Row = TypeVar("Row")


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
        self._commands: dict[str, Ordered] = {}
        self._calls: dict[str, str] = {}
        self._paths: dict[str, list[Place]] = {}
        self._doing: dict[str, str] = {}
        self._sources: list[SourceEstimate] = []
        self._now_ns = 0
        self._start_ns: int | None = None
        self._left = 1.0
        self._count = 0
        self._end = ""
        self._areas: list[list[Place]] = [list(p) for p in mission.file.field.keep_out]
        self._marks: list[MarkedPlace] = []
        """Where people say that a transmitter is."""
        self._targets: dict[str, Place] = {}
        """Robot to the way-point it is sent to now."""
        self._exposure = Exposure(engine)
        self.latest = Latest(mission)
        """The present, for other maps."""
        self.ends: Ends = "mission"
        self.background: BackgroundShown | None = None
        """Pictures under the map."""
        self.files: list[SavedAs] = [("GeoJSON", "sources.geojson"), ("KML", "present.kml")]
        self.tracks: dict[str, list[TrackPoint]] = {name: [] for name in engine.robots}
        """Robot to its places, thinned."""
        self.series: list[Point] = []
        """Over time: probability that one is left, and of each source."""
        self.detections: deque[Heard] = deque(maxlen=kept)
        self.notes: deque[Note] = deque(maxlen=kept)
        self._news: deque[News] = deque(maxlen=kept or 10_000)
        self._grids: dict[GridName, Grid] = {}
        self._changed: set[GridName] = set()

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
                self._targets[robot.name] = (round(waypoint.east_m, 2), round(waypoint.north_m, 2))
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
        row: Heard = {
            "t_s": self._at_s(detection.t_ns),
            "heard_dbm": heard,
            "listening": list(detection.robots),
        }
        self.detections.append(row)
        self._news.append({"kind": "news", "detection": row})

    def sources(self, inbox_number: int, log_time_ns: int, sources: Sequence[SourceEstimate]) -> None:
        """Take in what is believed of the sources."""
        self.latest.sources(inbox_number, log_time_ns, sources)
        self._sources = list(sources)
        self._point(log_time_ns)

    def plan(self, inbox_number: int, log_time_ns: int, plan: Plan) -> None:
        """Take in a plan."""
        for robot, path in plan.paths.items():
            self._paths[robot] = [(round(w.east_m, 2), round(w.north_m, 2)) for w in path]
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
            self._changed |= self._grids.keys()

    def note(self, level: Any, text: str, log_time_ns: int = 0) -> None:
        """Take in a line of the log."""
        row: Note = {"t_s": self._at_s(log_time_ns or self._now_ns), "level": str(level), "text": text}
        self.notes.append(row)
        self._news.append({"kind": "news", "note": row})

    def _announce(self, text: str, log_time_ns: int) -> None:
        """A decision of safety's among the notes; the recording has it as a command."""
        self.note("info", text, log_time_ns)

    def flush(self) -> None:
        """Nothing waits here."""

    def begin(self, start_ns: int) -> None:
        """The mission began then, whenever the first tick comes that is seen here."""
        self._start_ns = start_ns

    def until(self, now_ns: int) -> None:
        """Time passes: what is known is so much older."""
        self._now_ns = max(self._now_ns, now_ns)

    # -- what is shown ---------------------------------------------------------------------------------------

    def hello(self) -> LiveHello:
        """What does not change: the field, the robots, their teams."""
        return {**self._hello(), "live": True, "ends": self.ends}

    def _hello(self) -> _Hello:
        field = self.mission.file.field
        return {
            "kind": "hello",
            "mission": self.mission.file.name,
            "field": {
                "east_m": field.size_east_m,
                "north_m": field.size_north_m,
                "fence_m": [(east_m, north_m) for east_m, north_m in self.mission.fence_m],
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

    def past_hello(self, duration_s: float) -> PastHello:
        """The same for a recording so long."""
        return {**self._hello(), "live": False, "duration_s": duration_s}

    def frame(self) -> Frame:
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

    def grids(self) -> list[Grid]:
        """Belief and exposure that have changed since this was last asked."""
        changed, self._changed = self._changed, set()
        return [each for name, each in self._grids.items() if name in changed]

    def all_grids(self) -> list[Grid]:
        """Belief and exposure as they are."""
        return list(self._grids.values())

    @property
    def now_s(self) -> float:
        """Seconds since the start."""
        return self._at_s(self._now_ns)

    def news(self) -> list[News]:
        """Detections and notes since this was last asked."""
        news = list(self._news)
        self._news.clear()
        return news

    def history(self) -> History:
        """What brings a new browser up to date, but for the grids."""
        return {
            "kind": "history",
            "tracks": {name: list(track) for name, track in self.tracks.items()},
            "series": self.series,
            "detections": list(self.detections),
            "notes": list(self.notes),
        }

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
            self._areas.append([(east_m, north_m) for east_m, north_m in event.area_m])
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
        row: Point = {"t_s": self._at_s(t_ns), "left": round(self._left, 4), "p": known}
        self.series.append(row)
        self._news.append({"kind": "news", "point": row})
        thin(self.series, SERIES_POINTS)

    def _at_s(self, t_ns: int) -> float:
        return 0.0 if self._start_ns is None else round((t_ns - self._start_ns) * 1e-9, 2)

    def _robot(self, robot: Watched) -> Robot:
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
            "radio_why": robot.radio_why,
            "ordered": robot.ordered,
            "call": self._calls.get(name, ""),
            "doing": self._doing.get(name, ""),
            "command": command,
            "why": why,
            "answer": answer if order else "",
            "path_m": self._paths.get(name, []),
            "target_m": self._targets.get(name),
        }


def _source(source: SourceEstimate) -> Source:
    """A source with the half axes (m) of its 90 % ellipse, and their turn counter-clockwise from east (deg)."""
    values, vectors = np.linalg.eigh(source.cov_m2)
    a, b = NORMAL_90 * np.sqrt(np.maximum(values[::-1], 0.0))
    turn = math.degrees(math.atan2(vectors[1, 1], vectors[0, 1]))
    return {
        "ident": source.ident,
        "state": source.state,
        "east_m": round(source.east_m, 2),
        "north_m": round(source.north_m, 2),
        "half_axes_m": (_finite(a), _finite(b)),
        "turn_deg": round(turn, 1),
        "p": round(source.p_here, 3),
        "receptions": round(source.receptions, 1),
        "power_db": _finite(source.power_db),
        "rate_hz": _finite(source.rate_hz, 4),
        "note": source.note,
    }


def _is_same(before: Ordered | None, now: Ordered) -> bool:
    """Whether a command is the one before, but for its numbers: ages count up while nothing happens."""
    return before is not None and _NUMBERS.sub("", " ".join(before)) == _NUMBERS.sub("", " ".join(now))


def _finite(value: float, digits: int = 2) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None


def thin(rows: list[Row], most: int) -> None:
    """Drop every second of the older rows when there are too many: the shape stays, recent ones are all there."""
    if len(rows) > most:
        older = len(rows) * 3 // 4
        del rows[1:older:2]
