"""What every robot has observed, as append-only numbered logs of which all robots hold copies. Pure.

Only the robot itself appends to its logs; the others take in parts of them, from whoever has them, in any order and as
often as they come. A robot has three logs, of falling urgency: orders and states, what was heard, where it was. Each is
closed up to a tick of the common clock: no entry before that will be added any more. The checkpoint is the last tick up
to which everybody's logs are closed and known (DPRWA section IV.B, eq 5).

Observations are ordered by the time at which they entered their log, then by robot, log and number. What comes late
therefore stands late in the log, as it would in the inbox of a single computer, and no log is ever reopened.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache

from fieldkit.engine.decentralised.entries import (
    STEP_NS,
    Entry,
    Key,
    Observation,
    Part,
    Stream,
    stream_of,
)
from fieldkit.engine.decentralised.log import Log
from fieldkit.settings import TICK_S

__all__ = [
    "NEVER",
    "STEP_NS",
    "TICK_NS",
    "Entry",
    "Key",
    "Log",
    "Logs",
    "Observation",
    "Part",
    "Stream",
    "stream_of",
]

TICK_NS = round(TICK_S * 1e9)
NEVER = -1
"""The tick up to which a log is closed of which nothing is known."""
MOST_PENDING = 256
"""Parts kept until what lies before them has come."""


@cache
def _keys(robots: tuple[str, ...]) -> tuple[Key, ...]:
    # Asked for at every message of every robot; an enumeration is slow to go through.
    return tuple((robot, stream) for robot in robots for stream in Stream)


@dataclass
class Logs:
    """All logs of a team as one member knows them."""

    me: str
    """Its robot; empty: a computer without one, which adds to no log."""
    robots: tuple[str, ...]
    entries: dict[Key, Log] = field(init=False)
    closed: dict[Key, int] = field(init=False)
    """Log to the tick up to which it is known to be whole."""
    left_out: int = 0
    """Parts that contradict what is known of their log."""
    has_begun: bool = False
    """Whether anything of our own has been added since the start: until then others may bring us our own logs."""
    _last_ns: int = field(init=False, default=0)
    _pending: dict[Key, dict[int, Part]] = field(init=False)

    def __post_init__(self) -> None:
        if self.me and self.me not in self.robots:
            raise ValueError(f"robot {self.me!r} is not one of {', '.join(self.robots)}")
        keys = self.keys(self.robots)
        self.entries = {key: Log(*key) for key in keys}
        self.closed = dict.fromkeys(keys, NEVER)
        self._pending = {key: {} for key in keys}

    @staticmethod
    def keys(robots: Iterable[str]) -> tuple[Key, ...]:
        """The logs of these robots, in a fixed order."""
        return _keys(tuple(robots))

    @property
    def own(self) -> tuple[Key, ...]:
        """One's own logs, the most urgent first."""
        return self.keys((self.me,)) if self.me in self.robots else ()

    # -- one's own -----------------------------------------------------------------------------------------

    def append(self, event: Observation, now_ns: int) -> Entry:
        """Add an observation of one's own. It must be as `packing.quantised` gives it, so that all have the same."""
        key = (self.me, stream_of(event))
        earliest_ns = self.closed[key] * TICK_NS + STEP_NS
        wanted_ns = min(event.t_ns, now_ns) // STEP_NS * STEP_NS
        entry = Entry(max(wanted_ns, earliest_ns, self._last_ns), event)
        self._last_ns, self.has_begun = entry.order_ns, True
        self.entries[key].append(entry)
        return entry

    def close(self, now_ns: int) -> None:
        """Say that one's own logs are whole up to the last tick before `now_ns`. A clock set back changes nothing."""
        tick = now_ns // TICK_NS
        for key in self.own:
            self.closed[key] = max(self.closed[key], tick)

    # -- others' -------------------------------------------------------------------------------------------

    def take(self, part: Part) -> tuple[Entry, ...]:
        """Take in a part; the entries that are new by it, with those that had waited for it.

        A part of an unknown robot, or one that adds to a time already closed, is left out and counted. Of our own
        logs parts are taken only before anything is added: what was written before a restart.
        """
        log = self.entries.get(part.key)
        if log is None:
            self.left_out += 1
            return ()
        if part.robot == self.me and self.has_begun:
            return ()
        before = len(log)
        if part.first > before:
            waiting = self._pending[part.key]
            if len(waiting) < MOST_PENDING or part.first in waiting:
                waiting[part.first] = part
            return ()
        self._extend(log, part)
        waiting = self._pending[part.key]
        while (ready := min(waiting, default=len(log) + 1)) <= len(log):
            self._extend(log, waiting.pop(ready))
        return tuple(log[before:])

    def _extend(self, log: Log, part: Part) -> None:
        new = part.entries[len(log) - part.first :]
        least_ns = max(self.closed[part.key] * TICK_NS + STEP_NS, log[-1].order_ns if log else 0)
        for entry in new:
            if entry.order_ns < least_ns:
                self.left_out += 1
                return
            least_ns = entry.order_ns
        log.extend(new)
        if part.robot == self.me:
            self._last_ns = max(self._last_ns, least_ns)

    def learn(self, key: Key, count: int, closed: int) -> None:
        """Somebody knows that this log has `count` entries up to tick `closed`: true for us once we have those."""
        if (
            key in self.closed
            and (key[0] != self.me or not self.has_begun)
            and len(self.entries[key]) >= count
        ):
            self.closed[key] = max(self.closed[key], closed)

    # -- what is known -------------------------------------------------------------------------------------

    def closed_of(self, robot: str) -> int:
        """The tick up to which everything of one robot is known."""
        return min([self.closed[key] for key in _keys((robot,))])

    def checkpoint(self, robots: Iterable[str] | None = None) -> int:
        """The tick up to which everything of all these robots is known; None: of everybody."""
        return min(self.closed_of(robot) for robot in (self.robots if robots is None else robots))

    def counts(self) -> dict[Key, int]:
        """How many entries of each log are known."""
        return {key: len(log) for key, log in self.entries.items()}

    def until(self, fed: Mapping[Key, int], tick: int) -> list[tuple[Key, Entry]]:
        """What is known after the first `fed` entries of each log and up to a tick, in the order that all keep."""
        end_ns = tick * TICK_NS
        found = []
        for key, log in self.entries.items():
            first = fed.get(key, 0)
            for number, entry in enumerate(log.up_to(end_ns, first), first):
                found.append((entry.order_ns, key, number, entry))
        found.sort(key=lambda each: each[:3])
        return [(key, entry) for _, key, _, entry in found]
