"""What robots heard in a campaign, session by session, ready for a belief: transmissions and stretches of listening.

Recordings whose times overlap are one session: a transmission that robots of two missions heard is one. Between
sessions nobody listened, so each has an association of its own, and any process may prepare any of them.
"""

import hashlib
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from fieldkit.engine.association.detections import Associator
from fieldkit.engine.grid import Grid
from fieldkit.errors import DataError, FieldkitError, RecordingError, os_words
from fieldkit.files import write_whole
from fieldkit.messages import Detection, Event, FloatArray, Listening, Pose, ReceiverState, RssReading
from fieldkit.recording.made_with import software
from fieldkit.recording.reader import Recording
from fieldkit.settings import TICK_S
from mission.core.kernel_settings import KernelSettings
from mission.core.mission_file import Mission

TICK_NS = round(TICK_S * 1e9)
AFTER_NS = 5_000_000_000
"""So long after a session's last event its last transmissions have been closed."""
SCHEMA = 1
"""Of the files of prepared sessions; another number is prepared anew."""

Heard = Pose | RssReading | ReceiverState
"""What the world said."""


@dataclass(frozen=True, slots=True)
class Part:
    """One recording of a campaign."""

    recording: Recording
    mission: Mission
    names: Mapping[str, str]
    """Robot to its name in the campaign: radios of one name may differ from day to day."""
    to_common: FloatArray
    """(2, 3): east and north in the common frame are this times (east, north, 1)."""
    up_m: float
    """Added to heights."""
    began_ns: int
    ended_ns: int
    """Both in the campaign's time."""
    later_ns: int = 0
    """Added to the recording's times: they begin at nought where its clock was simulated, or never set."""

    @property
    def identity(self) -> list[object]:
        """Changes when the recording does, or the frame it is moved to."""
        files = []
        for path in self.recording.parts:
            try:
                stat = path.stat()
                files.append([str(path.resolve()), stat.st_size, stat.st_mtime_ns])
            except OSError:  # it has gone meanwhile; whoever reads it says so
                files.append([str(path), 0, 0])
        return [files, list(self.names), self.to_common.tolist(), self.up_m, self.later_ns]


def sessions_of(parts: Sequence[Part]) -> list[list[Part]]:
    """Recordings that overlap in time together, in order of time."""
    sessions: list[list[Part]] = []
    until_ns = 0
    for part in sorted(parts, key=lambda each: each.began_ns):
        if sessions and part.began_ns <= until_ns + AFTER_NS:
            sessions[-1].append(part)
        else:
            sessions.append([part])
        until_ns = max(until_ns, part.ended_ns)
    return sessions


@dataclass(frozen=True, slots=True)
class Preparing:
    """One session to be prepared: a job that travels."""

    recordings: tuple[Recording, ...]
    robots: tuple[tuple[str, ...], ...]
    """Of each recording, as they are called in it."""
    to_common: tuple[FloatArray, ...]
    up_m: tuple[float, ...]
    later_ns: tuple[int, ...]
    flying: frozenset[str]
    """By their names in the session."""
    window_s: float
    lateness_s: float
    max_pose_gap_s: float
    out: str
    """Path of the file to be written."""

    def events(self) -> tuple[list[Event], list[tuple[int, str]]]:
        """What the world said, in order of time, in the common frame; and which recordings cannot be read, and why."""
        events: list[Event] = []
        refused = []
        for number, recording in enumerate(self.recordings):
            try:
                heard = [event for _, _, event in recording.events() if isinstance(event, Heard)]
            except FieldkitError as error:
                refused.append((number, str(error)))
            except OSError as error:
                refused.append((number, f"{recording.path}: cannot be read any more: {os_words(error)}"))
            else:
                events += [self._moved(event, number) for event in heard]
        return sorted(events, key=lambda event: event.t_ns), refused

    def _moved(self, event: Heard, number: int) -> Event:
        name, t_ns = own_name(number, event.robot), event.t_ns + self.later_ns[number]
        if not isinstance(event, Pose):
            return replace(event, robot=name, t_ns=t_ns)
        east_m, north_m = self.to_common[number] @ (event.east_m, event.north_m, 1.0)
        up_m = event.up_m + self.up_m[number]
        return replace(event, robot=name, t_ns=t_ns, east_m=float(east_m), north_m=float(north_m), up_m=up_m)


def own_name(number: int, robot: str) -> str:
    """A robot's name in its session, by the number of its recording there."""
    return f"{number}.{robot}"


