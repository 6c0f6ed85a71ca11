"""NMEA 0183 sentences to fixes, through pynmeagps: GGA makes a fix; RMC, VTG and GST say more of it."""

from dataclasses import replace
from datetime import UTC, datetime, time, timedelta
from typing import Any

import pynmeagps

from drivers.gnss.fixes import UERE_M, Fix

KNOT_M_S = 1852.0 / 3600.0
NO_GGA_S = 5.0
NO_GGA_RMC = 3
"""A receiver without GGA for so long, and in so many RMC, sends none: after a pause RMC may just come first."""
FRESH_S = 2.0
"""Speed, course and errors that came longer before a fix say nothing of it."""
LONGEST_SENTENCE = 120
"""NMEA 0183 allows 82 characters; receivers with extra digits send some more."""


class NmeaReader:
    """Bytes in, fixes out; damaged sentences are counted in `damaged` and passed over."""

    def __init__(self) -> None:
        self.damaged = 0
        self.sentences = 0
        self._rest = b""
        self._motion: tuple[float, float | None, float | None] = (-FRESH_S, None, None)
        """When it came, speed, course."""
        self._sigma: tuple[float, float | None] = (-FRESH_S, None)
        self._date = ""
        self._void = False
        """RMC's word that the position is not valid."""
        self._gga_s: float | None = None
        """When the last GGA came, or the first sentence of all."""
        self._rmc_alone = 0
        """RMC since the last GGA."""

    def feed(self, data: bytes, at_s: float) -> list[Fix]:
        """What complete sentences say. `at_s` is when they came, by any steady clock."""
        *whole, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        self._rest = rest[-4 * LONGEST_SENTENCE :]
        fixes = []
        for line in whole:
            begin = line.find(b"$")
            if begin < 0 or len(line) - begin > LONGEST_SENTENCE:
                continue
            sentence = self._parse(line[begin:])
            try:
                fix = None if sentence is None else self._take(sentence, at_s)
            except AttributeError:  # shorter than its kind, by a checksum that fits all the same
                self.damaged += 1
                continue
            if fix is not None:
                fixes.append(fix)
        return fixes

    def _parse(self, line: bytes) -> Any:
        if b"*" not in line:  # without a checksum anything may be in it
            self.damaged += 1
            return None
        try:
            sentence = pynmeagps.NMEAReader.parse(line + b"\r\n", validate=pynmeagps.VALCKSUM)
        except Exception:  # pynmeagps raises more kinds than it names on damaged sentences
            self.damaged += 1
            return None
        self.sentences += 1
        return sentence

    def _take(self, sentence: Any, at_s: float) -> Fix | None:
        kind = getattr(sentence, "msgID", "")
        if self._gga_s is None:
            self._gga_s = at_s
        if kind == "RMC":
            self._void = sentence.status != "A"
            self._date = str(sentence.date or "")
            speed = _number(sentence.spd)
            self._motion = (at_s, None if speed is None else speed * KNOT_M_S, _number(sentence.cog))
            # A receiver that sends no GGA gives its place here, and nothing of its quality.
            self._rmc_alone += 1
            alone = at_s - self._gga_s > NO_GGA_S and self._rmc_alone >= NO_GGA_RMC
            return self._fix(sentence, at_s) if alone else None
        if kind == "VTG":
            speed = _number(sentence.sogk)
            self._motion = (at_s, None if speed is None else speed / 3.6, _number(sentence.cogt))
        elif kind == "GST":
            errors = [_number(sentence.stdLat), _number(sentence.stdLong)]
            known = [each for each in errors if each is not None and each > 0.0]
            self._sigma = (at_s, max(known) if known else None)
        elif kind == "GGA":
            self._gga_s, self._rmc_alone = at_s, 0
            return self._from_gga(sentence, at_s)
        return None

    def _from_gga(self, sentence: Any, at_s: float) -> Fix:
        quality, hdop = int(_number(sentence.quality) or 0), _number(sentence.HDOP)
        fix = self._fix(sentence, at_s)
        if quality not in UERE_M:
            words = {0: "no fix yet", 6: "its position is dead reckoning", 7: "its position was typed in"}
            return replace(fix, why_absent=words.get(quality, "its position is simulated"))
        if self._void:
            return replace(fix, why_absent="it says that its position is not valid (RMC)")
        came_s, sigma = self._sigma
        if sigma is None or at_s - came_s > FRESH_S:
            sigma = None if hdop is None or not 0.0 < hdop < 99.0 else hdop * UERE_M[quality]
        return replace(fix, sigma_m=sigma, alt_m=_number(sentence.alt))

    def _fix(self, sentence: Any, at_s: float) -> Fix:
        came_s, speed, course = self._motion
        if at_s - came_s > FRESH_S:
            speed = course = None
        lat, lon = _number(sentence.lat), _number(sentence.lon)
        why = "no fix yet" if lat is None or lon is None else ""
        moment = self._utc_s(sentence.time)
        return Fix(
            lat if lat is not None else float("nan"),
            lon if lon is not None else float("nan"),
            None,
            moment,
            None,
            speed,
            course,
            why,
        )

    def _utc_s(self, of_day: object) -> float | None:
        """Seconds since 1970; of some day, where the receiver gives no date: only differences are used."""
        if not isinstance(of_day, time):
            return None
        try:
            day = datetime.fromisoformat(self._date) if self._date else datetime(2000, 1, 1)
        except ValueError:
            day = datetime(2000, 1, 1)
        since = timedelta(
            hours=of_day.hour, minutes=of_day.minute, seconds=of_day.second, microseconds=of_day.microsecond
        )
        return (day.replace(tzinfo=UTC) + since).timestamp()


def _number(value: object) -> float | None:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
