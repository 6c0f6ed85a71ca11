"""An address whose name cannot be resolved is said once by agent, laptop and --hold, and again when that changes."""

import asyncio
from pathlib import Path

from test_agent_runner import KEY, Robot, both, notes, two
from test_watching import Laptop

from mission.shell.agent_flight import card_of
from mission.shell.hold_all import hold_all
from mission.shell.others import Names

ADDRESS, OTHER = "tcp/r1.local:7447", "tcp/r2.local:7447"
NO_NAME, NO_NETWORK = "Name or service not known", "Temporary failure in name resolution"


def test_each_address_is_said_once_and_again_when_it_changes() -> None:
    names = Names()
    assert names.news({}) == []
    (said,) = names.news({ADDRESS: NO_NETWORK})
    assert (
        said.startswith(f"{ADDRESS}: its name cannot be resolved ({NO_NETWORK})") and "goes on trying" in said
    )
    assert names.news({ADDRESS: NO_NETWORK}) == []
    assert [word.partition(":7447")[0] for word in names.news({ADDRESS: NO_NAME, OTHER: NO_NAME})] == [
        "tcp/r1.local", "tcp/r2.local",
    ]  # fmt: skip
    assert names.news({ADDRESS: NO_NETWORK, OTHER: NO_NAME}) == [], "to and fro is nothing new"
    assert names.news({OTHER: NO_NAME}) == [f"{ADDRESS}: its name is resolved now"]
    assert len(names.news({ADDRESS: NO_NETWORK, OTHER: NO_NAME})) == 1, "it is lost again"


def test_an_agent_a_laptop_and_the_hold_say_it(tmp_path: Path) -> None:
    by_hand: list[str] = []

    async def act(team: dict[str, Robot]) -> None:
        r1, laptop = team["r1"], Laptop(team)
        ether = r1.network._ether
        hand, places = ether.member("hand"), ether._places_m
        ether._places_m = lambda: {**places(), "hand": (5.0, 5.0)}
        for network in (r1.network, laptop.network, hand):
            network.unresolved = {ADDRESS: NO_NAME}
        watching, flights = asyncio.create_task(laptop.watch()), asyncio.create_task(both(team))
        await r1.clock.sleep(6.0)
        await hold_all(
            ("r1", "r2"), hand, card_of(r1.mission, "r1", r1.clock), KEY, r1.clock, 1.0, by_hand.append
        )
        r1.network.unresolved = laptop.network.unresolved = {}
        await r1.clock.sleep(2.0)
        assert laptop.said().count(f"{ADDRESS}: its name cannot be resolved ({NO_NAME})") == 1
        assert laptop.said().count("its name is resolved now") == 1
        laptop.order("resume")
        await flights
        laptop.order("end")
        await watching

    team = two(tmp_path, act, duration_s=15.0)
    said = notes(team["r1"].log / "mission.mcap")
    assert (
        said.count(f"{ADDRESS}: its name cannot be resolved") == said.count("its name is resolved now") == 1
    )
    assert "resolved" not in notes(team["r2"].log / "mission.mcap")
    assert len(by_hand) == 1 and by_hand[0].startswith(ADDRESS)
