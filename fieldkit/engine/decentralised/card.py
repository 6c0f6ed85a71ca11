"""Who an agent is, said every few seconds: so that those who do not belong together learn why, by name. Pure.

A card is signed with the mission's key alone. What members say otherwise is signed with a key that is made of the
mission file and the version too (`sealing.session_key`): they could not even read each other.
"""

import json
from dataclasses import asdict, dataclass, fields

from fieldkit.engine.decentralised.packing import LARGEST
from fieldkit.engine.decentralised.sealing import MAC_BYTES, STALE_S, session_key, signed, unsigned

MARK = b"\x00card"
"""No other message begins so: kinds of those are not 0."""
LONGEST_WORD = 40
"""Of what strangers call themselves."""
LONGEST_CARD = 4_096
"""Bytes; no card of ours comes near. Anybody may send anything to where cards are heard."""


@dataclass(frozen=True, slots=True)
class Card:
    """What an agent says of itself."""

    robot: str
    mission: str
    """Its mission's name."""
    mission_hash: str
    """Of mission and antenna file."""
    version: str
    code: str
    """Of the code that decides, which may change within one version."""
    host: str
    instance: str
    """Of this very process: a robot that is restarted has another."""
    started_ns: int
    sent_ns: int = 0

    @property
    def common(self) -> str:
        """What agents must have in common to hear each other."""
        return f"{self.mission_hash} {self.version} {self.code}"

    def to_bytes(self, key: bytes) -> bytes:
        """The card as it goes out."""
        return signed(session_key(key, "card"), MARK + json.dumps(list(asdict(self).values())).encode())


def read_card(key: bytes, data: bytes) -> Card | None:
    """The card in a message; None where there is none of this key."""
    said = unsigned(session_key(key, "card"), data) if data.startswith(MARK) else None
    return None if said is None else _parsed(said)


def _parsed(said: bytes) -> Card | None:
    """The card in bytes that anybody may have written; None where they hold none."""
    if len(said) > LONGEST_CARD:
        return None
    try:
        values = json.loads(said.removeprefix(MARK))
    except (ValueError, RecursionError):  # brackets in brackets
        return None
    kinds = [each.type for each in fields(Card)]
    if not isinstance(values, list) or [type(value) for value in values] != kinds:
        return None
    card = Card(*values)
    return card if max(abs(card.started_ns), abs(card.sent_ns)) < LARGEST else None


def stranger(data: bytes) -> tuple[str, str]:
    """What a card of another key says of itself: its mission, and its robot and computer. Anybody may have written it.

    No longer than a line, and without anything that a terminal would obey; both empty where it is no card.
    """
    card = _parsed(data[:-MAC_BYTES]) if data.startswith(MARK) else None
    if card is None:
        return "", ""
    mission, robot, host = (_tame(each) for each in (card.mission, card.robot, card.host))
    return mission, f"{robot} on {host}"


def _tame(text: str) -> str:
    return "".join(each for each in text[:LONGEST_WORD] if each.isprintable()) or "?"


def clock_refusal(card: Card, now_ns: int) -> str:
    """Why nothing that its agent says is heard: it comes from another time. Empty where it does not."""
    ahead_s = (card.sent_ns - now_ns) * 1e-9
    if abs(ahead_s) <= STALE_S:
        return ""
    return f"{card.robot} on {card.host} is not heard: {apart_words(ahead_s)}"


def apart_words(ahead_s: float) -> str:
    """What is wrong where another's messages come from so many seconds ahead."""
    way = "ahead of" if ahead_s > 0 else "behind"
    return (
        f"its clock is {abs(ahead_s):.0f} s {way} this computer's, or old messages of it are repeated; set the clocks "
        "(chrony, GNSS)"
    )


def refusal(mine: Card, other: Card) -> str:
    """Why two agents do not belong together; empty where they do."""
    who = f"{other.robot} on {other.host}"
    if other.mission_hash != mine.mission_hash:
        return (
            f"{who} has another mission or antenna file (mission {other.mission!r}, {other.mission_hash}; here "
            f"{mine.mission!r}, {mine.mission_hash}): it is not heard; copy the files anew to both"
        )
    if (other.version, other.code) != (mine.version, mine.code):
        return (
            f"{who} runs another fieldkit ({other.version}, code {other.code}; here {mine.version}, code {mine.code}): "
            "it is not heard, since it would decide otherwise; install the same on both"
        )
    return ""


def is_second(mine: Card, other: Card) -> bool:
    """Whether another agent has been steering our robot for longer than we have."""
    if (
        other.robot != mine.robot
        or other.instance == mine.instance
        or other.mission_hash != mine.mission_hash
    ):
        return False
    return (other.started_ns, other.instance) < (mine.started_ns, mine.instance)
