"""What an agent and a laptop that watches do alike: say who they are and what is new, and hear who is there.

At every tick what has come to be known goes to the journal, and only then to the others.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from fieldkit.clock import Clock
from fieldkit.engine.decentralised.card import Card, read_card
from fieldkit.engine.decentralised.talk import Talk
from fieldkit.ports import Network
from mission.core.lines import Lines
from mission.shell.journal import Journal
from mission.shell.others import Contacts, Names, Refused, TeamClock

CARD_EVERY_S = 5.0


@dataclass
class Member:
    """See the module. `say` puts trouble before the operator, `tell` what is none."""

    clock: Clock
    network: Network
    key: bytes
    card: Card
    talk: Talk
    journal: Journal
    lines: Lines
    say: Callable[[str], None]
    tell: Callable[[str], None]
    others: Refused = field(default_factory=Refused)
    keeps_journal: bool = True
    """Not while its robot's own log may still come back: a journal with less of it would be gone on with."""
    contacts: Contacts = field(init=False)
    _names: Names = field(default_factory=Names)
    _team_clock: TeamClock = field(init=False)
    _card_s: float = -math.inf

    def __post_init__(self) -> None:
        self.contacts = Contacts(self.lines)
        self._team_clock = TeamClock(self.clock, self.talk)

    def speak(self, messages: Callable[[int], Iterable[bytes]]) -> None:
        """A tick's words: `messages` are those of a time."""
        if said := self._team_clock.follow():
            self.say(said)
        for said in self._names.news(self.network.unresolved):
            self.say(said)
        now_ns, now_s = self.clock.now_ns(), self.clock.elapsed_s()
        if self.keeps_journal:
            self.journal.write(self.talk.logs)
        for message in messages(now_ns):
            self.network.publish(message)
        if now_s - self._card_s >= CARD_EVERY_S:
            self._card_s = now_s
            card = replace(self.card, sent_ns=now_ns).to_bytes(self.key)
            self.talk.sent["card"] += len(card)
            self.network.greet(card)

    def mind_contact(self) -> None:
        """Say who has come into contact, and who has gone."""
        gone, come = self.contacts.news(self.clock.now_ns())
        for said in gone:
            self.say(said)
        for said in come:
            self.tell(said)

    def met(self, data: bytes) -> Card | None:
        """Who has said who he is; None where that is one of another key, which is said."""
        card = read_card(self.key, data)
        if card is None and (said := self.others.other_mission(self.card, data)):
            self.say(said)
        return card

    def refuse(self, card: Card, now_ns: int, otherwise: str = "") -> None:
        """Say why nothing of another is heard, if that is so, or `otherwise`."""
        if said := self.others.news(self.card, card, now_ns, otherwise):
            self.say(said)

    def result(self) -> dict[str, Any]:
        """What was said, heard and dropped."""
        talk, dropped, ages_s = self.talk, dict(self.talk.seal.dropped), self.contacts.ages_s
        return {
            "age_s": {name: round(s, 1) if math.isfinite(s) else None for name, s in ages_s.items()},
            "bytes_sent": dict(talk.sent),
            "bytes_heard": talk.heard_bytes,
            "dropped": dropped | {"strangers": self.others.strangers, "unreadable": talk.refused},
        }
