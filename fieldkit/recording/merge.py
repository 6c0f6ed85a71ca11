"""One recording of robots that logged apart: their events on one clock, in order of time, ready for replay.

What each kernel decided on its own is left out: nobody saw the whole. Ticks are made anew. Positions may also come from
logs of other programs (MAVLink .tlog, dataflash .bin, GPX, CSV), by the readers installed as `fieldkit.tracks`.
"""

import heapq
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fieldkit import plugins
from fieldkit.errors import DataError, RecordingError
from fieldkit.geo import FieldFrame
from fieldkit.messages import Event, Pose, RssReading, Tick
from fieldkit.recording.log import open_log
from fieldkit.recording.offsets import Offset, estimate_offset
from fieldkit.recording.reader import Recording, open_recording
from fieldkit.recording.rewrite import verify
from fieldkit.recording.writer import RecordingWriter
from fieldkit.settings import TICK_S

SAME_FIELD = ("origin_lat_deg", "origin_lon_deg", "size_east_m", "size_north_m")
AROUND_NS = 60_000_000_000
"""Positions so long before and after the recordings still count."""
PAUSE_NS = 600_000_000_000
"""Where nothing is known for longer, the clock jumps instead of ticking."""
NO_SHIFT = Offset(0.0, 0.0, 0, "given")


@dataclass(frozen=True, slots=True)
class Merged:
    """What was merged."""

    offsets: dict[str, Offset]
    """Input to what was added to its times."""
    events: int
    robots: tuple[str, ...]
    missing: tuple[str, ...]
    """What the inputs lack, each in words."""


def merge(paths: list[Path], out: Path, *, given_s: dict[str, float] | None = None) -> Merged:
    """Merge recordings (and position logs) to `out`, on the first recording's clock.

    Clock offsets come from shared receptions, or from `given_s` by the input's name or path; a position log's clock is
    taken as it is unless given. Raises `DataError` for recordings of different fields, for a robot that is in two of
    them, and where offsets cannot be estimated; then nothing is written.
    """
    recordings = [open_recording(path) for path in paths if path.suffix == ".mcap"]
    tracks = [path for path in paths if path.suffix != ".mcap"]
    if len(paths) < 2 or not recordings:
        raise DataError("merging needs a recording (.mcap) and something to merge with it")
    for path in paths:
        if sum(path.resolve() == other.resolve() for other in paths) > 1:
            raise DataError(f"{path}: is given twice")
    first = recordings[0]
    for other in recordings[1:]:
        _check_same_field(first, other)
    given = given_s or {}
    events = {str(r.path): _useful(r) for r in recordings}
    offsets = {str(first.path): NO_SHIFT}
    for other in recordings[1:]:
        offsets[str(other.path)] = _offset(first, other, events, given)
    frame = open_log(first.path).frame
    heard = [event.t_ns + offsets[name].nanoseconds for name, these in events.items() for event in these]
    for path in tracks:
        offset = offsets[str(path)] = Offset(_given(path, given) or 0.0, 0.0, 0, "given")
        events[str(path)] = _meanwhile(list(_poses(path, frame)), offset, heard, path)
    robots = _robots_once(events)
    shifted = [_shift(these, offsets[name].seconds) for name, these in events.items()]
    # Robots' own order of readings and poses is kept; between robots time decides.
    merged = list(_with_ticks(heapq.merge(*shifted, key=lambda event: event.t_ns)))
    _write(first, merged, offsets, out, frame)
    missing = tuple(f"{r.path}: {r.missing}" for r in recordings if r.missing)
    return Merged(offsets, len(merged), robots, missing)


def _check_same_field(first: Recording, other: Recording) -> None:
    mine, theirs = (tomllib.loads(r.mission_toml).get("field", {}) for r in (first, other))
    differing = [
        f"{key} {mine.get(key)} and {theirs.get(key)}"
        for key in SAME_FIELD
        if mine.get(key) != theirs.get(key)
    ]
    if differing:
        raise DataError(
            f"{other.path}: is of another field than {first.path} ({'; '.join(differing)}); only recordings of one "
            "field can be merged"
        )


def _useful(recording: Recording) -> list[Event]:
    """What the world said. Ticks belong to a mission that is over."""
    return sorted(
        (event for _, _, event in recording.events() if not isinstance(event, Tick)),
        key=lambda event: event.t_ns,
    )


def _given(path: Path, given_s: dict[str, float]) -> float | None:
    return next((given_s[name] for name in (str(path), path.name, path.stem) if name in given_s), None)


