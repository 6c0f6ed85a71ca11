"""What else may be wrong in the simulated world, all seeded: collisions, interference, dead radios, moving sources.

Off by default, each by itself; `Truth.disturbed` of a simulated mission has one of these.
"""

from dataclasses import dataclass

import numpy as np

from fieldkit.messages import FloatArray
from fieldkit.world.walls import Wall

CAPTURE_DB = 6.0
"""A packet so much stronger than the one it collides with is received all the same (capture effect)."""


@dataclass(frozen=True, slots=True)
class Disturbances:
    """Deviations from the ideal world."""

    walls: tuple[Wall, ...] = ()
    lobe_db: tuple[float, ...] = ()
    """Gain of every transmitter by heading from its front, evenly spaced; each points somewhere else."""
    collision_s: float = 0.0
    """Packets that begin within this time of each other collide at receivers that hear both."""
    foreign_hz: float = 0.0
    """Packets from somebody far away, heard at random strength by one robot."""
    foreign_robots: int = 1
    """... or by so many robots at once."""
    insensitive: tuple[int, ...] = ()
    """Robots, by their number in the teams, that hear nothing though they say that they listen."""
    walk_m_s: float = 0.0
    """Transmitters walk so fast, each straight in a direction of its own, back from the border."""
    jump_m: float = 0.0
    """Transmitters are carried so far, once."""
    jump_s: float = 300.0
    """When."""


NONE = Disturbances()


def place_at(
    source_m: tuple[float, float], number: int, t_s: float, size_m: float, what: Disturbances, seed: int
) -> tuple[float, float]:
    """Where a transmitter is at a time: where it was put, unless it walks or is carried."""
    if what.walk_m_s == 0.0 and (what.jump_m == 0.0 or t_s < what.jump_s):
        return source_m
    angle = np.random.default_rng([seed, 5, number]).uniform(0.0, 2.0 * np.pi)
    way_m = what.walk_m_s * t_s + (what.jump_m if t_s >= what.jump_s else 0.0)
    gone = np.array(source_m) + way_m * np.array([np.sin(angle), np.cos(angle)])
    reflected = np.abs((gone + size_m) % (2.0 * size_m) - size_m)  # at every border
    return float(reflected[0]), float(reflected[1])


def lobe_gain_db(what: Disturbances, number: int, way_m: FloatArray, seed: int) -> FloatArray:
    """(m,) a transmitter's gain towards robots that lie `way_m` (m, 2) from it."""
    if not what.lobe_db:
        return np.zeros(way_m.shape[0])
    front_deg = np.random.default_rng([seed, 6, number]).uniform(0.0, 360.0)
    heading = np.degrees(np.arctan2(way_m[:, 0], way_m[:, 1])) - front_deg
    at = np.arange(len(what.lobe_db)) * 360.0 / len(what.lobe_db)
    return np.asarray(np.interp(heading, at, what.lobe_db, period=360.0))


def collided(
    rss_dbm: FloatArray, before_dbm: FloatArray | None, apart_s: float, what: Disturbances
) -> FloatArray:
    """(m,) readings that survive a packet `apart_s` earlier: nan where neither captures the receiver."""
    if before_dbm is None or what.collision_s <= 0.0 or apart_s > what.collision_s:
        return rss_dbm
    weaker = ~np.isnan(before_dbm) & ~(rss_dbm >= before_dbm + CAPTURE_DB)
    return np.where(weaker, np.nan, rss_dbm)
