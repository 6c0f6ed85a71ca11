"""What one member says to the others, and when: what they lack, the most urgent first, within a budget. Pure.

At every tick a member sends what it has of every log (a table of a few bytes a log), its way, which ways of others it
knows, and what is new in its own logs. Whose table shows that it lacks something gets it again: from the author where
it hears that one, else from the first by name that it does hear and that has more. So what robots know travels with
them, and after a long separation the logs fill up at the pace that the budget allows, orders before readings before
poses.

A watcher is a member without a robot, such as the operator's laptop. It has no log, so nobody waits for it; it has a
number out of `WATCHERS`, and may come and go. It gets what it lacks from what robots leave of their budget, and hands
on what it has.
"""

from collections import Counter, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum

from fieldkit.engine.decentralised import packing
from fieldkit.engine.decentralised.logs import NEVER, STEP_NS, TICK_NS, Entry, Key, Logs, Part, Stream
from fieldkit.engine.decentralised.peer import GIVE_BACK_S, LAGS, Peer
from fieldkit.engine.decentralised.sealing import OVERHEAD_BYTES, Opened, Seal
from fieldkit.engine.decentralised.ways import NO_WAY, Way, read_way, write_way
from fieldkit.errors import RecordingError
from fieldkit.messages import Operator
from fieldkit.settings import AGENT_BYTES_S, TICK_S

STATE, PARTS, ORDER = 1, 2, 3
OPERATOR = 255
"""The number of a computer that has no robot and no copies of logs: it gives orders alone."""
WATCHERS = range(128, OPERATOR)
"""Numbers of computers that have no robot and keep copies of all logs. Each draws one."""
CODES = 2**14
"""Orders are acknowledged by their time, in so many numbers: two bytes."""
MESSAGE_BYTES = 1_000
"""What fits into one datagram on any link."""
MOST_OF_A_PART = 16
"""Entries of a part: what is lost of it is sent again whole."""
LONGEST_ROUND_TRIP_S = 20.0
SAID_AGAIN = 6
"""Ticks at which an order is said once more: with a third of all messages lost, one in two thousand is then missed."""
BURST_S = 2.0
"""What was not used of the budget is kept for so long."""
CLOCKS_AGREE_S = 0.1
"""Clocks that are less apart are left as they are: readings of one transmission are joined over more."""
CLOCKS_SETTLE_S = 20.0
"""After a clock was set, others' measures of it are of the old one for so long."""
SLOW_S, SLOW_TIMES = 2.5, 3
"""Where a round trip takes longer, what is lost would be missed for long: what is new is said at so many ticks."""


class Cause(Enum):
    """Why a part is sent."""

    NEW = "new"
    AGAIN = "again"
    SPARE = "spare"
    """For watchers."""


@dataclass(frozen=True, slots=True)
class Said:
    """What came of one message."""

    robot: str
    """Empty: a computer without a robot."""
    new: tuple[Entry, ...] = ()
    """Entries that we did not have."""
    order: Operator | None = None
    """What an operator asks for at another member."""
    ahead: tuple[Entry, ...] = ()
    """Entries that wait for those before them: no part of a log yet, but news of what is now."""


