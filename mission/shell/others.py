"""Who else is there, said once: those that do not belong to the team, and a clock that is not the team's."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from fieldkit.clock import Clock, RealClock
from fieldkit.engine.decentralised.card import Card, clock_refusal, refusal, stranger
from fieldkit.engine.decentralised.talk import Talk
from mission.core.lines import Lines

ORDERED = {
    "hold": "held by the operator",
    "return": "on its way home",
    "release": "released to somebody else",
    "withdraw": "out of the mission",
}
"""What a robot does that has a standing order."""


def ordered_words(action: str, by: str) -> str:
    """What a robot does that has a standing order, and of a hold whose, where that is known."""
    return f"held: {by}" if action == "hold" and by else ORDERED[action]


MOST_MISSIONS = 5
"""So many other missions are named: what those say of themselves anybody may have made up."""


@dataclass
class Refused:
    """Cards of those that are not heard."""

    strangers: int = 0
    """Cards that were signed with another key."""
    _said: set[tuple[str, bool]] = field(default_factory=set)
    _missions: set[str] = field(default_factory=set)

    def other_mission(self, mine: Card, data: bytes) -> str:
        """What is to be said of a card that was signed with another key; empty where its mission was named before."""
        self.strangers += 1
        mission, who = stranger(data)
        if not mission or mission in self._missions or len(self._missions) >= MOST_MISSIONS:
            return ""
        self._missions.add(mission)
        if mission == mine.mission:
            return (
                f"{who} is of a mission of the same name, {mission!r}, and has another key: it is not heard; where "
                "both are one mission, copy the same mission.key to all"
            )
        return f"another mission is on this network, {mission!r} ({who}): neither hears the other"

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
class Names:
    """Addresses whose names cannot be resolved, each said once, and again when that changes."""

    _said: dict[str, set[str]] = field(default_factory=dict)
    """Address to what was said of it since it could last be resolved."""

    def news(self, unresolved: Mapping[str, str]) -> list[str]:
        """What has changed, in words."""
        words = []
        for address, why in unresolved.items():
            if why not in self._said.setdefault(address, set()):
                self._said[address].add(why)
                words.append(
                    f"{address}: its name cannot be resolved ({why}): nobody is reached there. It goes on trying, as "
                    "the network may come later; is the name right? An address in numbers needs none"
                )
        for address in self._said.keys() - unresolved.keys():
            del self._said[address]
            words.append(f"{address}: its name is resolved now")
        return words


@dataclass
class Contacts:
    """Who is heard now, and who no longer, each said once."""

    lines: Lines
    present: set[str] = field(default_factory=set)
    """Robots in contact at the last look, over others too; never one's own."""
    ages_s: dict[str, float] = field(default_factory=dict)
    """How old what was known of each other robot was then; infinite where nothing was."""
    _without: set[str] = field(default_factory=set)

    def news(self, now_ns: int) -> tuple[list[str], list[str]]:
        """What has changed since the last look, in words: what is trouble, and what is none."""
        lines = self.lines
        self.ages_s = lines.ages_s(now_ns)
        present, before = set(lines.present(now_ns)) - {lines.logs.me}, self.present
        said = [
            f"{name} is out of contact: what is known of it is {self.ages_s[name]:.0f} s old"
            for name in sorted(before - present)
        ]
        come = [f"{name} is in contact" for name in sorted(present - before)]
        never = {name for name, age_s in self.ages_s.items() if math.isinf(age_s)}
        without = never - set(lines.line.members) if lines.line is not lines.common else set()
        if lines.logs.me and without - self._without:
            alone = "alone" if len(lines.line.members) == 1 else "without them"
            said.append(f"nothing was heard of {', '.join(sorted(without))}: it goes on {alone}")
        self.present, self._without = present, without
        return said, come

    def absent(self) -> dict[str, str]:
        """Robots out of contact, and how old what is known of each is, in words."""
        return {
            name: f"out of contact: {f'known {age_s:.0f} s ago' if math.isfinite(age_s) else 'never heard of'}"
            for name, age_s in self.ages_s.items()
            if name not in self.present
        }


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
