"""Readings whose positions are in another log: looked up by time, once the two clocks are known to agree."""

from dataclasses import replace

import numpy as np

from calibration.clocks import Track, estimate_offset
from calibration.dataset import seconds
from calibration.table import Table, as_csv
from fieldkit.errors import DataError
from fieldkit.messages import FloatArray

_PAIRS = (("rx_east_m", "rx_north_m"), ("rx_lat_deg", "rx_lon_deg"))
_METRES_PER_DEG = 111_200.0
HALF_HOURS = np.arange(-28, 29) * 1800.0
"""What time zones differ by."""
LARGEST_GAP_S = 5.0


def csv_joined(
    table: Table, track: Table, source: tuple[float, float], clock_offset_s: float | None = None
) -> tuple[str, list[str]]:
    """A readings CSV with positions from `track` (time, east_m and north_m or lat_deg and lon_deg), and notes.

    `source` is the transmitter, east and north in metres, or latitude and longitude where the track has these.
    `clock_offset_s` is added to the readings' times. Readings farther than 5 s from any position are left out.
    Raises `DataError` where times cannot be matched.
    """
    pair = next((pair for pair in _PAIRS if all(name in track.columns for name in pair)), None)
    if pair is None or "time" not in track.columns or not len(track):
        raise DataError(
            f"{track.path}: a position log needs rows with time, and rx_east_m and rx_north_m or rx_lat_deg and "
            f"rx_lon_deg; there are {', '.join(track.others)}"
        )
    if "time" not in table.columns:
        raise DataError(f"{table.path}: has no time to look positions up by; name it: --column time=NAME")
    t_s = _times(table) + (clock_offset_s or 0.0)
    line = Track(_increasing(track), np.column_stack([track.numbers(name) for name in pair]))
    _overlap(table, t_s, track, line.t_s)
    rss = table.numbers("rss_dbm", empty=float("nan"))
    notes = [] if clock_offset_s is not None else _offset_notes(t_s, rss, line, source, pair)
    near = np.abs(line.t_s[_nearest(line.t_s, t_s)] - t_s) <= LARGEST_GAP_S
    if not near.any():
        raise DataError(
            f"{track.path}: has no position within {LARGEST_GAP_S:g} s of any reading in {table.path}"
        )
    if not near.all():
        notes.append(
            f"{(~near).sum()} readings are more than {LARGEST_GAP_S:g} s from any position: left out"
        )
    places = line.at(t_s)
    ends = [name.replace("rx", "tx") for name in pair]
    kept = [name for name in table.columns if name not in (*pair, *ends, "distance_m")]
    rows = [
        (
            *(table.columns[name][i] for name in kept),
            f"{places[i, 0]:.8f}",
            f"{places[i, 1]:.8f}",
            *map(repr, source),
        )
        for i in np.flatnonzero(near)
    ]
    return as_csv([*kept, *pair, *ends], rows), notes


def _times(table: Table) -> FloatArray:
    values = np.empty(len(table))
    for row, text in enumerate(table.columns["time"]):
        try:
            values[row] = seconds(text)
        except ValueError:
            raise table.error(row, f"time is {text!r}: give seconds, nanoseconds or hh:mm:ss") from None
    return values * 1e-9 if np.max(np.abs(values)) > 1e15 else values


def _increasing(track: Table) -> FloatArray:
    t_s = _times(track)
    back = np.flatnonzero(np.diff(t_s) < 0.0)
    if len(back):
        raise track.error(
            int(back[0]) + 1, "time runs backwards: a clock was set; cut the file here and import both parts"
        )
    return t_s


def _overlap(table: Table, t_s: FloatArray, track: Table, track_s: FloatArray) -> None:
    """Raise where the logs are of different times, naming a time zone that would explain it."""

    def share(offset_s: float) -> float:
        return float(np.mean((t_s + offset_s >= track_s[0]) & (t_s + offset_s <= track_s[-1])))

    if share(0.0) > 0.1:
        return
    shares = [share(offset) for offset in HALF_HOURS]
    hint = "were they logged at the same time, by clocks that were set?"
    if max(shares) > 0.5:
        zone = float(HALF_HOURS[int(np.argmax(shares))])
        hint = f"they would with {zone / 3600.0:+g} h, as of another time zone: --clock-offset-s {zone:g}"
    raise DataError(
        f"{table.path}: its times ({t_s.min():.0f} to {t_s.max():.0f} s) are not those of {track.path} "
        f"({track_s[0]:.0f} to {track_s[-1]:.0f} s); {hint}"
    )


def _offset_notes(
    t_s: FloatArray, rss: FloatArray, line: Track, source: tuple[float, float], pair: tuple[str, str]
) -> list[str]:
    place, origin = line.place_m, np.array(source)
    if pair[0] == "rx_lat_deg":
        scale = _METRES_PER_DEG * np.array([1.0, np.cos(np.radians(origin[0]))])
        place, origin = (place - origin) * scale, np.zeros(2)
    nobody = np.zeros(len(t_s), dtype=np.int64)
    found = estimate_offset(t_s, rss, nobody, {0: replace(line, place_m=place)}, origin)
    return [] if found is None else [found.warning()]


def _nearest(sorted_s: FloatArray, t_s: FloatArray) -> np.ndarray:
    right = np.clip(np.searchsorted(sorted_s, t_s), 1, max(1, len(sorted_s) - 1))
    if len(sorted_s) == 1:
        return np.zeros(len(t_s), dtype=np.int64)
    left = right - 1
    return np.where(np.abs(sorted_s[left] - t_s) <= np.abs(sorted_s[right] - t_s), left, right)
