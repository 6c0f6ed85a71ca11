"""A whole log of readings as packets with places: for surveys, where all is known before anything is said."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fieldkit.engine.location.one_source import NO_SILENCE, Silence
from fieldkit.engine.location.several import Packets
from fieldkit.messages import FloatArray, IntArray, Pose, RssReading

SILENT_STEP_S = 1.0
LONGEST_STEP_S = 60.0
_MS = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class PacketLog:
    """See the module. `names` has each packet's sender where frames name it."""

    packets: Packets
    names: tuple[str, ...] = ()
    robots: tuple[str, ...] = ()
    t_ns: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    """(packets,)"""
    listened: Silence = NO_SILENCE
    """All places where robots were, and for how long."""
    without_place: int = 0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """One robot's poses, in order of time."""

    t_ns: IntArray
    place_m: FloatArray

    def at(self, t_ns: IntArray, max_gap_ns: int) -> tuple[FloatArray, np.ndarray]:
        """(n, 3) where it was, and (n,) whether that is known: between poses near enough, or right at one."""
        after = np.searchsorted(self.t_ns, t_ns)
        last = self.t_ns.size - 1
        low, high = np.clip(after - 1, 0, last), np.clip(after, 0, last)
        gap = self.t_ns[high] - self.t_ns[low]
        share = np.clip((t_ns - self.t_ns[low]) / np.maximum(gap, 1), 0.0, 1.0)
        place = self.place_m[low] + share[:, None] * (self.place_m[high] - self.place_m[low])
        near = np.minimum(np.abs(t_ns - self.t_ns[low]), np.abs(t_ns - self.t_ns[high]))
        inside = (after > 0) & (after <= last) & (gap <= max_gap_ns)
        return place, inside | (near == 0) | ((gap == 0) & (near <= max_gap_ns // 2))


def packets_of(
    readings: Sequence[RssReading],
    poses: Sequence[Pose],
    *,
    window_s: float,
    max_gap_s: float,
    offsets_db: Mapping[str, float] | None = None,
) -> PacketLog:
    """Readings of one frame, or within one window of the first and by different robots, are one packet."""
    paths = {robot: _path(poses, robot) for robot in sorted({pose.robot for pose in poses})}
    usable = [
        each for each in readings if each.robot in paths and each.via != "ed" and np.isfinite(each.rss_dbm)
    ]
    usable.sort(key=lambda each: each.t_ns)
    place = np.zeros((len(usable), 3))
    known = np.zeros(len(usable), dtype=bool)
    gap_ns = round(max_gap_s * 1e9)
    for robot, path in paths.items():
        mine = np.array([k for k, each in enumerate(usable) if each.robot == robot], dtype=np.int64)
        if mine.size:
            times = np.array([usable[k].t_ns for k in mine.tolist()], dtype=np.int64)
            place[mine], known[mine] = path.at(times, gap_ns)
    kept = [each for each, ok in zip(usable, known.tolist(), strict=True) if ok]
    number, names, began = _numbered(kept, round(window_s * 1e9))
    offsets = offsets_db or {}
    level = np.array([each.rss_dbm - offsets.get(each.robot, 0.0) for each in kept], dtype=float)
    listened = [listened_along(path, gap_ns) for path in paths.values()]
    return PacketLog(
        Packets(place[known], level, number),
        names,
        tuple(each.robot for each in kept),
        began,
        Silence(
            np.concatenate([each.place_m for each in listened]),
            np.concatenate([each.duration_s for each in listened]),
        ),
        len(readings) - len(kept),
    )


def _path(poses: Sequence[Pose], robot: str) -> Path:
    mine = sorted((pose for pose in poses if pose.robot == robot), key=lambda pose: pose.t_ns)
    return Path(
        np.array([pose.t_ns for pose in mine], dtype=np.int64),
        np.array([(pose.east_m, pose.north_m, pose.up_m) for pose in mine], dtype=float),
    )


def _numbered(readings: Sequence[RssReading], window_ns: int) -> tuple[IntArray, tuple[str, ...], IntArray]:
    """(n,) packet of each reading, each packet's sender, and when it began."""
    number = np.zeros(len(readings), dtype=np.int64)
    names: list[str] = []
    began: list[int] = []
    frames: list[str | None] = []
    heard_by: list[set[str]] = []
    for k, each in enumerate(readings):
        for candidate in range(len(began) - 1, max(-1, len(began) - 9), -1):
            if each.t_ns - began[candidate] > window_ns:
                continue
            same = frames[candidate] is None or each.frame_id is None or frames[candidate] == each.frame_id
            if same and each.robot not in heard_by[candidate]:
                number[k] = candidate
                heard_by[candidate].add(each.robot)
                frames[candidate] = frames[candidate] or each.frame_id
                break
        else:
            number[k] = len(began)
            began.append(each.t_ns)
            frames.append(each.frame_id)
            heard_by.append({each.robot})
    # An address stands before its sequence number.
    names = [(frame or "").split("/")[0] for frame in frames]
    return number, tuple(names), np.array(began, dtype=np.int64)


def listened_along(path: Path, max_gap_ns: int) -> Silence:
    """Where a robot was between its poses; longer gaps are nobody's."""
    gap = np.diff(path.t_ns)
    near = (gap > 0) & (gap <= max_gap_ns)
    middle = 0.5 * (path.place_m[:-1] + path.place_m[1:])
    return Silence(middle[near], gap[near] * 1e-9)
