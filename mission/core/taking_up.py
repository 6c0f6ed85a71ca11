"""Whether the mission still goes on in which an operator has ended a robot's agent. Pure.

An agent that is started again must not begin its robot's log anew where others hold that log: two versions of one log
fit into no common belief. Nor must it bring the log of a mission that is over into the next one, which others have
begun. What the agent before it knew, and what others say now, tells which of the two it is.
"""

from dataclasses import dataclass, field

from fieldkit.engine.decentralised.logs import Logs, Stream
from fieldkit.engine.decentralised.talk import Talk
from fieldkit.messages import Operator, ReceiverState

ENDED = "its agent has ended: "
"""With these words a robot leaves the mission whose operator has ended its agent."""
RESTARTED = "its agent was restarted"


def ended_ns(logs: Logs, robot: str) -> int | None:
    """When an operator ended a robot's agent that has not been started again since, by the robot's log; else None."""
    at_ns = None
    for entry in logs.entries[robot, Stream.ORDERS]:
        match entry.event:
            case ReceiverState(reason=reason) if reason == RESTARTED:
                at_ns = None
            case Operator(action="withdraw", robot=who, reason=reason) if who == robot:
                at_ns = entry.event.t_ns if reason.startswith(ENDED) else at_ns
    return at_ns


@dataclass
class Left:
    """What an agent knew that was ended before its mission was over."""

    logs: Logs
    until_ns: int
    """When the mission's time is up at the latest."""
    gone: frozenset[str] = field(init=False)
    """Robots whose agents had been ended before."""

    def __post_init__(self) -> None:
        self.gone = frozenset(r for r in self.logs.robots if ended_ns(self.logs, r) is not None)

    def goes_on(self, talk: Talk) -> bool:
        """Whether others hold something of our own log: they are in the mission that was left."""
        has_come = any(talk.logs.entries[key] for key in talk.logs.own)
        return has_come or any(
            peer.counts.get(key, 0) for peer in talk.peers.values() for key in talk.logs.own
        )

    def is_over(self, talk: Talk, now_ns: int) -> bool:
        """Whether nobody can be in it any more. Of one who is out of reach and was not ended nobody can tell.

        One who is heard and has nothing of our log was started anew; one who has begun a log so, and had one before, is
        in the next mission.
        """
        if now_ns > self.until_ns:
            return True
        heard = {name for name in talk.in_range(now_ns) if talk.peers[name].said_ns}
        for name in heard:
            keys, counts = self.logs.keys((name,)), talk.peers[name].counts
            if any(counts.get(key, 0) for key in keys) and any(self.logs.entries[key] for key in keys):
                return True
        return all(name in self.gone | heard | {self.logs.me} for name in self.logs.robots)
