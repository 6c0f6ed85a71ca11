"""Agents and the operator's computer killed at any time, in virtual time: who goes on, who holds, what is lost.

A trial is short and its mission light (a random walk, a coarse grid): what is looked at is what agents know and agree
on, not what they find. An agent that comes back has its journal, or has lost it and gets its log from the others.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.engine.decentralised.logs import TICK_NS, Logs
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.decentralised.sealing import Seal
from fieldkit.engine.decentralised.talk import OPERATOR, Talk
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Operator
from fieldkit.settings import AGENT_ABSENT_S
from fieldkit.world.network import Air
from fieldkit.world.sources import TransientSource
from mission.core.kernel_settings import KernelSettings
from mission.lab.flock import Flock
from mission.lab.simulate import Truth
from mission.safety.limits import SafetySettings

NAMES = ("r0", "r1", "r2", "r3")
LAPTOP = "laptop"
SIDE_M = 10.0
AIR = Air(loss=0.1)
CONTACT_M = 6.0
EARLIEST_S, LATEST_S = 20.0, 80.0
"""Between these times somebody is killed."""
AWAY_S = (5.0, 60.0)
"""One that comes back does so after a time between these."""
AFTER_S = 60.0
"""So long is looked on after the kill, or after the return."""
CATCHES_UP = 10.0
"""One that was away gets level again so many times as fast as time passed, at least."""
KEPT_BEFORE_S = 1.0
"""Observations older than this at the kill must be with somebody."""
ROLLS_M = 0.3
"""A robot that was stopped rolls on less than this."""
MOVED_M = 0.5
"""Robots that go on drive further than this in `AFTER_S`."""
LEVEL_TICKS = 4
"""Horizons of agents in contact differ by less."""


@dataclass(frozen=True, slots=True)
class Kill:
    """What happens in a trial."""

    victim: str
    at_s: float
    away_s: float
    """Infinite: it does not come back."""
    keeps_journal: bool


def drawn(seed: int) -> Kill:
    """By chance: the victim, the time, whether and when it is back, and what of its disk is."""
    rng = np.random.default_rng([seed, 0xDEAD])
    victim = str(rng.choice((*NAMES, LAPTOP)))
    at_s, away_s = float(rng.uniform(EARLIEST_S, LATEST_S)), float(rng.uniform(*AWAY_S))
    is_back, keeps = rng.random(2) < 0.5
    return Kill(victim, at_s, away_s if is_back else math.inf, bool(keeps))


def light_flock(seed: int) -> Flock:
    """Four robots that walk at random on a coarse grid."""
    antenna = Antenna(2.5, -60.0, 3.3, -75.0)
    engine = EngineSettings(
        Grid(SIDE_M, SIDE_M, 1.0), antenna, (NAMES[:2], NAMES[2:]), min_separation_m=0.5, seed=seed
    )  # fmt: skip
    kernel = KernelSettings(engine, belief="spog", planner="random-walk", max_duration_s=1e6)
    safety = SafetySettings(NAMES, SIDE_M, SIDE_M, min_separation_m=0.5)
    sources = (TransientSource(3.0, 6.0, 0.0, 0.5), TransientSource(8.0, 4.0, 0.0, 0.5))
    truth = Truth(antenna, sources, ((2.0, 1.0), (3.5, 1.0), (6.5, 1.0), (8.0, 1.0)))
    return Flock(kernel, safety, truth, AIR, seed, contact_m=CONTACT_M)


def trial(seed: int, away_s: float | None = None) -> dict[str, Any]:
    """One kill: by chance, or of an agent that comes back with its journal after `away_s`."""
    kill = drawn(seed) if away_s is None else Kill(NAMES[1], EARLIEST_S, away_s, True)
    flock = light_flock(seed)
    flock.begin()
    _until(flock, kill.at_s)
    row = {
        "seed": seed,
        "victim": kill.victim,
        "back": math.isfinite(kill.away_s),
        "journal": kill.keeps_journal,
    }
    row |= _laptop_killed(flock) if kill.victim == LAPTOP else _agent_killed(flock, kill)
    return row | {"same": flock.agrees(), "compared": len(flock.seen)}


def _until(flock: Flock, t_s: float) -> None:
    while flock.world.t_s < t_s:
        flock.step()


def _agent_killed(flock: Flock, kill: Kill) -> dict[str, Any]:
    victim, at_ns = kill.victim, flock.now_ns(kill.victim)
    place_m, before = _place_m(flock, victim), flock.agents[victim].logs
    known = {
        key: sum(entry.order_ns <= at_ns - KEPT_BEFORE_S * 1e9 for entry in before.entries[key])
        for key in Logs.keys((victim,))
    }
    flock.kill(victim)
    rejoined_s: float | None = None
    if math.isfinite(kill.away_s):
        _until(flock, flock.world.t_s + kill.away_s)
        rolled_m, back_s = math.dist(place_m, _place_m(flock, victim)), flock.world.t_s
        flock.revive(victim, with_journal=kill.keeps_journal)
        until_s = back_s + AFTER_S + kill.away_s / CATCHES_UP
        moved_m = _moved_m(flock, victim, until_s, lambda: _is_level(flock, victim))
        rejoined_s = None if moved_m[1] is None else moved_m[1] - back_s
    else:
        _until(flock, flock.world.t_s + AGENT_ABSENT_S)
        moved_m = _moved_m(flock, victim, flock.world.t_s + AFTER_S, lambda: False)
        rolled_m = math.dist(place_m, _place_m(flock, victim))
    others = [agent.logs for name, agent in flock.agents.items() if name != victim]
    lacking = sum(max(0, count - max(len(o.entries[key]) for o in others)) for key, count in known.items())
    return {
        "goes_on": moved_m[0] > MOVED_M,
        "holds": rolled_m <= ROLLS_M,
        "rejoined_s": rejoined_s,
        "unknown_to_others": lacking,
    }


def _moved_m(flock: Flock, but: str, until_s: float, comes: Any) -> tuple[float, float | None]:
    """The furthest that another robot has come from its place, and when `comes` was first true."""
    starts, furthest_m, came_s = {name: _place_m(flock, name) for name in NAMES if name != but}, 0.0, None
    while flock.world.t_s < until_s:
        flock.step()
        furthest_m = max(furthest_m, *(math.dist(place, _place_m(flock, n)) for n, place in starts.items()))
        if came_s is None and comes():
            came_s = flock.world.t_s
    return furthest_m, came_s


def _is_level(flock: Flock, victim: str) -> bool:
    """Whether it acts on the common line, and that is where the others' is."""
    mine, ticks = flock.agents[victim], [agent.common.horizon for agent in flock.agents.values()]
    is_common = mine.line is mine.common and not mine.talk.lost
    is_present = min(ticks) > flock.now_ns(victim) // TICK_NS - 2 * LEVEL_TICKS
    return is_common and is_present and max(ticks) - min(ticks) < LEVEL_TICKS


