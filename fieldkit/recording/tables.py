"""A recording's contents as numpy structured arrays, one row a reading, pose, ... : what notebooks and exports use.

Every table has `t_ns` (UTC, the event's own time) and `t_s` (seconds since the mission's first tick). Texts are of
fixed width; missing numbers are nan, missing integers -1, missing texts empty.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldkit.errors import DataError
from fieldkit.messages import (
    Detection,
    EndMission,
    GoTo,
    Plan,
    Pose,
    ReceiverState,
    RssReading,
    SourceEstimate,
    Tick,
    VehicleState,
)
from fieldkit.recording.reader import Item, Recording

NEAR_POSE_S = 2.0
"""A reading is placed on a robot's path only where poses are no further apart than this."""

Rows = Iterator[tuple[Any, ...]]


@dataclass(frozen=True, slots=True)
class Table:
    """One kind of row: its columns (name to kind: "U" text, "f" number, "i" integer, "?" truth), and its maker."""

    about: str
    family: str
    columns: dict[str, str]
    rows: Callable[[Item], Rows]


def _readings(item: Item) -> Rows:
    r = item.value
    if isinstance(r, RssReading):
        yield (
            r.t_ns,
            r.robot,
            r.rss_dbm,
            r.via,
            _whole(r.channel),
            r.frame_id or "",
            _whole(r.lqi),
            r.saturated,
        )


def _poses(item: Item) -> Rows:
    p = item.value
    if isinstance(p, Pose):
        yield p.t_ns, p.robot, p.east_m, p.north_m, p.up_m, p.heading_deg, p.sigma_m, p.origin


def _detections(item: Item) -> Rows:
    d: Detection = item.value
    for k, robot in enumerate(d.robots):
        east, north = d.position_m[k]
        yield (
            d.t_ns, item.inbox_number, robot, east, north, d.heading_deg[k], d.rss_dbm[k], bool(d.saturated[k])
        )  # fmt: skip


def _sources(item: Item) -> Rows:
    for s in item.value:
        assert isinstance(s, SourceEstimate)
        (ee, en), (_, nn) = s.cov_m2 if np.shape(s.cov_m2) == (2, 2) else np.full((2, 2), np.nan)
        yield (
            item.log_time_ns, s.ident, s.state, s.east_m, s.north_m, ee, en, nn, s.p_here, s.p_exists, s.receptions,
            s.rate_hz, s.power_db, s.region_90, s.note,
        )  # fmt: skip


def _vehicles(item: Item) -> Rows:
    v = item.value
    if isinstance(v, VehicleState):
        battery = float("nan") if v.battery_pct is None else v.battery_pct
        yield v.t_ns, v.robot, v.mode, v.armed, v.link_up, battery, v.text


def _receivers(item: Item) -> Rows:
    r = item.value
    if isinstance(r, ReceiverState):
        yield r.t_ns, r.robot, r.up, r.reason


def _commands(item: Item) -> Rows:
    c = item.value
    east = north = speed = float("nan")
    if isinstance(c, GoTo):
        east, north, speed = c.waypoint.east_m, c.waypoint.north_m, c.waypoint.speed_m_s
    robot = "" if isinstance(c, EndMission) else c.robot
    yield c.t_ns, robot, item.origin, type(c).__name__, east, north, speed, getattr(c, "reason", "")


def _plans(item: Item) -> Rows:
    plan: Plan = item.value
    for robot, path in plan.paths.items():
        for leg, waypoint in enumerate(path):
            yield (
                plan.t_ns, robot, plan.purpose.get(robot, ""), leg, waypoint.east_m, waypoint.north_m,
                waypoint.speed_m_s,
            )  # fmt: skip


def _notes(item: Item) -> Rows:
    yield item.log_time_ns, item.value.level, item.value.text


