"""HOLD ALL from a computer that has no robot: said until every agent has shown that it obeys, or for a while."""

import asyncio
from collections.abc import Callable

from fieldkit.clock import Clock
from fieldkit.engine.decentralised.card import MARK, Card, apart_words, read_card, refusal
from fieldkit.engine.decentralised.logs import Logs
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import OPERATOR, Talk, code_of
from fieldkit.messages import Operator
from fieldkit.ports import Network
from mission.shell.others import Names, Refused

EVERY_S = 0.25
"""An order is said so often."""


async def hold_all(
    robots: tuple[str, ...],
    network: Network,
    card: Card,
    key: bytes,
    clock: Clock,
    patience_s: float,
    say: Callable[[str], None] = lambda _: None,
) -> dict[str, str]:
    """Robot to "holds", "has not shown it" or "is not heard", with why where that is known. Returns once all hold.

    `say` is given what the operator is to know meanwhile. An agent that obeys logs the order, so that robots out of
    reach learn of it from that one: one is enough.
    """
    talk = Talk(Logs(robots[0], robots), Seal(session_key(key, card.common), OPERATOR))
    others, names, why = Refused(), Names(), dict[str, str]()
    order = quantised(Operator(clock.now_ns(), "hold", None, f"operator, by --hold on {card.host}"))
    assert isinstance(order, Operator)
    said = {}
    async with network:
        listening = asyncio.create_task(
            _listen(network, talk, clock, key, card, others, why, say), name="listen"
        )
        until_s = clock.elapsed_s() + patience_s
        while clock.elapsed_s() < until_s:
            network.publish(talk.say_order(order, clock.now_ns()), urgent=True)
            await clock.sleep(EVERY_S)
            for news in names.news(network.unresolved):
                say(news)
            said = {name: _word(talk, name, order, why.get(name, "")) for name in robots}
            if set(said.values()) == {"holds"}:
                break
        listening.cancel()
        await asyncio.wait({listening})
    return said


def _word(talk: Talk, name: str, order: Operator, why: str) -> str:
    if (peer := talk.peers.get(name)) is None:
        ahead_s = talk.seal.stale_s.get(talk.logs.robots.index(name))
        reason = why if ahead_s is None else apart_words(ahead_s)
        return f"is not heard: {reason}" if reason else "is not heard"
    return "holds" if peer.obeyed == code_of(order) else "has not shown it"


async def _listen(
    network: Network,
    talk: Talk,
    clock: Clock,
    key: bytes,
    mine: Card,
    others: Refused,
    why: dict[str, str],
    say: Callable[[str], None],
) -> None:
    """Take in what is said. `why`: why a robot is not heard; that others have another key is said at once."""
    async for data in network.messages():
        now_ns = clock.now_ns()
        if not data.startswith(MARK):
            talk.take(data, now_ns)
        elif (card := read_card(key, data)) is None:
            if said := others.other_mission(mine, data):
                say(said)
        elif reason := refusal(mine, card):
            why[card.robot] = reason
