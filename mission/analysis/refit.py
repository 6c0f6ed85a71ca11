"""One belief over a whole campaign: what many missions heard in one field, days and teams apart, on one map.

Recordings whose times overlap are one session: a transmission that robots of two missions heard is one. Between
sessions nobody listened. What each mission decided is left out, and so is its planner: the kernel is fed with what the
world said alone, and nobody is steered.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.channel.antenna_file import Receiver
from fieldkit.engine.association.detections import Associator
from fieldkit.engine.grid import Grid
from fieldkit.errors import DataError, FieldkitError
from fieldkit.geo import FieldFrame
from fieldkit.geometry.polygons import NOWHERE
from fieldkit.messages import Event, FloatArray, Pose, ReceiverState, RssReading, SourceEstimate, Tick
from fieldkit.recording.reader import Recording, open_recording
from fieldkit.settings import TICK_S
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.core.mission_file import Mission
from mission.maps.present import CLAIMED, Present
from mission.replay.command import Changes, changed_mission

MOST_CELLS = 250_000
"""The common grid's cells grow until there are no more: the belief's memory goes with them."""
TICK_NS = round(TICK_S * 1e9)
AFTER_NS = 5_000_000_000
"""So long after a session's last event its last transmissions have been closed."""
MOST_THOUGHTS = 100
"""After a session the belief thinks over what it has taken in, until nothing changes or so often."""

Progress = Callable[[float, str], None]
"""Share done, and words."""


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

    def events(self) -> list[Event]:
        """What the world said, in order of time, in the common frame."""
        moved = [event for _, _, event in self.recording.events() if isinstance(event, Heard)]
        return sorted(map(self._moved, moved), key=lambda event: event.t_ns)

    def _moved(self, event: "Heard") -> Event:
        name = self.names.get(event.robot, event.robot)
        if not isinstance(event, Pose):
            return replace(event, robot=name)
        east_m, north_m = self.to_common @ (event.east_m, event.north_m, 1.0)
        return replace(
            event, robot=name, east_m=float(east_m), north_m=float(north_m), up_m=event.up_m + self.up_m
        )


Heard = Pose | RssReading | ReceiverState


@dataclass(frozen=True, slots=True)
class Refitted:
    """What a campaign says as one."""

    kernel: Kernel
    frame: FieldFrame
    """Of the common grid; its origin is the south-west corner of all fields."""
    grid: Grid
    parts: tuple[Part, ...]
    sessions: int
    began_ns: int
    ended_ns: int
    refused: tuple[str, ...]
    """Recordings that could not be taken in, in words."""

    def sources(self) -> list[SourceEstimate]:
        """Its estimates, in metres of the common frame."""
        return self.kernel.sources()

    def present(self) -> Present:
        """The sources of which a position is claimed, for maps."""
        claimed = tuple(source for source in self.sources() if source.state in CLAIMED)
        name = f"{len(self.parts)} recordings"
        return Present(
            name, self.frame, self.ended_ns, self.began_ns, (), claimed, (), frozenset(), frozenset()
        )


def refit(logs: Sequence[Path], changes: Changes, report: Progress = lambda share, words: None) -> Refitted:
    """Feed everything that was heard in `logs` to one belief; those that cannot be read are named and left out.

    Raises `DataError` where nothing is left, where recordings were made with different calibrations, and where their
    fields do not hang together.
    """
    missions, refused = [], []
    for log in logs:
        try:
            recording = open_recording(log)
            missions.append((recording, changed_mission(recording, changes), _began_ns(recording)))
        except FieldkitError as error:
            refused.append(str(error))
    if not missions:
        raise DataError("no recording could be taken in: " + "; ".join(refused))
    missions.sort(key=lambda each: each[2])
    _check_one_calibration([mission for _, mission, _ in missions])
    frame, grid = common_ground([mission for _, mission, _ in missions])
    parts = tuple(
        Part(
            recording,
            mission,
            {
                robot: robot if len(missions) == 1 else f"{number}.{robot}"
                for robot in mission.kernel.engine.robots
            },
            *_between(mission.frame, frame),
            began_ns,
        )
        for number, (recording, mission, began_ns) in enumerate(missions, start=1)
    )
    kernel = Kernel(_joint([each.mission for each in parts], [each.names for each in parts], grid))
    done = sessions = last_ns = 0
    for together, events in _sessions(parts):
        sessions += 1
        report(done / len(parts), f"{done} of {len(parts)} recordings")
        _take_in(kernel, together, events)
        last_ns = events[-1].t_ns
        done += len(together)
    report(1.0, f"{done} of {len(parts)} recordings")
    return Refitted(kernel, frame, grid, parts, sessions, parts[0].began_ns, last_ns, tuple(refused))