@dataclass
class Talk:
    """One member's part in the conversation. It owns the logs' way over the air, not what is in them."""

    logs: Logs
    seal: Seal
    bytes_s: float = AGENT_BYTES_S.default
    peers: dict[str, Peer] = field(default_factory=dict)
    """Robots."""
    watchers: dict[int, Peer] = field(default_factory=dict)
    sent: Counter[str] = field(default_factory=Counter)
    """Bytes sent, by what they were: "state", "new", "again", "spare", "order", and what the shell adds."""
    heard_bytes: int = 0
    obeyed: int = -1
    """The code of the last order that our robot has obeyed."""
    reaches_vehicle: bool = True
    """Whether the link to our vehicle stands: else nobody is told that it obeys."""
    is_to_hold: bool = False
    """Whether the last order that was obeyed is a hold ..."""
    shows_hold: bool = True
    """... and whether our vehicle has shown that it holds: else nobody is told so."""
    refused: int = 0
    """Messages of members that could not be read."""
    lost: bool = False
    """Whether somebody has more of our own logs than we: ours must not go on."""
    _told: dict[Key, int] = field(default_factory=dict)
    """How many entries of our own logs have been sent for the first time."""
    _told_before: deque[dict[Key, int]] = field(default_factory=lambda: deque(maxlen=SLOW_TIMES))
    """The same before each of the last ticks."""
    _left: float = 0.0
    _clock_set_ns: int = 0
    """Until then others' measures of our clock are of the one before it was set."""
    _orders: list[tuple[int, Operator]] = field(default_factory=list)

    # -- in ------------------------------------------------------------------------------------------------

    def take(self, data: bytes, now_ns: int) -> Said | None:
        """Take in one message; None where it is none of a member's, or one that was heard before."""
        self.heard_bytes += len(data)
        opened = self.seal.read(data, now_ns)
        if opened is None:
            return None
        robots = self.logs.robots
        if opened.sender < len(robots):
            name = robots[opened.sender]
            peer = self.peers.setdefault(name, Peer(now_ns))
        elif opened.sender in WATCHERS:
            name, peer = "", self.watchers.setdefault(opened.sender, Peer(now_ns))
        else:
            return self._from_operator(opened)
        peer.hears_from(now_ns)
        if opened.kind == STATE:
            peer.lags_s.append((now_ns - opened.sent_ns) * 1e-9)
        reader = packing.Reader(opened.body)
        try:
            tick = reader.uint()
            if opened.kind == ORDER:
                return Said(name, order=_read_order(reader))
            table = self._read_state(peer, reader, tick, opened.sent_ns) if opened.kind == STATE else {}
            new, ahead = self._read_parts(reader, tick)
            self._learn(peer, table, now_ns)
            if table:
                self.lost = self.lost or self._shows_loss(peer, table, now_ns, is_robot=bool(name))
            if name and table:
                self._mind_own(name, peer, table, now_ns)
            return Said(name, new, ahead=ahead)
        except RecordingError:
            self.refused += 1
            return None

    def _from_operator(self, opened: Opened) -> Said | None:
        reader = packing.Reader(opened.body)
        try:
            if opened.sender == OPERATOR and opened.kind == ORDER and reader.uint():
                return Said("", order=_read_order(reader))
        except RecordingError:
            pass
        self.refused += 1
        return None

    def _read_state(
        self, peer: Peer, reader: packing.Reader, tick: int, sent_ns: int
    ) -> dict[Key, tuple[int, int]]:
        """What it has of each log, and up to which tick that is whole."""
        robots = self.logs.robots
        bits = reader.uint()
        hears = tuple(robot for number, robot in enumerate(robots) if bits >> number & 1)
        way = read_way(reader, tick)
        known = {robot: NO_WAY if (age := reader.uint()) == 0 else tick - age + 1 for robot in robots}
        lags_s = dict(zip(robots, (_read_lag(reader) for _ in robots), strict=True))
        obeyed = reader.uint() - 1
        watchers = {reader.uint(): _read_lag(reader) for _ in range(reader.uint())}
        if sent_ns > peer.said_ns:
            peer.said_ns, peer.hears, peer.way, peer.obeyed = sent_ns, hears, way, obeyed
            peer.knows = known.get(self.logs.me, NO_WAY)
            peer.told_lag_s = lags_s.get(self.logs.me, watchers.get(self.seal.me))
        return {key: (reader.uint(), tick - reader.sint()) for key in self.logs.keys(robots)}

    def _learn(self, peer: Peer, table: dict[Key, tuple[int, int]], now_ns: int) -> None:
        """Remember what a peer has; after its parts have been taken in, so that what is whole by them counts."""
        logs = self.logs
        for key, (count, closed) in table.items():
            peer.said(key, count, now_ns)
            logs.learn(key, count, closed)
        own = table.get((logs.me, Stream.ORDERS))
        if own is not None and own[1] > NEVER:
            peer.round_trips_s.append(min(now_ns / 1e9 - own[1] * TICK_S, LONGEST_ROUND_TRIP_S))

    def _shows_loss(
        self, peer: Peer, table: dict[Key, tuple[int, int]], now_ns: int, *, is_robot: bool
    ) -> bool:
        """Whether a peer has more of our own logs than we, which go on already.

        A watcher may be one of the mission before: when it hears who we are it leaves, so it is not believed at once.
        """
        counts = {key: len(self.logs.entries[key]) for key in self.logs.own}
        has_more = self.logs.has_begun and any(table[key][0] > count for key, count in counts.items())
        peer.has_more_ns = (peer.has_more_ns or now_ns) if has_more else None
        if is_robot or peer.has_more_ns is None:
            return has_more
        return (now_ns - peer.has_more_ns) * 1e-9 >= GIVE_BACK_S

    def _mind_own(self, name: str, peer: Peer, table: dict[Key, tuple[int, int]], now_ns: int) -> None:
        """Notice a robot that has lost its own log; and where we have none, how long messages take by both clocks."""
        lacks = any(table[key][0] < len(self.logs.entries[key]) for key in self.logs.keys((name,)))
        peer.lacks_own_ns = (peer.lacks_own_ns or now_ns) if lacks else None
        if not self.logs.own and peer.lag_s is not None and peer.told_lag_s is not None:
            peer.round_trips_s.append(min(peer.lag_s + peer.told_lag_s + TICK_S, LONGEST_ROUND_TRIP_S))

    def _read_parts(self, reader: packing.Reader, tick: int) -> tuple[tuple[Entry, ...], tuple[Entry, ...]]:
        """Entries that we did not have, and those that wait for others before them."""
        new: list[Entry] = []
        ahead: list[Entry] = []
        while not reader.is_done:
            part = packing.unpack_part(reader, self.logs.robots, tick * TICK_NS)
            new += self.logs.take(part)
            if part.first > len(self.logs.entries[part.key]):
                ahead += part.entries
        return tuple(new), tuple(ahead)

    # -- out -----------------------------------------------------------------------------------------------

    def order(self, order: Operator, now_ns: int) -> bytes:
        """An order as it leaves at once; it is said again with the next ticks."""
        self.keep_saying(order)
        return self.say_order(order, now_ns)

    def keep_saying(self, order: Operator) -> None:
        """An order is said with the next ticks, once at each."""
        self.say_no_more(order)
        self._orders.append((SAID_AGAIN, order))

    def say_no_more(self, order: Operator) -> None:
        """It is void."""
        self._orders = [(left, said) for left, said in self._orders if said != order]

    def messages(
        self, now_ns: int, way: Way | None = None, known: Mapping[str, Way] | None = None
    ) -> list[bytes]:
        """What is to be said at this tick, the most urgent first.

        `way` is where we may be, `known` the ways of others that we keep clear of: to say so is a promise.
        """
        orders = [self.say_order(order, now_ns) for _, order in self._orders]
        self._orders = [(left - 1, order) for left, order in self._orders if left > 1]
        state = self._state(now_ns, way, known or {})
        self._left = min(self._left + self.bytes_s * TICK_S, self.bytes_s * BURST_S)
        self._left -= sum(map(len, orders)) + len(state) + OVERHEAD_BYTES
        self._told_before.append(dict(self._told))
        bodies = self._fill(state, self._wanted(now_ns), now_ns)
        first = self.seal.write(STATE, bodies[0], now_ns)
        self.sent["state"] += len(state) + OVERHEAD_BYTES
        rest = [self.seal.write(PARTS, body, now_ns) for body in bodies[1:]]
        return [*orders, first, *rest]

    def in_range(self, now_ns: int) -> list[str]:
        """Robots that are heard."""
        return [name for name, peer in self.peers.items() if peer.is_heard(now_ns)]

    def watchers_in_range(self, now_ns: int) -> list[int]:
        """Watchers that are heard."""
        return [number for number, peer in self.watchers.items() if peer.is_heard(now_ns)]

    def lacks_own(self, now_ns: int) -> bool:
        """Whether somebody has more of our own logs than we: before anything is added, they bring us the rest.

        A watcher that has gone will bring nothing.
        """
        counts = {key: len(self.logs.entries[key]) for key in self.logs.own}
        peers = [*self.peers.values(), *(self.watchers[number] for number in self.watchers_in_range(now_ns))]
        return any(peer.counts.get(key, 0) > count for peer in peers for key, count in counts.items())

    def clock_off(self, now_ns: int) -> tuple[str, float] | None:
        """Whose clock is to be followed, and by how many seconds ours is ahead of it; None where nothing is to be done.

        All in range follow the first of them by the mission's order. Half the difference of the lags of both ways is
        the difference of the clocks, if both ways take as long; what the delays may hide is left as it is.
        """
        in_range = self.in_range(now_ns)
        first = next((robot for robot in self.logs.robots if robot in in_range or robot == self.logs.me), "")
        peer = self.peers.get(first)
        if peer is None or first == self.logs.me or now_ns < self._clock_set_ns:
            return None
        if peer.told_lag_s is None or peer.lag_s is None or len(peer.lags_s) < LAGS:
            return None
        ahead_s = 0.5 * (peer.lag_s - peer.told_lag_s)
        hidden_s = 0.5 * abs(peer.lag_s + peer.told_lag_s)
        return (first, ahead_s) if abs(ahead_s) > max(CLOCKS_AGREE_S, hidden_s) else None

    def clock_set_back(self, now_ns: int, by_s: float) -> None:
        """Our clock has been set to `now_ns`: what was measured by it before is void.

        Stamps only grow: set back, they say too much for so long.
        """
        self._clock_set_ns = now_ns + round((CLOCKS_SETTLE_S + max(0.0, by_s)) * 1e9)
        for peer in (*self.peers.values(), *self.watchers.values()):
            peer.heard_ns -= round(by_s * 1e9)
            peer.has_more_ns = None
            peer.lags_s.clear()
            peer.told_lag_s = None

    def say_order(self, order: Operator, now_ns: int) -> bytes:
        """An order as it leaves, once."""
        out = packing.Bytes()
        out.uint(now_ns // TICK_NS)
        out.uint(order.t_ns // STEP_NS)
        packing.write_order(out, order)
        data = self.seal.write(ORDER, bytes(out.data), now_ns)
        self.sent["order"] += len(data)
        return data

    def _state(self, now_ns: int, way: Way | None, known: Mapping[str, Way]) -> bytes:
        out, logs, tick = packing.Bytes(), self.logs, now_ns // TICK_NS
        out.uint(tick)
        heard = set(self.in_range(now_ns))
        out.uint(sum((robot in heard) << number for number, robot in enumerate(logs.robots)))
        write_way(out, way, tick)
        for robot in logs.robots:
            # A number from the future is of a clock far ahead, and is confirmed once it has come.
            out.uint(max(0, tick + 1 - known[robot].number) if robot in known else 0)
        for robot in logs.robots:
            _write_lag(out, self.peers[robot].lag_s if robot in heard else None)
        is_done = self.reaches_vehicle and (self.shows_hold or not self.is_to_hold)
        out.uint(self.obeyed + 1 if is_done else 0)
        watchers = self.watchers_in_range(now_ns)
        out.uint(len(watchers))
        for number in watchers:
            out.uint(number)
            _write_lag(out, self.watchers[number].lag_s)
        for key in logs.keys(logs.robots):
            out.uint(len(logs.entries[key]))
            out.sint(tick - logs.closed[key])
        return bytes(out.data)

    def _wanted(self, now_ns: int) -> Iterable[tuple[Cause, Part]]:
        """What could be sent, the most urgent first; for watchers what no robot lacks."""
        logs = self.logs
        robots = {name: self.peers[name] for name in self.in_range(now_ns)}
        slow = any(peer.round_trip_s > SLOW_S for peer in robots.values())
        told = self._told_before[0] if slow else self._told
        for stream in Stream:
            for key in (key for key in logs.own if key[1] == stream):
                for part in self._parts(key, told.get(key, 0), len(logs.entries[key])):
                    yield Cause.NEW, part
            yield from ((Cause.AGAIN, part) for part in self._lacking(stream, robots.values(), now_ns))
        watchers = [self.watchers[number] for number in self.watchers_in_range(now_ns)]
        for stream in Stream:
            yield from ((Cause.SPARE, part) for part in self._lacking(stream, watchers, now_ns))

    def _lacking(self, stream: Stream, peers: Collection[Peer], now_ns: int) -> Iterable[Part]:
        """Parts of the logs of one kind that some of these lack."""
        for key in self.logs.keys(self.logs.robots):
            if key[1] == stream and (since := self._lacked(key, peers, now_ns)) is not None:
                yield from self._parts(key, *since)

    def _parts(self, key: Key, first: int, end: int) -> Iterable[Part]:
        for start in range(first, end, MOST_OF_A_PART):
            yield Part(*key, start, tuple(self.logs.entries[key][start : min(end, start + MOST_OF_A_PART)]))

    def _lacked(self, key: Key, peers: Collection[Peer], now_ns: int) -> tuple[int, int] | None:
        """From which entry to which a log is to be sent again, for all that lack it and that we answer."""
        log, mine = self.logs.entries[key], key[0] == self.logs.me
        end = self._told.get(key, 0) if mine else len(log)
        firsts = []
        for peer in peers:
            count = peer.counts.get(key, 0)
            if count >= end:
                continue
            if not self.logs.own and peer.may_have_begun_anew(now_ns):
                continue
            if mine:  # what has just left may be on its way
                settled_ns = now_ns - round((peer.round_trip_s + TICK_S) * 1e9)
                if log[count].order_ns > settled_ns:
                    continue
            elif self._answers(peer, key) != self.logs.me:
                continue
            if (first := peer.next_of(key, now_ns)) < end:
                firsts.append(first)
        return (min(firsts), end) if firsts else None

    def _answers(self, peer: Peer, key: Key) -> str:
        """Who sends a member what it lacks: the author where it hears that one, else the first that has more.

        Robots come before watchers, which nobody knows to be there: of several each sends it.
        """
        me, hears = self.logs.me, {*peer.hears, self.logs.me}
        if key[0] in hears:
            return key[0]
        known = {name: self.peers[name].counts.get(key, 0) for name in self.peers if name in hears}
        known[me] = len(self.logs.entries[key])
        having = (name for name, count in known.items() if count > peer.counts.get(key, 0))
        return min(having, key=lambda name: (not name, name))

    def _fill(self, state: bytes, wanted: Iterable[tuple[Cause, Part]], now_ns: int) -> list[bytes]:
        """Bodies of messages within the budget: the first begins with the state, the others with the tick.

        What is sent to watchers leaves what a tick brings: nothing of the next one waits for it.
        """
        tick = now_ns // TICK_NS
        head = packing.Bytes()
        head.uint(tick)
        bodies = [state]
        for cause, part in wanted:
            out = packing.Bytes()
            packing.pack_part(out, part, self.logs.robots, tick * TICK_NS)
            size = len(out.data)
            if self._left - (self.bytes_s * TICK_S if cause is Cause.SPARE else 0.0) < size:
                break  # nothing less urgent goes before it
            if len(bodies[-1]) + size > MESSAGE_BYTES:
                bodies.append(bytes(head.data))
                self._left -= OVERHEAD_BYTES
            bodies[-1] += bytes(out.data)
            self._left -= size
            self.sent[cause.value] += size
            self._has_left(part, cause, now_ns)
        return bodies

    def _has_left(self, part: Part, cause: Cause, now_ns: int) -> None:
        """Remember up to where a log has been sent."""
        end = part.first + len(part.entries)
        if cause is Cause.NEW:
            self._told[part.key] = max(self._told.get(part.key, 0), end)
            return
        robots = [self.peers[name] for name in self.in_range(now_ns)]
        for peer in (*robots, *(self.watchers[number] for number in self.watchers_in_range(now_ns))):
            # Where one lacks more, others' parts say nothing of what lies before.
            if max(peer.counts.get(part.key, 0), peer.sent.get(part.key, 0)) >= part.first:
                peer.sent[part.key] = max(peer.sent.get(part.key, 0), end)


def code_of(order: Operator) -> int:
    """What an order is acknowledged by."""
    return order.t_ns // STEP_NS % CODES


def _write_lag(out: packing.Bytes, lag_s: float | None) -> None:
    """A lag to the millisecond; 0: none."""
    lag_ms = -1 if lag_s is None else round(lag_s * packing.MM)
    out.sint(0 if lag_s is None else lag_ms + (lag_ms >= 0))


def _read_lag(reader: packing.Reader) -> float | None:
    lag_ms = reader.sint()
    return None if lag_ms == 0 else (lag_ms - (lag_ms > 0)) / packing.MM


def _read_order(reader: packing.Reader) -> Operator:
    t_ns = reader.uint() * STEP_NS
    return packing.read_order(reader, t_ns)
