"""Which map fits lines that somebody's radio prints, and what a mission file would say."""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.lines.mapping import STRONGEST_DBM, LineMap, NoReadingError
from drivers.lines.maps import MAPS

STRENGTH = re.compile(r"r(x_?)?ssi|rss|dbm|signal|power|level", re.IGNORECASE)
NAMED = re.compile(r"(?i)\b(?P<word>rssi|rss|signal|power|level)\b\W{0,4}?(?P<value>-?\d+(?:\.\d+)?)")
SOURCE = re.compile(r"(?i)^(source_?id|mac|addr(ess)?|from_?id|from|id|bssid|tag_?id|node)$")


@dataclass(frozen=True, slots=True)
class Proposal:
    """A map and how many of the lines it reads."""

    name: str
    """A ready-made one's; empty for one made from the lines."""
    map: LineMap
    read: int
    of: int

    def keys(self) -> list[str]:
        """What goes behind `driver` and `port` in the mission file, or a line each into a file of its own."""
        if self.name:
            return [f'map = "{self.name}"']
        said = [f'format = "{self.map.format}"']
        if self.map.pattern:
            said.append(f"pattern = '{self.map.pattern}'")
        return said + [
            f"{key} = {json.dumps(getattr(self.map, key), ensure_ascii=False)}"
            for key in ("rss", "source", "unit")
            if getattr(self.map, key)
        ]

    def toml(self) -> str:
        """All of it on one line."""
        return ", ".join(self.keys())


def propose(lines: Sequence[str]) -> Proposal | None:
    """The map that reads most of the lines; None where none reads any. Ready-made ones go first."""
    found = [_tried(name, each, lines) for name, each in MAPS.items() if name != "json"]
    found += [_tried("", each, lines) for each in _from_lines(lines)]
    best = max(found, key=lambda each: each.read, default=None)
    return best if best is not None and best.read else None


def _tried(name: str, line_map: LineMap, lines: Sequence[str]) -> Proposal:
    return Proposal(name, line_map, sum(_reads(line_map, line) for line in lines), len(lines))


def _reads(line_map: LineMap, line: str) -> bool:
    try:
        return line_map.read(line) is not None
    except NoReadingError:
        return False


def _from_lines(lines: Iterable[str]) -> Iterable[LineMap]:
    """Maps made from what the lines themselves call strength."""
    seen: set[tuple[str, str]] = set()
    for line in lines:
        try:
            values: Any = json.loads(line)
        except (ValueError, RecursionError):
            values = None
        if isinstance(values, dict):
            for rss, value in _leaves(values):
                source = next(
                    (path for path, _ in _leaves(values) if SOURCE.match(path.rpartition(".")[2])), ""
                )
                if STRENGTH.search(rss) and ("json", rss) not in seen and _is_number(value):
                    seen.add(("json", rss))
                    yield LineMap("json", rss=rss, source=source, unit=_unit(value))
        elif (found := NAMED.search(line)) and ("regex", found["word"]) not in seen:
            seen.add(("regex", found["word"]))
            pattern = rf"{found['word']}\W{{0,4}}?(?P<rss>-?\d+(?:\.\d+)?)"
            yield LineMap("regex", rss="rss", pattern=pattern, unit=_unit(found["value"]))


def _leaves(values: dict[str, Any], above: str = "") -> Iterable[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _unit(value: Any) -> str:
    return "-dBm" if float(value) > STRONGEST_DBM else "dBm"
