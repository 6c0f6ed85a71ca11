"""What is around, in a few numbers that somebody may choose: for fields that are emulated."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.errors import ConfigError
from fieldkit.world.air import Air
from fieldkit.world.disturbed import NONE, Disturbances
from fieldkit.world.shadowing import shadow_fields
from fieldkit.world.sources import TransientSource
from fieldkit.world.walls import random_walls

WALL_M, WALL_DB = 5.0, 10.0
HEADINGS = 36
WHOLE = ("walls", "deaf")


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Nothing by default. Picklable."""

    shadow_db: float = 0.0
    """Deviation of shadowing that belongs to places."""
    shadow_m: float = 5.0
    """Its length of correlation."""
    walls: int = 0
    """Of 5 m and 10 dB, anywhere in the field."""
    lobe_db: float = 0.0
    """From front to back of each transmitter's antenna."""
    offset_db: float = 0.0
    """Deviation of what the receivers read too much."""
    deaf: int = 0
    """So many receivers, the last ones, hear nothing."""
    packet_loss: float = 0.0
    """Share of packets lost at any strength."""
    foreign_hz: float = 0.0
    """Packets from somebody far away."""
    collision_s: float = 0.0
    """Packets that begin within this time of each other collide."""
    walk_m_s: float = 0.0
    """Transmitters walk so fast."""
    jump_m: float = 0.0
    """Transmitters are carried so far, once,"""
    jump_s: float = NONE.jump_s
    """after so long."""
    wander_m: float = 0.0
    """Deviation of an error of all positions that wanders within a minute."""

    def air(
        self,
        antenna: Antenna,
        sources: Sequence[TransientSource],
        receivers: int,
        size_m: float,
        seed: int,
    ) -> Air:
        """The channel, drawn anew by `seed`: where walls and shadows are, and how far each receiver is off."""
        rng = np.random.default_rng([seed, 99])
        turn = np.radians(np.arange(HEADINGS) * 360.0 / HEADINGS)
        disturbed = Disturbances(
            walls=random_walls(self.walls, size_m, WALL_M, WALL_DB, rng),
            lobe_db=tuple((0.5 * self.lobe_db * np.cos(turn)).tolist()) if self.lobe_db else (),
            collision_s=self.collision_s,
            foreign_hz=self.foreign_hz,
            insensitive=tuple(range(max(0, receivers - self.deaf), receivers)),
            walk_m_s=self.walk_m_s,
            jump_m=self.jump_m,
            jump_s=self.jump_s,
        )
        shadow = shadow_fields(len(sources), self.shadow_db, self.shadow_m, rng) if self.shadow_db else ()
        offset_db = (self.offset_db * rng.standard_normal(receivers)).tolist() if self.offset_db else []
        return Air(antenna, sources, disturbed, shadow, offset_db, self.packet_loss, size_m=size_m, seed=seed)


NOTHING_AROUND = Surroundings()


def surroundings_of(words: Sequence[str]) -> Surroundings:
    """From NAME=VALUE, each once. Raises `ConfigError`: which word, what was expected."""
    known = [each.name for each in fields(Surroundings)]
    given: dict[str, float] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in known or name in given:
            raise ConfigError(
                f"--with {word}: expected NAME=VALUE, each once, with one of {', '.join(known)}"
            )
        try:
            value = int(text) if name in WHOLE else float(text)
        except ValueError:
            value = math.nan
        limit = 1.0 if name == "packet_loss" else math.inf
        if not (math.isfinite(value) and 0.0 <= value <= limit) or (name == "shadow_m" and value == 0.0):
            what = "whole number" if name in WHOLE else "number"
            least = "over 0" if name == "shadow_m" else "from 0" + (" to 1" if limit == 1.0 else "")
            raise ConfigError(f"--with {word}: expected a {what} {least}, got {text!r}")
        given[name] = value
    return Surroundings(**given)  # type: ignore[arg-type]
