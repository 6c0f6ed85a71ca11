"""What a member knows of another by its messages. Pure."""

from collections import deque
from dataclasses import dataclass, field

from fieldkit.engine.decentralised.entries import Key
from fieldkit.engine.decentralised.ways import NO_WAY, Way
from fieldkit.settings import TICK_S

HEARS_S = 3.0
"""A member that was heard no longer ago than this is in range."""
ROUND_TRIP_S = 1.0
AGAIN_TRIPS = 0.5
"""What does not arrive is sent again after so many round trips: less than one, since the second try may be lost too."""
GIVE_BACK_S = 6.0
"""A robot that lacks its own log for so long gets what it lacks from a watcher. Longer than between two cards: one that
has begun a new mission is known by then (`mission.shell.watching`), and must not get the logs of the last."""
LAGS = 6
"""Tables by which a clock is measured."""


@dataclass
class Peer:
    """What a member knows of another by its messages."""

    heard_ns: int
    """When it was last heard, by our clock."""
    counts: dict[Key, int] = field(default_factory=dict)
    """How many entries it has of each log, as it last said."""
    hears: tuple[str, ...] = ()
    """Whom it hears."""
    said_ns: int = 0
    """When it said the last of what follows, by its clock: messages overtake each other."""
    way: Way | None = None
    """Where it may be."""
    knows: int = NO_WAY
    """The number of the last way of ours that it knows."""
    obeyed: int = -1
    """The code of the last order that it has obeyed; -1: none, or its vehicle does not show it."""
    lags_s: deque[float] = field(default_factory=lambda: deque(maxlen=LAGS))
    """Of its last tables: when they came by our clock, less when they left by its own."""
    told_lag_s: float | None = None
    """The least such lag of ours at it, as it last said."""
    round_trips_s: deque[float] = field(default_factory=lambda: deque([ROUND_TRIP_S], maxlen=8))
    sent: dict[Key, int] = field(default_factory=dict)
    """Up to which entry each log was sent again to it."""
    lacks_own_ns: int | None = None
    """Since when it lacks entries of its own logs that are known here; None: it has all."""
    has_more_ns: int | None = None
    """Since when, heard all the time, it has more of our own logs than we; None: it has not."""
    moved_ns: dict[Key, int] = field(default_factory=dict)
    """When it last had more of a log, or was begun to be sent it again."""

    @property
    def round_trip_s(self) -> float:
        return min(self.round_trips_s)

    @property
    def lag_s(self) -> float | None:
        """The least of its lags: delay, less what its clock is ahead of ours."""
        return min(self.lags_s, default=None)

    def said(self, key: Key, count: int, now_ns: int) -> None:
        """It has so many entries of a log."""
        if count > self.counts.get(key, 0):
            self.moved_ns[key] = now_ns
        self.counts[key] = count

    def next_of(self, key: Key, now_ns: int) -> int:
        """The entry to go on with: where sending has come to, or anew from what it has where that does not move."""
        count, waited_s = self.counts.get(key, 0), (now_ns - self.moved_ns.get(key, 0)) * 1e-9
        if waited_s > AGAIN_TRIPS * self.round_trip_s + 2.0 * TICK_S:
            self.moved_ns[key], self.sent[key] = now_ns, count
        return max(count, self.sent.get(key, 0))

    def hears_from(self, now_ns: int) -> None:
        """It is heard."""
        if not self.is_heard(now_ns):
            self.has_more_ns = None
        self.heard_ns = now_ns

    def may_have_begun_anew(self, now_ns: int) -> bool:
        """Whether nobody can tell yet if it has lost its own log or is of the next mission, which gets nobody's."""
        if self.said_ns == 0:
            return True
        return self.lacks_own_ns is not None and (now_ns - self.lacks_own_ns) * 1e-9 < GIVE_BACK_S

    def is_heard(self, now_ns: int) -> bool:
        """Whether it is in range."""
        return (now_ns - self.heard_ns) * 1e-9 <= HEARS_S