def common_ground(missions: Sequence[Mission]) -> tuple[FieldFrame, Grid]:
    """The frame and grid that hold the fields of all. Raises `DataError` where that would be mostly empty ground."""
    first = missions[0].frame
    corners = []
    for mission in missions:
        field = mission.file.field
        matrix, _ = _between(mission.frame, first)
        for east_m, north_m in ((0.0, 0.0), (field.size_east_m, field.size_north_m)):
            corners.append(matrix @ (east_m, north_m, 1.0))
    west_m, south_m = np.floor(np.min(corners, axis=0) * 100.0 + 0.5) / 100.0
    east_m, north_m = np.max(corners, axis=0)
    lat_deg, lon_deg, _ = first.to_geodetic(float(west_m), float(south_m))
    moved = (west_m, south_m) != (0.0, 0.0)
    frame = FieldFrame(lat_deg, lon_deg, first.origin_alt_m) if moved else first
    size_east_m, size_north_m = float(east_m - west_m), float(north_m - south_m)
    area_m2 = sum(each.file.field.size_east_m * each.file.field.size_north_m for each in missions)
    if size_east_m * size_north_m > 100.0 * area_m2:
        raise DataError(
            f"the fields lie {size_east_m:.0f} by {size_north_m:.0f} m apart and are small in that: they have nothing "
            "in common; refit each place by itself"
        )
    cell_m = min(each.file.field.cell_m for each in missions)
    cell_m = max(cell_m, float(np.sqrt(size_east_m * size_north_m / MOST_CELLS)))
    return frame, Grid(size_east_m, size_north_m, cell_m)


def _between(own: FieldFrame, common: FieldFrame) -> tuple[FloatArray, float]:
    """The map from one frame's east and north to another's, (2, 3), and what is added to heights.

    Both are tangent to the ellipsoid: over the kilometres of a field the map is affine to millimetres.
    """
    if own == common:
        return np.eye(2, 3), 0.0
    step_m = 1000.0
    at, east, north = (
        np.array(common.to_local(*own.to_geodetic(*place)))
        for place in ((0.0, 0.0), (step_m, 0.0), (0.0, step_m))
    )
    matrix = np.column_stack([(east - at)[:2] / step_m, (north - at)[:2] / step_m, at[:2]])
    return matrix, own.origin_alt_m - common.origin_alt_m


def _check_one_calibration(missions: Sequence[Mission]) -> None:
    first = missions[0]
    for other in missions[1:]:
        if other.antenna.antenna != first.antenna.antenna:
            raise DataError(
                f"{other.where} and {first.where} were made with different calibrations: say by --antenna which one "
                "holds for all, or refit them apart"
            )