@dataclass(frozen=True, slots=True)
class Prepared:
    """What came of a job. Path as text: it travels."""

    path: str
    refused: tuple[tuple[int, str], ...]
    """Which recordings of the session could not be read after all, and why."""
    rows: int
    """Transmissions and stretches of listening."""
    detections: int
    last_ns: int
    """Of the last that was heard; 0 where nothing was."""


def computed_by() -> list[tuple[str, str]]:
    """What the numbers of a piece may depend on: its code, not the commit, which may change words alone."""
    return sorted((name, said) for name, said in software().items() if name != "commit")


def job_of(together: Sequence[Part], kernel: KernelSettings, folder: Path) -> Preparing:
    """The job that prepares a session, in a file whose name says of what and how."""
    flying = frozenset(
        own_name(number, robot)
        for number, part in enumerate(together)
        for robot in part.mission.kernel.altitude_m
    )
    how = (kernel.association_window_s, kernel.association_lateness_s, kernel.max_pose_gap_s)
    said = [SCHEMA, [part.identity for part in together], sorted(flying), how, computed_by()]
    key = hashlib.sha256(json.dumps(said).encode()).hexdigest()[:20]
    return Preparing(
        tuple(_anywhere(part.recording) for part in together),
        tuple(tuple(part.names) for part in together),
        tuple(part.to_common for part in together),
        tuple(part.up_m for part in together),
        tuple(part.later_ns for part in together),
        flying,
        *how,
        str(folder / f"session-{key}.npz"),
    )


def _anywhere(recording: Recording) -> Recording:
    """The same for a worker that stands in another folder."""
    return replace(recording, parts=[path.absolute() for path in recording.parts])


def prepare(job: Preparing) -> Prepared:
    """Read a session's recordings and associate what was heard, once: what is there already is taken as it is."""
    out = Path(job.out)
    if out.exists():
        return _known(out, ())
    events, refused = job.events()
    session = _associated(job, events)
    if refused:
        # The file has another name then: once the recording is back, the session is prepared anew.
        numbers = "-".join(str(number) for number, _ in refused)
        out = out.with_stem(f"{out.stem}-without-{numbers}")
    write_whole(out, session.packed())
    return _known(out, tuple(refused))


def _known(path: Path, refused: tuple[tuple[int, str], ...]) -> Prepared:
    session = Session.read(path)
    return Prepared(str(path), refused, len(session.heard), session.detections, session.last_ns)


