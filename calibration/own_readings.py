"""A mission's own readings of one source whose place is known or found: what an antenna file can be updated with.

Where several sources sent, a transmission is taken only where the antenna file in use gives it to this source with
`SURE` probability: readings do not say whose they are.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.dataset import Readings, from_arrays
from fieldkit.channel.antenna_file import AntennaFile, Receiver, gain_db, spread_of
from fieldkit.errors import DataError
from fieldkit.messages import Detection, FloatArray, SourceEstimate
from fieldkit.recording import Recording, open_recording

SURE = 0.9
SPREADS = 3.0
"""Of the place of a found source: readings nearer than so many of them say little about distance."""
LEAST_CELL_M = 0.5
NEARBY_M = 3.0
"""A source said to be this near to a found one is the same."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a source is, how sure that is, and how strong it was taken to be."""

    east_m: float
    north_m: float
    spread_m: float = 0.0
    power_db: float = 0.0
    up_m: float = 0.0
    name: str = ""
    """The sender's address where it is known by it."""


def own_readings(
    path: Path, file: AntennaFile, source_m: tuple[float, float] | None = None, found: int | None = None
) -> tuple[Readings, str]:
    """Readings of the source at `source_m`, or of the one that was found under that number, and what was done in words.

    Raises `DataError` where the recording has no such source, or nothing that is surely of it.
    """
    recording = open_recording(path)
    finds = _finds(recording)
    mine, others = _whose(recording, finds, source_m, found)
    detections = [detection for _, _, detection in recording.detections()]
    kept = [each for each in detections if _is_of(each, mine, others, file)]
    if not kept:
        raise DataError(
            f"{path}: none of its {len(detections)} transmissions is surely of the source at "
            f"{mine.east_m:.1f} m east, {mine.north_m:.1f} m north"
        )
    readings = _as_readings(path, kept, mine, file)
    words = f"{len(kept)} of {len(detections)} transmissions are of this source with {SURE:.0%} probability"
    return readings, words


def _finds(recording: Recording) -> list[SourceEstimate]:
    last: list[SourceEstimate] = []
    for _, _, sources in recording.sources():
        last = sources
    return [each for each in last if each.state == "found"]


def _whose(
    recording: Recording, finds: list[SourceEstimate], source_m: tuple[float, float] | None, found: int | None
) -> tuple[Place, list[Place]]:
    """The source that is asked for, and all others that were found."""
    if source_m is not None:
        near = [
            each
            for each in finds
            if np.hypot(each.east_m - source_m[0], each.north_m - source_m[1]) < NEARBY_M
        ]
        power_db = next((each.power_db for each in near if np.isfinite(each.power_db)), 0.0)
        others = [_place(each) for each in finds if each not in near]
        return Place(*source_m, 0.0, power_db, name=near[0].name if near else ""), others
    chosen = [each for each in finds if found is None or each.ident == found]
    if len(chosen) == 1:
        return _place(chosen[0]), [_place(each) for each in finds if each is not chosen[0]]
    there = ", ".join(f"{each.ident} at {each.east_m:.1f} {each.north_m:.1f}" for each in finds) or "none"
    raise DataError(
        f"{recording.path}: whose readings? give --found NUMBER, or --source EAST NORTH; found there: {there}"
    )


def _place(source: SourceEstimate) -> Place:
    spread_m = float(np.sqrt(np.trace(source.cov_m2) / 2.0))
    power_db = source.power_db if np.isfinite(source.power_db) else 0.0
    return Place(source.east_m, source.north_m, spread_m, power_db, name=source.name)


def _is_of(detection: Detection, mine: Place, others: list[Place], file: AntennaFile) -> bool:
    if mine.name and detection.sender:
        return mine.name == detection.sender
    if not others:
        return True
    logs = np.array([_log_likelihood(detection, place, file) for place in (mine, *others)])
    share = np.exp(logs - logs.max())
    return bool(share[0] >= SURE * share.sum())


def _log_likelihood(detection: Detection, place: Place, file: AntennaFile) -> float:
    """How well a source there explains who heard what, its power being as it was found."""
    from scipy.special import log_ndtr

    spread = spread_of(file)
    sigma_db = float(np.hypot(spread.sigma_time_db, spread.sigma_place_db))
    mean = file.antenna.mean_rss_dbm(_range_m(detection, place), place.power_db)
    heard, rss = detection.heard, detection.rss_dbm
    z = (rss[heard] - mean[heard]) / sigma_db
    silent = log_ndtr((file.antenna.threshold_dbm - mean[~heard]) / sigma_db)
    return float(-0.5 * np.sum(z**2) + np.sum(silent))


def _range_m(detection: Detection, place: Place) -> FloatArray:
    """(m,) distances, in three dimensions where heights are known."""
    flat = np.hypot(*(np.array([place.east_m, place.north_m]) - detection.position_m).T)
    up = detection.up_m - place.up_m if detection.up_m.size else np.zeros(flat.size)
    result: FloatArray = np.hypot(flat, up)
    return result


def _as_readings(path: Path, detections: list[Detection], place: Place, file: AntennaFile) -> Readings:
    """One row for each robot that listened, less what its radio reports too much and its antenna's gain."""
    cell_m = max(LEAST_CELL_M, spread_of(file).correlation_m)
    columns: dict[str, list[FloatArray]] = {
        name: [] for name in ("range", "rss", "east", "north", "up", "gain", "t")
    }
    cells: list[str] = []
    for detection in detections:
        offset = np.array([file.receivers.get(robot, Receiver()).offset_db for robot in detection.robots])
        towards = np.array([place.east_m, place.north_m]) - detection.position_m
        bearing = np.degrees(np.arctan2(towards[:, 0], towards[:, 1])) - detection.heading_deg
        columns["range"].append(_range_m(detection, place))
        columns["rss"].append(detection.rss_dbm - offset)
        columns["east"].append(detection.position_m[:, 0])
        columns["north"].append(detection.position_m[:, 1])
        columns["up"].append(detection.up_m if detection.up_m.size else np.zeros(len(detection.robots)))
        columns["gain"].append(gain_db(file, bearing))
        columns["t"].append(np.full(len(detection.robots), detection.t_ns * 1e-9))
        cells += [
            " ".join(map(str, cell)) for cell in np.floor(detection.position_m / cell_m).astype(int).tolist()
        ]
    flat = {name: np.concatenate(each) for name, each in columns.items()}
    readings = from_arrays(
        np.maximum(flat["range"], 1e-3),
        flat["rss"],
        np.array(cells),
        name=path.name,
        gain_db=flat["gain"] if file.pattern else None,
        order=flat["t"],
        tx_m=np.tile([place.east_m, place.north_m], (len(cells), 1)),
        rx_m=np.column_stack([flat["east"], flat["north"]]),
        climb_m=flat["up"] - place.up_m if flat["up"].any() else None,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
    )
    far = readings.distance_m >= SPREADS * place.spread_m
    if not far.any():
        raise DataError(
            f"{path}: its place is known to {place.spread_m:.1f} m, and no robot was further than "
            f"{SPREADS * place.spread_m:.1f} m from it: such readings say nothing about distance"
        )
    return readings.keep(far)
