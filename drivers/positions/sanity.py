"""Positions are looked at before they are believed: fixes that are off, receivers that froze, axes exchanged.

What is left out is named with its time; nothing is corrected in silence.
"""

from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np

from drivers.positions.table import NAMED
from drivers.positions.tracks import Spot, Track
from fieldkit.errors import DataError
from fieldkit.messages import FloatArray

WINDOW = 7
"""Fixes whose median says where a robot was."""
OFF_STEPS = 25.0
"""A fix so many usual steps (and `OFF_M`) off its neighbours' median is no fix of this path."""
OFF_M = 30.0
JUMP_STEPS = 60.0
FROZEN_S = 60.0
FROZEN_FIXES = 12
DEGREE_M = 111_195.0


def looked_at(track: Track) -> Track:
    """The track without what cannot be, with a note for each kind. Raises `DataError` where axes are exchanged."""
    if track.geodetic:
        _check_axes(track.spots)
    kept: list[Spot] = []
    notes = list(track.notes)
    for robot in sorted({spot.robot for spot in track.spots}):
        spots = [spot for spot in track.spots if spot.robot == robot]
        spots = _without_repeats(spots, notes)
        spots = _without_outliers(spots, track.geodetic, notes)
        if track.geodetic:
            spots = _without_frozen(spots, notes)
        _note_jumps(spots, track.geodetic, notes)
        kept += spots
    if not kept:
        raise DataError(f"{track.path}: no position can be relied on: {'; '.join(notes)}")
    return replace(track, spots=sorted(kept, key=lambda spot: spot.t_ns), notes=notes)


def _metres(spots: Sequence[Spot], geodetic: bool) -> FloatArray:
    """(n, 2) good enough for comparing neighbours."""
    place = np.array([(spot.first, spot.second) for spot in spots], dtype=float).reshape(-1, 2)
    if not geodetic:
        return place
    result: FloatArray = place * DEGREE_M * np.array([1.0, np.cos(np.radians(np.median(place[:, 0])))])
    return result


def _check_axes(spots: Sequence[Spot]) -> None:
    """Latitudes over 90 degrees were left out as impossible; here the rest is looked at."""
    if not spots:
        raise DataError("no position with a possible latitude: latitude and longitude look exchanged")


def _without_repeats(spots: list[Spot], notes: list[str]) -> list[Spot]:
    """Of several fixes of one moment the first; different ones are reported."""
    kept: list[Spot] = []
    odd = 0
    for spot in spots:
        if kept and spot.t_ns == kept[-1].t_ns:
            odd += (spot.first, spot.second) != (kept[-1].first, kept[-1].second)
            continue
        kept.append(spot)
    if odd:
        notes.append(
            f"positions of {spots[0].robot}: {odd} moments have two different places; the first counts"
        )
    return kept


def _without_outliers(spots: list[Spot], geodetic: bool, notes: list[str]) -> list[Spot]:
    if len(spots) < WINDOW:
        return spots
    place = _metres(spots, geodetic)
    half = WINDOW // 2
    middle = np.array([np.median(place[max(0, k - half) : k + half + 1], axis=0) for k in range(len(spots))])
    off = np.hypot(*(place - middle).T)
    step = np.hypot(*np.diff(place, axis=0).T)
    usual = float(np.median(step[step > 0.0])) if (step > 0.0).any() else 0.0
    wrong = off > max(OFF_M, OFF_STEPS * usual)
    if not wrong.any() or wrong.mean() > 0.2:
        return spots
    _note(notes, f"positions of {spots[0].robot}", [spots[k] for k in np.flatnonzero(wrong)], off[wrong])
    return [spot for spot, bad in zip(spots, wrong.tolist(), strict=True) if not bad]


def _note(notes: list[str], whose: str, spots: list[Spot], off_m: FloatArray) -> None:
    named = ", ".join(f"{when(s.t_ns)} ({m:.0f} m off)" for s, m in zip(spots[:NAMED], off_m, strict=False))
    more = f" and {len(spots) - NAMED} more" if len(spots) > NAMED else ""
    notes.append(
        f"{whose}: {len(spots)} fixes lie far from those before and after and were left out: {named}{more}"
    )


def _without_frozen(spots: list[Spot], notes: list[str]) -> list[Spot]:
    """A receiver of satellites that repeats every digit for a minute has lost them, unless it never moves."""
    place = np.array([(spot.first, spot.second) for spot in spots])
    same = np.r_[False, (np.diff(place, axis=0) == 0.0).all(axis=1)]
    if len(spots) < FROZEN_FIXES or same.all() or np.ptp(place, axis=0).max() == 0.0:
        return spots
    drop = np.zeros(len(spots), dtype=bool)
    begin = 0
    for k in range(1, len(spots) + 1):
        if k < len(spots) and same[k]:
            continue
        long = (spots[k - 1].t_ns - spots[begin].t_ns) * 1e-9 >= FROZEN_S and k - begin >= FROZEN_FIXES
        if long:
            drop[begin + 1 : k] = True
            notes.append(
                f"positions of {spots[0].robot}: the same to the last digit from {when(spots[begin].t_ns)} to "
                f"{when(spots[k - 1].t_ns)}, as of a receiver that froze: readings from then have no place"
            )
        begin = k
    return [spot for spot, bad in zip(spots, drop.tolist(), strict=True) if not bad]


def _note_jumps(spots: list[Spot], geodetic: bool, notes: list[str]) -> None:
    if len(spots) < WINDOW:
        return
    step = np.hypot(*np.diff(_metres(spots, geodetic), axis=0).T)
    seconds = np.diff([spot.t_ns for spot in spots]) * 1e-9
    speed = step / np.maximum(seconds, 1e-3)
    moving = speed[step > 0.0]
    usual = float(np.median(moving)) if moving.size else 0.0
    jump = (speed > JUMP_STEPS * max(usual, 0.05)) & (step > OFF_M)
    if jump.any():
        first = int(np.argmax(jump))
        notes.append(
            f"positions of {spots[0].robot}: jump by {step[first]:.0f} m at {when(spots[first + 1].t_ns)}"
            f"{f' and {int(jump.sum()) - 1} times more' if jump.sum() > 1 else ''}: check the log"
        )


def when(t_ns: int) -> str:
    """A moment as people read it; seconds where the log counts from its own beginning."""
    if abs(t_ns) < 86_400_000_000_000 * 365:
        return f"{t_ns * 1e-9:.1f} s"
    return datetime.fromtimestamp(t_ns * 1e-9, UTC).strftime("%Y-%m-%d %H:%M:%S")