def _offset(
    first: Recording, other: Recording, events: dict[str, list[Event]], given_s: dict[str, float]
) -> Offset:
    if (seconds := _given(other.path, given_s)) is not None:
        return Offset(seconds, 0.0, 0, "given")
    mine, theirs = (
        [event for event in events[str(r.path)] if isinstance(event, RssReading)] for r in (first, other)
    )
    found = estimate_offset(mine, theirs)
    if found is None:
        raise DataError(
            f"{other.path}: what it heard ({len(theirs)} readings) and what {first.path} heard ({len(mine)}) do not "
            f"tell how far their clocks are apart; say it with --offset {other.path.name}=SECONDS (0 where both were "
            "set by GPS)"
        )
    return found


def _robots_once(events: dict[str, list[Event]]) -> tuple[str, ...]:
    """All robots. Raises `DataError` where one robot's readings or poses come from two inputs."""
    source: dict[tuple[str, str], str] = {}
    for name, these in events.items():
        for event in these:
            if isinstance(event, RssReading | Pose):
                key = (type(event).__name__, event.robot)
                if source.setdefault(key, name) != name:
                    kind = "readings" if isinstance(event, RssReading) else "poses"
                    raise DataError(
                        f"{name}: has {kind} of robot '{event.robot}', and so has {source[key]}; each robot may be in "
                        "one input only"
                    )
    return tuple(sorted({robot for _, robot in source}))


def _poses(path: Path, frame: FieldFrame | None) -> Iterator[Pose]:
    """Poses of a position log; the robot is named by the file's stem where the log names none."""
    track: Any = plugins.load("fieldkit.tracks", "file")(path)
    for spot in track.spots:
        east, north, up = spot.first, spot.second, spot.up_m
        if track.geodetic:
            if frame is None:
                raise RecordingError("the recording does not say where on Earth its field is")
            east, north, _ = frame.to_local(spot.first, spot.second)
        name = path.stem if spot.robot == "radio" else spot.robot
        yield Pose(spot.t_ns, name, east, north, up, spot.heading_deg, spot.sigma_m, path.suffix.lstrip("."))


def _meanwhile(poses: list[Pose], offset: Offset, heard_ns: list[int], path: Path) -> list[Event]:
    """The poses that fall into the time of the recordings, or just beside it. Raises `DataError` where none does."""
    if not heard_ns or not poses:
        return list(poses)
    begin, end = min(heard_ns) - AROUND_NS, max(heard_ns) + AROUND_NS
    inside: list[Event] = [pose for pose in poses if begin <= pose.t_ns + offset.nanoseconds <= end]
    if not inside:
        apart_s = (min(heard_ns) - poses[0].t_ns - offset.nanoseconds) * 1e-9
        raise DataError(
            f"{path}: none of its {len(poses)} positions is from the time of the recordings: it begins "
            f"{abs(apart_s):,.0f} s {'before' if apart_s > 0 else 'after'} them. If only its clock is off, say by how "
            f"much: --offset {path.name}=SECONDS"
        )
    return inside


def _shift(events: list[Event], seconds: float) -> list[Event]:
    if seconds == 0.0:
        return events
    return [replace(event, t_ns=event.t_ns + round(seconds * 1e9)) for event in events]


def _with_ticks(events: Iterable[Event]) -> Iterator[Event]:
    tick_ns = round(TICK_S * 1e9)
    next_ns: int | None = None
    t_ns = 0
    for event in events:
        t_ns = event.t_ns
        next_ns = t_ns if next_ns is None or t_ns - next_ns > PAUSE_NS else next_ns
        while next_ns < t_ns:
            yield Tick(next_ns)
            next_ns += tick_ns
        yield event
    if next_ns is not None:
        yield Tick(max(next_ns, t_ns))


def _write(
    first: Recording, events: list[Event], offsets: dict[str, Offset], out: Path, frame: FieldFrame | None
) -> None:
    if out.exists():
        raise RecordingError(f"{out}: exists already; name another file")
    if not events:
        raise RecordingError(f"{out}: nothing to merge: the inputs hold no events")
    how = {
        Path(name).name: {"seconds": o.seconds, "sigma_s": o.sigma_s, "shared": o.shared, "by": o.by}
        for name, o in offsets.items()
    }
    partial = out.with_name(f".{out.name}.part")
    partial.unlink(missing_ok=True)
    try:
        with RecordingWriter(
            partial,
            mission_toml=first.mission_toml,
            antenna_toml=first.antenna_toml,
            metadata=first.metadata | {"merged": how},
            frame=frame,
            start_ns=events[0].t_ns,
        ) as writer:
            for number, event in enumerate(events, start=1):
                writer.event(number, event.t_ns, event)
        if writer.failure:
            raise RecordingError(writer.failure)
        verify(partial, out, sum(open_recording(partial).summary()["counts"].values()))
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