def _laptop_killed(flock: Flock) -> dict[str, Any]:
    """It has said HOLD ALL once, to one robot, and is gone. All hold, until an operator at a robot lets them go on."""
    laptop = Talk(Logs(NAMES[0], NAMES), Seal(flock.key, OPERATOR))
    now_ns = flock.now_ns(NAMES[0])
    order = quantised(Operator(now_ns, "hold", None, "HOLD ALL"))
    assert isinstance(order, Operator)
    flock.hear(NAMES[0], laptop.say_order(order, now_ns))
    said_s, held_s = flock.world.t_s, None
    while flock.world.t_s < said_s + AFTER_S:
        flock.step()
        if held_s is None and all(safety.robots[n].ordered == "hold" for n, safety in flock.safety.items()):
            held_s = flock.world.t_s - said_s
    flock.order(NAMES[-1], "resume")
    furthest_m, _ = _moved_m(flock, "", flock.world.t_s + AFTER_S, lambda: False)
    return {
        "goes_on": furthest_m > MOVED_M,
        "holds": held_s is not None,
        "held_s": held_s,
        "unknown_to_others": 0,
    }


def _place_m(flock: Flock, name: str) -> tuple[float, float]:
    rover = flock.world.rovers[name]
    return rover.east_m, rover.north_m


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """How often what has to be was."""
    back = [row for row in rows if row["back"] and row["victim"] != LAPTOP]
    rejoined = [row["rejoined_s"] for row in back if row["rejoined_s"] is not None]
    held = [row["held_s"] for row in rows if row.get("held_s") is not None]
    return {
        "trials": len(rows),
        "others_go_on": sum(row["goes_on"] for row in rows),
        "robot_holds": sum(row["holds"] for row in rows),
        "came_back": len(back),
        "rejoined": len(rejoined),
        "rejoined_within_s": max(rejoined, default=None),
        "without_journal": sum(not row["journal"] for row in back),
        "laptop_killed": sum(row["victim"] == LAPTOP for row in rows),
        "all_held_within_s": max(held, default=None),
        "unknown_to_others": sum(row["unknown_to_others"] for row in rows),
        "same_belief": all(row["same"] for row in rows),
        "beliefs_compared": sum(row["compared"] for row in rows),
    }
