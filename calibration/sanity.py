"""What goes wrong in readings files, found before fitting and said plainly.

Errors stop (a value that cannot be a reading); warnings go on into the verdict (readings that may be copies).
"""

from itertools import pairwise

import numpy as np

from calibration.clocks import Track, estimate_offset
from calibration.dataset import Readings
from calibration.table import Table
from fieldkit.messages import FloatArray

WEAKEST_DBM = -150.0
"""No receiver hears less: LoRa reaches -148 dBm (Semtech SX1276 data sheet)."""
LARGEST_BYTE, MIXED_SHARE = 128.0, 0.05
"""A radio's raw byte is below this; so many rows of each sign are no accident."""
LONG_RUN = 100
"""Equal readings in a row across places: a register that was read again and again."""


def check_levels(table: Table, rss_dbm: FloatArray) -> None:
    """Raise `DataError` at the first value that cannot be a received power in dBm."""
    heard = ~np.isnan(rss_dbm)
    if not heard.any():
        raise table.error(0, "no packet was received in the whole file: there is nothing to fit")
    level = rss_dbm[heard]
    rows = np.flatnonzero(heard)
    positive, negative = (level > 0.0) & (level < LARGEST_BYTE), level < 0.0
    if positive.mean() > MIXED_SHARE and negative.mean() > MIXED_SHARE:
        first = int(np.argmax(positive))
        raise table.error(
            int(rows[first]),
            f"rss_dbm is {level[first]:g}, but negative in {negative.sum()} of {len(level)} rows: dBm and -dBm "
            "are mixed in one file; give all the same sign (a raw byte 50 is -50 dBm)",
        )
    if np.mean(level > 0.0) > 0.5:
        raise table.error(
            int(rows[0]),
            f"rss_dbm is {level[0]:g}: positive, as a radio's raw byte is; use --negate if it is -dBm",
        )
    for wrong, why in (
        (
            level == 0.0,
            "zero means 'no value yet' on most radios; delete the row, or leave rss_dbm empty if missed",
        ),
        (
            level > 0.0,
            "positive dBm among negative ones marks 'no value' or another unit; delete or correct it",
        ),
        (
            level < WEAKEST_DBM,
            "weaker than any receiver hears: a mark for 'no value'; leave it empty if missed",
        ),
    ):
        if wrong.any():
            first = int(np.argmax(wrong))
            raise table.error(
                int(rows[first]), f"rss_dbm is {level[first]:g} ({wrong.sum()} such rows): {why}"
            )


def check_rows(table: Table, readings: Readings) -> tuple[Readings, list[str]]:
    """Readings without rows given twice, and warnings in words."""
    warnings: list[str] = []
    if "sample" in table.columns or "time" in table.columns:
        # Only where something numbers the packets can two equal rows be distinguished from two equal readings.
        keys = list(zip(*table.others.values(), strict=True))
        first: dict[tuple[str, ...], int] = {}
        twice = np.array([first.setdefault(key, i) != i for i, key in enumerate(keys)], dtype=bool)
        if twice.any():
            line = table.lines[int(np.argmax(twice))]
            warnings.append(f"{twice.sum()} rows are given twice (first in line {line}) and were used once")
            readings = readings.keep(~twice)
    warnings += _copied_places(readings)
    run, start = _longest_run(readings)
    if run > LONG_RUN:
        warnings.append(
            f"{run} equal readings in a row from line {table.lines[start]} on, across places: was "
            "the radio's "
            "last value read again while nothing arrived?"
        )
    warnings += _clock(table)
    return readings, warnings


def check_clocks(table: Table, readings: Readings) -> list[str]:
    """Whether levels follow the positions of another moment than their own: two clocks in one file."""
    if "time" not in table.columns or readings.rx_m is None or readings.tx_m is None:
        return []
    if readings.order is None or np.ptp(readings.tx_m, axis=0).max() > 0.0:
        return []
    who = np.zeros(len(readings.order), dtype=np.int64) if readings.receiver is None else readings.receiver
    tracks = {int(k): Track(readings.order[who == k], readings.rx_m[who == k]) for k in np.unique(who)}
    found = estimate_offset(readings.order, readings.rss_dbm, who, tracks, readings.tx_m[0])
    return [] if found is None else [found.warning()]


def _copied_places(readings: Readings) -> list[str]:
    """Places with exactly the same readings in the same order: a file saved under two names."""
    order = np.argsort(readings.place, kind="stable")
    bounds = np.flatnonzero(np.diff(readings.place[order])) + 1
    seen: dict[bytes, str] = {}
    found = []
    for rows in np.split(order, bounds):
        if (~np.isnan(readings.rss_dbm[rows])).sum() < 10:
            continue
        name = readings.places[int(readings.place[rows[0]])]
        other = seen.setdefault(readings.rss_dbm[rows].tobytes(), name)
        if other != name:
            found.append(f"places {other} and {name} carry the same {len(rows)} readings in the same order")
    return found[:3]


def _longest_run(readings: Readings) -> tuple[int, int]:
    """Length and first row of the longest run of equal readings that spans at least two places."""
    heard = np.flatnonzero(~readings.missed)
    level = readings.rss_dbm[heard]
    starts = np.concatenate([[0], np.flatnonzero(np.diff(level)) + 1, [len(level)]])
    best, at = 0, 0
    for a, b in pairwise(starts.tolist()):
        if b - a > best and readings.place[heard[a]] != readings.place[heard[b - 1]]:
            best, at = int(b - a), int(heard[a])
    return best, at


def _clock(table: Table) -> list[str]:
    """Times that run backwards for one receiver."""
    if "time" not in table.columns:
        return []
    from calibration.dataset import seconds

    last: dict[str, float] = {}
    names = table.columns.get("receiver", [""] * len(table))
    back, first = 0, 0
    for row, (name, text) in enumerate(zip(names, table.columns["time"], strict=True)):
        try:
            now = seconds(text)
        except ValueError:
            return []
        if now < last.get(name, now):
            back += 1
            first = first or table.lines[row]
        last[name] = now
    return [f"time runs backwards {back} times, first in line {first}: a clock was set"] if back else []
