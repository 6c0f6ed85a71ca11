"""Who else is there, said once: those that do not belong to the team, and a clock that is not the team's."""

from dataclasses import dataclass, field

from fieldkit.clock import Clock, RealClock
from fieldkit.engine.decentralised.card import Card, clock_refusal, refusal
from fieldkit.engine.decentralised.talk import Talk


@dataclass
class Refused:
    """Cards of those that are not heard."""

    strangers: int = 0
    """Cards that were signed with another key."""
    _said: set[tuple[str, bool]] = field(default_factory=set)

    def news(self, mine: Card, card: Card, now_ns: int, otherwise: str = "") -> str:
        """Why the card's owner is not heard, or `otherwise`; empty where there is nothing, or that was said before."""
        late = clock_refusal(card, now_ns)
        reason = late or refusal(mine, card) or otherwise
        said = (card.instance, bool(late))
        if not reason or said in self._said:
            return ""
        self._said.add(said)
        return reason


@dataclass
class TeamClock:
    """Goes by the clock of the first robot in reach: by another's, nobody's positions are as old as they seem."""

    clock: Clock
    talk: Talk
    _said: bool = False

    def follow(self) -> str:
        """Set it where it is off; what is to be said of that."""
        clock, talk = self.clock, self.talk
        if (off := talk.clock_off(clock.now_ns())) is None:
            self._said = False
            return ""
        first, ahead_s = off
        apart = f"this computer's clock is {abs(ahead_s):.2f} s {'ahead of' if ahead_s > 0 else 'behind'} {first}'s"
        said, self._said = self._said, True
        if isinstance(clock, RealClock):
            clock.set_back(ahead_s)
            talk.clock_set_back(clock.now_ns(), ahead_s)
            return f"{apart}: that is taken off for this mission; set the clocks (chrony, GNSS)"
        return "" if said else f"{apart}: set the clocks"