def _associated(job: Preparing, events: Sequence[Event]) -> "Session":
    robots = tuple(own_name(number, robot) for number, its in enumerate(job.robots) for robot in its)
    associator = Associator(
        robots,
        window_s=job.window_s,
        lateness_s=job.lateness_s,
        max_pose_gap_s=job.max_pose_gap_s,
        flying=job.flying,
    )
    rows: list[Detection | Listening] = []

    def tick(now_ns: int) -> None:
        detections, stretches = associator.advance(now_ns)
        rows.extend(stretches)
        rows.extend(detections)

    last_ns = events[-1].t_ns if events else 0
    now_ns = events[0].t_ns if events else AFTER_NS
    for event in events:
        while now_ns < event.t_ns:
            tick(now_ns)
            now_ns += TICK_NS
        match event:
            case RssReading():
                associator.reading(event)
            case Pose():
                associator.pose(event)
            case ReceiverState():
                associator.receiver(event)
    while now_ns < last_ns + AFTER_NS + TICK_NS:
        tick(now_ns)
        now_ns += TICK_NS
    return Session.of(robots, rows, last_ns)


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """What was heard, and where robots listened, in the order in which it became certain: a row each, n of them."""

    robots: tuple[str, ...]
    heard: NDArray[np.bool_]
    """(n,) whether the row is a transmission; else it is a stretch of listening."""
    t_ns: NDArray[np.int64]
    """(n, 2) from and to; twice the same for a transmission."""
    sender: NDArray[np.str_]
    """(n,) as the frame names it; empty where it does not."""
    row: NDArray[np.int64]
    """(k,) of each entry, increasing: to which row it belongs."""
    robot: NDArray[np.int64]
    """(k,) of each entry: which robot."""
    place: FloatArray
    """(k, 5) of each entry: east and north in metres, heading in degrees, height and deviation in metres."""
    rss_dbm: FloatArray
    """(k,) nan where the robot heard nothing."""
    saturated: NDArray[np.bool_]
    last_ns: int

    @classmethod
    def of(cls, robots: tuple[str, ...], rows: Sequence[Detection | Listening], last_ns: int) -> "Session":
        """Rows as they came from the association."""
        number = {robot: index for index, robot in enumerate(robots)}
        entries = [len(row.robots) for row in rows]
        heard = np.array([isinstance(row, Detection) for row in rows], dtype=bool)
        times = [(r.t_ns, r.t_ns) if isinstance(r, Detection) else (r.t0_ns, r.t1_ns) for r in rows]
        places = [np.column_stack([r.position_m, r.heading_deg, r.up_m, r.sigma_m]) for r in rows if r.robots]
        rss = [r.rss_dbm if isinstance(r, Detection) else np.full(len(r.robots), np.nan) for r in rows]
        full = [r.saturated if isinstance(r, Detection) else np.zeros(len(r.robots), bool) for r in rows]
        return cls(
            robots,
            heard,
            np.array(times, dtype=np.int64).reshape(-1, 2),
            np.array([(r.sender or "") if isinstance(r, Detection) else "" for r in rows], dtype=np.str_),
            np.repeat(np.arange(len(rows), dtype=np.int64), entries),
            np.array([number[robot] for r in rows for robot in r.robots], dtype=np.int64),
            np.concatenate([np.zeros((0, 5)), *places]),
            np.concatenate([np.zeros(0), *rss]),
            np.concatenate([np.zeros(0, dtype=bool), *full]),
            last_ns,
        )

    @property
    def detections(self) -> int:
        """How many transmissions were heard."""
        return int(self.heard.sum())

    def packed(self) -> bytes:
        """As a file of arrays (npz)."""
        stream = io.BytesIO()
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        np.savez_compressed(
            stream, robots=np.array(self.robots, dtype=np.str_), last_ns=np.int64(self.last_ns), **arrays
        )
        return stream.getvalue()

    @classmethod
    def read(cls, path: Path) -> "Session":
        """The session in a file. Raises `DataError` where there is none, saying what to do."""
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: file[name] for name in _ARRAYS}
                robots, last_ns = tuple(file["robots"].tolist()), int(file["last_ns"])
        except (OSError, ValueError, KeyError, BadZipFile) as error:
            raise DataError(
                f"{path}: the prepared session cannot be read ({error}); delete it and run the command again"
            ) from error
        return cls(robots, last_ns=last_ns, **arrays)

    def within(self, box: Grid) -> "Session":
        """Of robots while they were in `box` alone: rows that none of them is in go, and what none of them heard."""
        low = np.array([box.west_m, box.south_m])
        high = low + np.array([box.size_east_m, box.size_north_m])
        keep = ((self.place[:, :2] >= low) & (self.place[:, :2] <= high)).all(axis=1)
        rows = np.zeros(len(self.heard), dtype=bool)
        rows[self.row[keep & (~self.heard[self.row] | ~np.isnan(self.rss_dbm))]] = True
        keep &= rows[self.row]
        renumbered = np.cumsum(rows) - 1
        return replace(
            self,
            heard=self.heard[rows],
            t_ns=self.t_ns[rows],
            sender=self.sender[rows],
            row=renumbered[self.row[keep]],
            robot=self.robot[keep],
            place=self.place[keep],
            rss_dbm=self.rss_dbm[keep],
            saturated=self.saturated[keep],
        )

    def named(self, names: Sequence[str]) -> Iterator[Detection | Listening]:
        """Its rows with robots by these names, in order."""
        starts = np.searchsorted(self.row, np.arange(len(self.heard) + 1))
        for row, (first, last) in enumerate(pairwise(starts.tolist())):
            its = slice(first, last)
            robots = tuple(names[index] for index in self.robot[its].tolist())
            place = self.place[its]
            position_m, heading_deg = place[:, :2].copy(), place[:, 2].copy()
            up_m, sigma_m = place[:, 3].copy(), place[:, 4].copy()
            t0_ns, t1_ns = self.t_ns[row].tolist()
            if not self.heard[row]:
                yield Listening(t0_ns, t1_ns, robots, position_m, up_m, heading_deg, sigma_m)
                continue
            yield Detection(
                t0_ns,
                robots,
                position_m,
                heading_deg,
                self.rss_dbm[its].copy(),
                self.saturated[its].copy(),
                up_m=up_m,
                sigma_m=sigma_m,
                sender=str(self.sender[row]) or None,
            )


_ARRAYS = ("heard", "t_ns", "sender", "row", "robot", "place", "rss_dbm", "saturated")


def span_ns(recording: Recording) -> tuple[int, int]:
    """When a recording begins and ends. Raises `RecordingError` where it holds no events."""
    for _, _, event in recording.events():
        summary = recording.summary()
        begins_ns = summary["start_ns"] if summary["start_ns"] is not None else event.t_ns
        return event.t_ns, max(event.t_ns, begins_ns + round(summary["duration_s"] * 1e9))
    raise RecordingError(f"{recording.path}: it holds no events")