def _joint(missions: Sequence[Mission], names: Sequence[Mapping[str, str]], grid: Grid) -> KernelSettings:
    """The settings of a mission that all robots are in; nothing ends it, and nobody is steered."""
    first = missions[0].kernel
    robots = [name for each in names for name in each.values()]
    receivers: dict[str, Receiver] = {}
    altitude_m: dict[str, float] = {}
    for mission, its in zip(missions, names, strict=True):
        receivers |= {its[robot]: each for robot, each in mission.kernel.engine.receivers.items()}
        altitude_m |= {its[robot]: each for robot, each in mission.kernel.altitude_m.items()}
    engines = [mission.kernel.engine for mission in missions]
    teams = engines[0].teams if len(missions) == 1 else tuple((name,) for name in robots)
    engine = replace(
        engines[0],
        grid=grid,
        teams=teams,
        power_levels_db=tuple(sorted({level for each in engines for level in each.power_levels_db})),
        expected_sources=max(each.expected_sources for each in engines),
        reference_rate_hz=min(each.reference_rate_hz for each in engines),
        pose_sigma_m=max(each.pose_sigma_m for each in engines),
        receivers=receivers,
        keep_out=NOWHERE,
    )
    return replace(
        first,
        engine=engine,
        altitude_m=altitude_m,
        max_duration_s=float("inf"),
        idle_limit_s=float("inf"),
        sources_expected=None,
        stop_probability_left=None,
        stop_after_periods=None,
    )


def _began_ns(recording: Recording) -> int:
    for _, _, event in recording.events():
        return event.t_ns
    raise DataError(f"{recording.path}: it holds no events")


def _sessions(parts: Sequence[Part]) -> Iterator[tuple[list[Part], list[Event]]]:
    """Recordings that overlap in time together, with their events in order of time."""
    waiting = list(parts)
    while waiting:
        together = [waiting.pop(0)]
        events = together[0].events()
        while waiting and events and waiting[0].began_ns <= events[-1].t_ns + AFTER_NS:
            together.append(waiting.pop(0))
            events = sorted(events + together[-1].events(), key=lambda event: event.t_ns)
        if events:
            yield together, events


def _take_in(kernel: Kernel, together: Sequence[Part], events: Sequence[Event]) -> None:
    """One session, through an association of its own: between sessions nothing is known of anybody."""
    settings = kernel.settings
    kernel.associator = Associator(
        tuple(name for part in together for name in part.names.values()),
        window_s=settings.association_window_s,
        lateness_s=settings.association_lateness_s,
        max_pose_gap_s=settings.max_pose_gap_s,
        flying=settings.altitude_m,
    )
    now_ns = events[0].t_ns
    for event in events:
        while now_ns < event.t_ns:
            kernel.step(Tick(now_ns))
            now_ns += TICK_NS
        kernel.step(event)
    while now_ns < events[-1].t_ns + AFTER_NS:
        kernel.step(Tick(now_ns))
        now_ns += TICK_NS
    for _ in range(MOST_THOUGHTS):
        if not kernel.belief.reflect():
            break
    kernel.step(Tick(now_ns))


def plain(done: Refitted) -> dict[str, Any]:
    """Its key figures, JSON-ready; positions also as latitude and longitude."""
    from mission.replay.command import plain_source

    sources = []
    for source in done.sources():
        lat_deg, lon_deg, _ = done.frame.to_geodetic(source.east_m, source.north_m)
        sources.append(plain_source(source) | {"lat_deg": round(lat_deg, 7), "lon_deg": round(lon_deg, 7)})
    return {
        "recordings": len(done.parts),
        "sessions": done.sessions,
        "refused": list(done.refused),
        "missing": [f"{p.recording.path}: {p.recording.missing}" for p in done.parts if p.recording.missing],
        "origin_lat_deg": done.frame.origin_lat_deg,
        "origin_lon_deg": done.frame.origin_lon_deg,
        "size_east_m": round(done.grid.size_east_m, 2),
        "size_north_m": round(done.grid.size_north_m, 2),
        "cell_m": round(done.grid.cell_m, 3),
        "detections": done.kernel.detections,
        "probability_left": round(done.kernel.belief.probability_left(), 4),
        "belief_hash": done.kernel.digest(),
        "sources": sources,
    }
