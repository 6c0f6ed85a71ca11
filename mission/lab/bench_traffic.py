"""What agents send a second, by kind, and how long a laptop that comes late takes to learn an hour. In virtual time.

Robots drive a random walk at the default speed; each logs two poses and one reading a second, has a way, and hears all
others 50 ms late. What is counted is what leaves an agent; links add their own heads.
"""

import hashlib
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from fieldkit import settings as given
from fieldkit.engine.decentralised import packing
from fieldkit.engine.decentralised.card import Card
from fieldkit.engine.decentralised.logs import TICK_NS, Logs, Part
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import WATCHERS, Talk
from fieldkit.engine.decentralised.ways import Way
from fieldkit.messages import Pose, RssReading
from fieldkit.world.network import Air, Network
from mission.shell.member import CARD_EVERY_S

START_NS = 3_600_000_000 * TICK_NS
KEY = session_key(bytes(range(32)), "traffic")
TALKS_S, HOUR_S, AWAY_S = 600.0, 3_600.0, 400.0
TEAMS = (4, 8)
LEVEL_TICKS = 3
"""Its copy lies no further back than the robots' own then."""


def agent_traffic() -> dict[str, Any]:
    """Bytes a second of one agent, for teams of four and of eight; and what it takes to catch up. About a minute."""
    away = _alone(AWAY_S)
    return {
        **{f"{robots}_robots_bytes_s": _a_second(robots) for robots in TEAMS},
        f"own_bytes_of_{AWAY_S:g}_s_away": away,
        "laptop_learns_an_hour_of_4_in_s": _late_laptop(4),
    }


class _Robot:
    """A robot's log, as it drives and listens."""

    def __init__(self, talk: Talk, number: int) -> None:
        self.talk, self.rng = talk, np.random.default_rng(number)
        self.place_m = self.rng.uniform(5.0, 95.0, 2)
        self.way: Way | None = None

    def live(self, tick: int) -> None:
        """Half a second: a pose, and a reading at every other tick."""
        logs, now_ns = self.talk.logs, START_NS + tick * TICK_NS
        if self.way is None or tick % 40 == 0:
            end_m = self.place_m + self.rng.uniform(-4.0, 4.0, 2)
            speed_m_s = given.MAX_SPEED_M_S.default
            start_m, end = (
                (float(self.place_m[0]), float(self.place_m[1])),
                (float(end_m[0]), float(end_m[1])),
            )
            self.way = Way(now_ns // TICK_NS, start_m, end, speed_m_s)
        self.place_m = self.place_m + self.rng.normal(0.0, 0.1, 2)
        east_m, north_m = self.place_m.tolist()
        heading_deg = float(self.rng.uniform(0.0, 360.0))
        logs.append(
            packing.quantised(Pose(now_ns, logs.me, east_m, north_m, 0.0, heading_deg, sigma_m=0.03)), now_ns
        )
        if tick % 2 == 0:
            rss_dbm = float(self.rng.integers(-90, -50))
            logs.append(packing.quantised(RssReading(now_ns, logs.me, rss_dbm)), now_ns)
        logs.close(now_ns)


def _team(robots: int) -> dict[str, _Robot]:
    names = tuple(f"r{k + 1}" for k in range(robots))
    return {
        name: _Robot(Talk(Logs(name, names), Seal(KEY, number)), number) for number, name in enumerate(names)
    }


class _Field:
    """A team in contact, and the laptop once it has come."""

    def __init__(self, robots: int) -> None:
        self.team = _team(robots)
        self.talks = {name: robot.talk for name, robot in self.team.items()}
        self.network, self.tick = Network(Air(), np.random.default_rng(0)), 0

    def go_on(self) -> int:
        """One tick of all; its number by everybody's clock."""
        now_ns, t_s = START_NS + self.tick * TICK_NS, self.tick * given.TICK_S
        for name, data in self.network.arrived(t_s):
            self.talks[name].take(data, now_ns)
        ways = {name: robot.way for name, robot in self.team.items() if robot.way is not None}
        here = dict.fromkeys(self.talks, (0.0, 0.0))
        for name, talk in self.talks.items():
            if name in self.team:
                self.team[name].live(self.tick)
            known = {other: way for other, way in ways.items() if other != name}
            for message in talk.messages(now_ns, ways.get(name), known):
                self.network.send(t_s, name, message, here)
        self.tick += 1
        return now_ns // TICK_NS


def _a_second(robots: int) -> dict[str, float]:
    """Of the agent that sends most."""
    field = _Field(robots)
    for _ in range(round(TALKS_S / given.TICK_S)):
        field.go_on()
    most = max((talk.sent for talk in field.talks.values()), key=Counter.total)
    told = {kind: round(sent / TALKS_S, 1) for kind, sent in sorted(most.items())}
    told["card"] = round(_card_bytes() / CARD_EVERY_S, 1)
    return told | {"all": round(sum(told.values()), 1)}


def _card_bytes() -> int:
    digest = hashlib.sha256().hexdigest()
    card = Card("r1", "a mission", digest[:12], "1.0.0", digest[:12], "raspberrypi", digest[:8], START_NS)
    return len(replace(card, sent_ns=START_NS).to_bytes(KEY))


def _alone(seconds: float) -> int:
    """How many bytes one robot has of its own to tell then."""
    (robot,) = _team(1).values()
    for tick in range(round(seconds / given.TICK_S)):
        robot.live(tick)
    logs, size = robot.talk.logs, 0
    for key, log in logs.entries.items():
        for first in range(0, len(log), 20):
            out = packing.Bytes()
            packing.pack_part(out, Part(*key, first, tuple(log[first : first + 20])), logs.robots, START_NS)
            size += len(out.data)
    return size


def _late_laptop(robots: int) -> float:
    """Seconds from when a laptop comes, which knows nothing, until it knows what the robots know."""
    field = _Field(robots)
    for _ in range(round(HOUR_S / given.TICK_S)):
        field.go_on()
    laptop = Talk(Logs("", tuple(field.team)), Seal(KEY, WATCHERS[0]))
    field.talks["laptop"], came = laptop, field.tick
    while field.go_on() - laptop.logs.checkpoint() > LEVEL_TICKS:
        pass
    return (field.tick - came) * given.TICK_S
