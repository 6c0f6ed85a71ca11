"""A collection of readings as it grows: what was heard at each place, what is still missing for a good fit.

Pure: the questions and the radio are collect.py's business. Written after every place, so an interruption
costs one place at most, and read back to go on.
"""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.table import read_table
from calibration.verdict import FEW_PLACES, MIN_SPAN_DECADES
from fieldkit.errors import DataError
from fieldkit.messages import RssReading

HEADER = ("place", "distance_m", "heading_deg", "receiver", "sample", "time", "rss_dbm")
GOOD_PLACES, GOOD_SPAN_DECADES = 20, 1.2
PARTLY = (0.1, 0.9)
"""Share of packets heard at a place that determines the threshold: neither all nor none."""
MAX_DRIFT_SLOTS = 64
"""A sequence number farther from what the time says was restarted: the time is taken."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet that was sent: `rss_dbm` None where it was not received."""

    t_s: float
    rss_dbm: float | None


@dataclass(frozen=True, slots=True)
class Place:
    """Packets at one place, the antenna turned one way: turned another way it is an entry of the same name."""

    name: str
    distance_m: float
    heading_deg: float | None
    receiver: str
    packets: tuple[Packet, ...]

    @property
    def levels_dbm(self) -> list[float]:
        return [p.rss_dbm for p in self.packets if p.rss_dbm is not None]

    def summary(self) -> str:
        """One line for the person in the field."""
        heard = self.levels_dbm
        turned = "" if self.heading_deg is None else f", {self.heading_deg:.0f} deg"
        counted = f"{self.name} ({self.distance_m:.2f} m{turned}): {len(heard)} of {len(self.packets)} heard"
        if not heard:
            return counted
        return f"{counted}, mean {np.mean(heard):.1f} dBm, spread {np.std(heard):.1f} dB"


def packets_from(
    readings: Sequence[RssReading], start_ns: int, period_s: float, expected: int
) -> tuple[Packet, ...]:
    """Readings sorted into the beacon's periods; a period in which nothing came is a missed packet.

    Where frames carry an 802.15.4 sequence number it counts the packets, so that a beacon that is early or
    late is no loss; else time does, its phase taken from the first reading. Repeats of a packet are dropped.
    """
    ordered = sorted(readings, key=lambda r: r.t_ns)
    phase_ns = ordered[0].t_ns if ordered else start_ns
    numbers = [sequence_number(reading) for reading in ordered]
    by_slot: dict[int, float] = {}
    for reading, number in zip(ordered, numbers, strict=True):
        slot = round((reading.t_ns - phase_ns) * 1e-9 / period_s)
        if number is not None and numbers[0] is not None and len(set(numbers)) > 1:
            # The period whose number, modulo 256, is this one and whose time is nearest.
            behind = (number - numbers[0] - slot + 128) % 256 - 128
            slot += behind if abs(behind) <= MAX_DRIFT_SLOTS else 0
        by_slot.setdefault(slot, reading.rss_dbm)
    before = int((phase_ns - start_ns) * 1e-9 / period_s)
    end = max(expected - before, max(by_slot, default=0) + 1)
    # A packet at the very end makes up for one at the very beginning, which nobody was listening for.
    slots = range(max(-before, min(0, end - expected)), end)
    return tuple(Packet(round(phase_ns * 1e-9 + slot * period_s, 3), by_slot.get(slot)) for slot in slots)


def sequence_number(reading: RssReading) -> int | None:
    """The last part of a frame's id, `PAN:address/sequence number in hex`; None where it has none."""
    found = re.fullmatch(r".*/([0-9a-f]{2})", reading.frame_id or "")
    return int(found.group(1), 16) if found else None


def still_missing(places: Sequence[Place]) -> list[str]:
    """What a good fit still needs, most needed first; empty when it can be fitted."""
    heard = [place for place in places if place.levels_dbm]
    wishes = []
    spots = len({place.name for place in places})
    if spots < GOOD_PLACES:
        least = f", at least {FEW_PLACES - spots}" if spots < FEW_PLACES else ""
        wishes.append(f"{GOOD_PLACES - spots} more places for narrow intervals{least}")
    distances = [place.distance_m for place in heard]
    span = float(np.log10(max(distances) / min(distances))) if heard else 0.0
    if span < GOOD_SPAN_DECADES:
        need = f"{10**MIN_SPAN_DECADES:.1f} is the least" if span < MIN_SPAN_DECADES else "16 is better"
        wishes.append(f"nearer and farther places: distances differ by a factor of {10**span:.1f}; {need}")
    elif _gap(distances) > 0.5 * span:
        wishes.append("places in between: the distances leave a wide gap")
    shares = [len(place.levels_dbm) / max(1, len(place.packets)) for place in places]
    if sum(PARTLY[0] <= share <= PARTLY[1] for share in shares) < 3:
        wishes.append("three places so far away that a part of the packets is lost: they show the threshold")
    headings = {round(place.heading_deg / 30.0) % 12 for place in places if place.heading_deg is not None}
    if headings and len(headings) < 8:
        wishes.append(f"more headings: {len(headings)} of 12 sectors so far, 8 make a pattern")
    return wishes


def to_csv(places: Sequence[Place]) -> str:
    """All places as a readings file."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    with_heading = bool(places) and all(place.heading_deg is not None for place in places)
    writer.writerow([name for name in HEADER if with_heading or name != "heading_deg"])
    number = 0
    for place in places:
        for packet in place.packets:
            level = "" if packet.rss_dbm is None else f"{packet.rss_dbm:g}"
            row = [place.name, f"{place.distance_m:g}"]
            row += [f"{place.heading_deg:g}"] if with_heading else []
            writer.writerow([*row, place.receiver, number, f"{packet.t_s:.3f}", level])
            number += 1
    return stream.getvalue()


def from_csv(path: Path) -> list[Place]:
    """The places of a file that `to_csv` wrote, to go on with. Raises `DataError` where it is another's."""
    table = read_table(path)
    missing = [name for name in HEADER if name not in table.columns and name != "heading_deg"]
    if missing:
        raise DataError(
            f"{path}: was not written by 'calibrate collect' (no {', '.join(missing)}); name a new file"
        )
    distance, time_s = table.numbers("distance_m"), table.numbers("time")
    levels = table.numbers("rss_dbm", empty=float("nan"))
    heading = table.numbers("heading_deg") if "heading_deg" in table.columns else None
    rows_of: dict[tuple[str, float | None], list[int]] = {}
    for row, name in enumerate(table.columns["place"]):
        rows_of.setdefault((name, None if heading is None else float(heading[row])), []).append(row)
    return [
        Place(
            name,
            float(distance[rows[0]]),
            None if heading is None else float(heading[rows[0]]),
            table.columns["receiver"][rows[0]],
            tuple(Packet(float(time_s[i]), None if np.isnan(levels[i]) else float(levels[i])) for i in rows),
        )
        for (name, _), rows in rows_of.items()
    ]


def _gap(distances: Sequence[float]) -> float:
    """The widest gap between neighbouring distances, in decades."""
    return float(np.diff(np.log10(sorted(distances))).max()) if len(distances) > 1 else 0.0
