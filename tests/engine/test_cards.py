"""Cards: what anybody may send to where agents say who they are must lead to nothing at all."""

import json
from dataclasses import asdict, replace

import pytest

from fieldkit.engine.decentralised.card import MARK, Card, clock_refusal, is_second, read_card, stranger
from fieldkit.engine.decentralised.sealing import KEY_BYTES, MAC_BYTES, session_key, signed

KEY = bytes(range(KEY_BYTES))
CARD = Card("r1", "forest", "abc", "1.0", "def", "pi", "a1", 5, 7)
NO_HASH = bytes(MAC_BYTES)
PLAIN = json.dumps(list(asdict(CARD).values())).encode()
ODD = {
    "infinite": PLAIN.replace(b" 7", b" Infinity"),
    "too large for a number with a point": PLAIN.replace(b" 7", b" 1e999"),
    "too large for a time": PLAIN.replace(b" 7", b" 1" + b"0" * 400),
    "brackets in brackets": b"[" * 200_000,
    "brackets in brackets, short": b"[" * 4_000,
    "a long one": PLAIN.replace(b"forest", b"f" * 1_000_000),
    "a list for a text": PLAIN.replace(b'"forest"', b"[[]]"),
    "a text for a time": PLAIN.replace(b" 5", b' "5"'),
    "true for a time": PLAIN.replace(b" 5", b" true"),
    "a dictionary": json.dumps(asdict(CARD)).encode(),
    "a value too many": PLAIN.replace(b"]", b", 1]"),
    "nothing": b"",
    "no text": b"\xff\xfe[",
}


def test_a_card_comes_back_as_it_was() -> None:
    assert read_card(KEY, CARD.to_bytes(KEY)) == CARD
    assert read_card(bytes(KEY_BYTES), CARD.to_bytes(KEY)) is None
    assert stranger(CARD.to_bytes(KEY)) == ("forest", "r1 on pi")


@pytest.mark.parametrize("said", ODD.values(), ids=ODD.keys())
def test_what_is_no_card_is_none(said: bytes) -> None:
    assert stranger(MARK + said + NO_HASH) == ("", "")
    # One with the key, of another version: neither does it end anybody.
    assert read_card(KEY, signed(session_key(KEY, "card"), MARK + said)) is None


def test_times_of_a_card_can_be_compared() -> None:
    late = replace(CARD, instance="b2", started_ns=2**63 - 1, sent_ns=2**63 - 1)
    heard = read_card(KEY, late.to_bytes(KEY))
    assert heard == late and not is_second(CARD, late) and "ahead" in clock_refusal(late, 0)
