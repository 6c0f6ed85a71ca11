"""gpsd's JSON reports to fixes, written from gpsd_json(5): a TPV has mode, lat, lon, altMSL, epx, epy, track, speed."""

import json
import math
from datetime import datetime
from typing import Any

from drivers.gnss.fixes import Fix

WATCH = b'?WATCH={"enable":true,"json":true};\n'
GPSD_PORT = 2947
TWO_SIGMA = 1.96
"""gpsd gives epx and epy for 95 % of the time."""
LONGEST_REPORT = 65_536


class GpsdReader:
    """Bytes in, fixes out; of one receiver where `receiver` names its device, else of whichever reports."""

    def __init__(self, receiver: str = "") -> None:
        self.damaged = 0
        self.sentences = 0
        self._receiver = receiver
        self._rest = b""

    def feed(self, data: bytes, at_s: float) -> list[Fix]:
        """What complete reports say."""
        *whole, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-LONGEST_REPORT:]
        fixes = []
        for line in filter(None, map(bytes.strip, whole)):
            try:
                report = json.loads(line)
                if not isinstance(report, dict):
                    raise ValueError("not an object")
            except (ValueError, RecursionError):
                self.damaged += 1
                continue
            self.sentences += 1
            if report.get("class") == "TPV" and self._receiver in ("", report.get("device", "")):
                fixes.append(_fix(report))
        return fixes


def _fix(report: dict[str, Any]) -> Fix:
    lat, lon = _number(report, "lat"), _number(report, "lon")
    mode = report.get("mode")
    why = "no fix yet" if mode not in (2, 3) or lat is None or lon is None else ""
    if report.get("status") in (6, 8):  # dead reckoning, simulated
        why = "its position is no measurement"
    errors = [_number(report, "epx"), _number(report, "epy")]
    known = [each / TWO_SIGMA for each in errors if each is not None and each > 0.0]
    eph = _number(report, "eph")
    sigma = max(known) if known else None if eph is None or eph <= 0.0 else eph / math.sqrt(2.0)
    alt = _number(report, "altMSL")
    return Fix(
        lat if lat is not None else float("nan"),
        lon if lon is not None else float("nan"),
        sigma,
        _utc_s(report.get("time")),
        (_number(report, "alt") if alt is None else alt) if mode == 3 else None,
        _number(report, "speed"),
        _number(report, "track"),
        why,
    )


def _number(report: dict[str, Any], key: str) -> float | None:
    value = report.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # JSON knows whole numbers of any length
        return None
    return number if math.isfinite(number) else None


def _utc_s(text: object) -> float | None:
    try:
        return datetime.fromisoformat(str(text).replace("Z", "+00:00")).timestamp()
    except ValueError:
        return None
