"""D-SPOG: every robot keeps its own belief, and all of them become the same belief (DPRWA section IV.B).

What one robot measured (its poses and readings) is a log that only it appends to. Robots that meet send each other how
much of every log they have, and hand over what the other lacks. A checkpoint is the time up to which a robot has
everybody's log: min over p of what it knows of p. (Eq 5 prints W_l where W_p is meant.) Up to there its belief is fed
with all events in one fixed order, so after a checkpoint it equals, bit for bit, that of any other robot at the same
checkpoint, and that of one computer that had heard everything.

Messages may be lost, repeated or come late: what is handed over is taken in once, and a part whose beginning is
missing waits for the next meeting.

The paper has a robot that lags behind copy the other's grid; here events are kept until everybody is known to have
them (a matrix of clocks, after Wuu and Bernstein, "Efficient solutions to the replicated log and dictionary problems",
PODC 1984). That holds somewhat more events and sends no grids; `held` counts what the paper counts.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, Protocol

from fieldkit.engine.belief.base import Belief
from fieldkit.errors import RecordingError
from fieldkit.messages import Detection, Listening, Pose, RssReading

NEVER_NS = -(2**62)


class Associator(Protocol):
    """Poses and readings in, in one fixed order; detections out (`detections.Associator`, `tracks.TrackAssociator`)."""

    def pose(self, pose: Pose) -> None: ...

    def reading(self, reading: RssReading) -> None: ...

    def advance(self, now_ns: int) -> tuple[list[Detection], list[Listening]]:
        """What is certain at `now_ns`, a function of nothing but what was fed."""
        ...


@dataclass(frozen=True, slots=True)
class Held:
    """What one robot has in memory."""

    readings: int
    """Readings of all robots after its checkpoint: the paper's number of detection events on board."""
    poses: int
    kept_for_others: int
    """Events before its checkpoint that somebody is not yet known to have."""


@dataclass
class Replica:
    """One robot's share of the common belief. Deterministic; all times are of one clock (GPS)."""

    me: str
    robots: tuple[str, ...]
    belief: Belief
    associate: Callable[[], Associator]
    """Makes the associator; the same settings on every robot."""
    aboard: tuple[str, ...] = ()
    """Robots whose measurements go into its log, where they always stay in touch, as a pair does; else it alone."""
    knows_ns: dict[str, dict[str, int]] = field(init=False)
    """Robot q to robot p to the time up to which q is known to have p's log. `knows_ns[me]` is what we have."""
    _logs: dict[str, list[Pose | RssReading]] = field(init=False)
    _fed_ns: int = field(init=False, default=NEVER_NS)

    def __post_init__(self) -> None:
        if self.me not in self.robots:
            raise ValueError(f"robot {self.me!r} is not one of {', '.join(self.robots)}")
        self.knows_ns = {q: dict.fromkeys(self.robots, NEVER_NS) for q in self.robots}
        self._logs = {robot: [] for robot in self.robots}
        self._associator = self.associate()

    # -- what it measures itself -------------------------------------------------------------------------

    def measure(self, event: Pose | RssReading) -> None:
        """Append a measurement of its own; they come in order of time. Raises `ValueError` for another's."""
        if event.robot not in (self.aboard or (self.me,)):
            raise ValueError(f"{self.me}: a measurement of {event.robot!r} comes by exchange, not here")
        if event.t_ns < self.knows_ns[self.me][self.me]:
            raise ValueError(
                f"{self.me}: measurement at {event.t_ns} ns, after its log was closed up to then"
            )
        self._logs[self.me].append(event)

    def tick(self, now_ns: int) -> None:
        """Say that everything of its own up to `now_ns` is in the log, nothing heard included."""
        self.knows_ns[self.me][self.me] = max(self.knows_ns[self.me][self.me], now_ns)

    # -- meeting another -----------------------------------------------------------------------------------

    def hello(self) -> bytes:
        """A message that lists what this robot has, so that the other can send the rest."""
        return json.dumps({"from": self.me, "knows": self.knows_ns}).encode()

    def answer(self, hello: bytes) -> bytes:
        """What the sender of `hello` lacks and we have. Raises `RecordingError` for bytes that are no message."""
        other = _parsed(hello, ("from", "knows"))
        has = other["knows"].get(other["from"], {})
        parts = []
        for robot in self.robots:
            since, until = int(has.get(robot, NEVER_NS)), self.knows_ns[self.me][robot]
            if until > since:
                events = [_packed(e) for e in self._logs[robot] if since < e.t_ns <= until]
                parts.append({"robot": robot, "since": since, "until": until, "events": events})
        self._learn(other["knows"])
        return json.dumps({"from": self.me, "knows": self.knows_ns, "parts": parts}).encode()

    def take(self, answer: bytes) -> None:
        """Take in what another handed over. Anything it has already, or whose beginning it lacks, is left."""
        message = _parsed(answer, ("from", "knows", "parts"))
        mine = self.knows_ns[self.me]
        for part in message["parts"]:
            robot, since, until = part["robot"], int(part["since"]), int(part["until"])
            if robot not in mine or robot == self.me or since > mine[robot] or until <= mine[robot]:
                continue
            self._logs[robot] += [e for e in map(_unpacked, part["events"]) if e.t_ns > mine[robot]]
            mine[robot] = until
        self._learn(message["knows"])

    def _learn(self, theirs: dict[str, dict[str, int]]) -> None:
        """What others are known to have only grows."""
        for q, row in theirs.items():
            for p, until in row.items():
                if q in self.knows_ns and p in self.knows_ns[q] and q != self.me:
                    self.knows_ns[q][p] = max(self.knows_ns[q][p], int(until))

    # -- the belief ----------------------------------------------------------------------------------------

    @property
    def checkpoint_ns(self) -> int:
        """Up to when it has everybody's log (eq 5)."""
        return min(self.knows_ns[self.me].values())

    def synchronise(self, until_ns: int | None = None) -> bool:
        """Feed the belief up to the checkpoint; whether there was a new one. Forgets what everybody has.

        `until_ns` stops earlier: at a moment at which all are to plan from one belief.
        """
        checkpoint = self.checkpoint_ns if until_ns is None else min(self.checkpoint_ns, until_ns)
        if checkpoint <= self._fed_ns:
            return False
        fresh = [e for log in self._logs.values() for e in log if self._fed_ns < e.t_ns <= checkpoint]
        feed(self._associator, fresh)
        self._fed_ns = checkpoint
        for detection in self._associator.advance(checkpoint)[0]:
            self.belief.detect(detection)
        for robot, log in self._logs.items():
            everybody_has = min(row[robot] for row in self.knows_ns.values())
            forget = min(everybody_has, checkpoint)
            self._logs[robot] = [e for e in log if e.t_ns > forget]
        return True

    def held(self) -> Held:
        """What is in memory now."""
        after = [e for log in self._logs.values() for e in log if e.t_ns > self._fed_ns]
        readings = sum(isinstance(e, RssReading) for e in after)
        return Held(readings, len(after) - readings, sum(map(len, self._logs.values())) - len(after))