TABLES: dict[str, Table] = {
    "readings": Table(
        "every reading; where its robot was then",
        "event",
        {"robot": "U", "rss_dbm": "f", "via": "U", "channel": "i", "frame_id": "U", "lqi": "i", "saturated": "?"},
        _readings,
    ),
    "poses": Table(
        "every pose of every robot",
        "event",
        {"robot": "U", "east_m": "f", "north_m": "f", "up_m": "f", "heading_deg": "f", "sigma_m": "f", "origin": "U"},
        _poses,
    ),
    "detections": Table(
        "each transmission by each robot that listened; rss_dbm is nan where it heard nothing",
        "detection",
        {
            "number": "i", "robot": "U", "east_m": "f", "north_m": "f", "heading_deg": "f", "rss_dbm": "f",
            "saturated": "?",
        },
        _detections,
    ),
    "sources": Table(
        "what was believed of each source, as time went on",
        "sources",
        {
            "ident": "i", "state": "U", "east_m": "f", "north_m": "f", "cov_ee_m2": "f", "cov_en_m2": "f",
            "cov_nn_m2": "f", "p_here": "f", "p_exists": "f", "receptions": "f", "rate_hz": "f", "power_db": "f",
            "region_90": "i", "note": "U",
        },
        _sources,
    ),
    "vehicles": Table(
        "what vehicles said of themselves",
        "event",
        {"robot": "U", "mode": "U", "armed": "?", "link_up": "?", "battery_pct": "f", "text": "U"},
        _vehicles,
    ),
    "receivers": Table(
        "receivers that went down or came back", "event", {"robot": "U", "up": "?", "reason": "U"}, _receivers
    ),
    "commands": Table(
        "what the kernel asked for and safety let pass",
        "command",
        {
            "robot": "U", "origin": "U", "command": "U", "east_m": "f", "north_m": "f", "speed_m_s": "f", "reason": "U",
        },
        _commands,
    ),
    "plans": Table(
        "way-points of every plan",
        "plan",
        {"robot": "U", "purpose": "U", "leg": "i", "east_m": "f", "north_m": "f", "speed_m_s": "f"},
        _plans,
    ),
    "notes": Table("faults and phases", "note", {"level": "U", "text": "U"}, _notes),
}  # fmt: skip
_KINDS = {"f": "f8", "i": "i8", "?": "?"}


def read_tables(recording: Recording, names: tuple[str, ...]) -> tuple[dict[str, np.ndarray], int]:
    """Tables by name as structured arrays, in one pass, and the moment (ns) their `t_s` counts from.

    Raises `DataError` for a name that is none of `TABLES`.
    """
    for name in names:
        if name not in TABLES:
            raise DataError(f"no table '{name}'; tables are: {', '.join(TABLES)}, belief")
    wanted = [(TABLES[name], rows) for name in names for rows in [[]]]  # type: ignore[var-annotated]
    families = {table.family for table, _ in wanted}
    first_ns = tick_ns = None
    for item in recording.items("event", *families):
        if item.kind == "event":
            first_ns = item.log_time_ns if first_ns is None else first_ns
            if isinstance(item.value, Tick):
                tick_ns = item.value.t_ns if tick_ns is None else tick_ns
                continue
        for table, rows in wanted:
            if table.family == item.kind:
                rows.extend(table.rows(item))
    start_ns = tick_ns if tick_ns is not None else first_ns or 0
    return {
        name: _array(table, rows, start_ns) for name, (table, rows) in zip(names, wanted, strict=True)
    }, start_ns


def _array(table: Table, rows: list[tuple[Any, ...]], start_ns: int) -> np.ndarray:
    columns = list(zip(*rows, strict=True)) if rows else [()] * (1 + len(table.columns))
    t_ns = np.array(columns[0], dtype=np.int64)
    named: dict[str, np.ndarray] = {"t_ns": t_ns, "t_s": (t_ns - start_ns) * 1e-9}
    for (name, kind), values in zip(table.columns.items(), columns[1:], strict=True):
        named[name] = np.array(values, dtype=_KINDS.get(kind, np.str_))
    return joined(named)


def joined(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Columns of equal length as one structured array."""
    dtype = [(name, values.dtype if values.dtype.itemsize else "U1") for name, values in columns.items()]
    out = np.empty(len(next(iter(columns.values()))), dtype=dtype)
    for name, values in columns.items():
        out[name] = values
    return out


def placed(readings: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """The readings with `east_m` and `north_m` of their robot then; nan where no pose is within `NEAR_POSE_S`."""
    place = np.full((len(readings), 2), np.nan)
    for robot in np.unique(readings["robot"]):
        mine = readings["robot"] == robot
        track = poses[poses["robot"] == robot]
        track = track[np.argsort(track["t_ns"], kind="stable")]
        if not len(track):
            continue
        t_ns = readings["t_ns"][mine]
        after = np.clip(np.searchsorted(track["t_ns"], t_ns), 1, max(1, len(track) - 1))
        near = np.minimum(
            abs(t_ns - track["t_ns"][after - 1]), abs(t_ns - track["t_ns"][np.minimum(after, len(track) - 1)])
        )
        t_s = (t_ns - track["t_ns"][0]) * 1e-9
        known_s = (track["t_ns"] - track["t_ns"][0]) * 1e-9
        for axis, name in enumerate(("east_m", "north_m")):
            place[mine, axis] = np.where(
                near <= NEAR_POSE_S * 1e9, np.interp(t_s, known_s, track[name]), np.nan
            )
    columns = {name: readings[name] for name in readings.dtype.names or ()}
    return joined(columns | {"east_m": place[:, 0], "north_m": place[:, 1]})


def _whole(value: int | None) -> int:
    return -1 if value is None else value