def feed(associator: Associator, events: Iterable[Pose | RssReading]) -> None:
    """Events in the one order that everybody keeps: by time, poses before readings, by robot."""
    for event in sorted(events, key=lambda e: (e.t_ns, isinstance(e, RssReading), e.robot)):
        if isinstance(event, Pose):
            associator.pose(event)
        else:
            associator.reading(event)


def meet(one: Replica, other: Replica) -> None:
    """Two robots in range exchange all they have, and both look for a new checkpoint."""
    exchange(one, other)
    one.synchronise()
    other.synchronise()


def exchange(one: Replica, other: Replica) -> None:
    """Two robots in range send each other all they have."""
    to_one, to_other = other.answer(one.hello()), one.answer(other.hello())
    one.take(to_one)
    other.take(to_other)


def _packed(event: Pose | RssReading) -> list[object]:
    if isinstance(event, Pose):
        return [
            "p",
            event.t_ns,
            event.robot,
            event.east_m,
            event.north_m,
            event.up_m,
            event.heading_deg,
            event.sigma_m,
        ]
    return ["r", event.t_ns, event.robot, event.rss_dbm, event.frame_id, event.saturated]


def _unpacked(row: list[object]) -> Pose | RssReading:
    match row:
        case ["p", int(t), str(robot), *numbers]:
            return Pose(t, robot, *(float(x) for x in numbers))  # type: ignore[arg-type]
        case ["r", int(t), str(robot), float(rss) | int(rss), frame_id, bool(saturated)]:
            return RssReading(t, robot, float(rss), frame_id=frame_id, saturated=saturated)  # type: ignore[arg-type]
    raise RecordingError(f"exchange: expected a pose or a reading, got {row!r:.80}")


def _parsed(message: bytes, keys: tuple[str, ...]) -> dict[str, Any]:
    try:
        parsed = json.loads(message)
    except ValueError as error:
        raise RecordingError(f"exchange: not a message of ours ({error}); it is left out") from None
    if not isinstance(parsed, dict) or any(key not in parsed for key in keys):
        raise RecordingError(f"exchange: expected a message with {', '.join(keys)}; it is left out")
    return parsed
