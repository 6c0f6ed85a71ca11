"""The channel between transmitters and receivers, with all that a world adds to the law of distance.

One for missions that are simulated, fields that are emulated, and radios that are given to real vehicles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.messages import FloatArray
from fieldkit.world.channel import sample_rss_dbm
from fieldkit.world.disturbed import NONE, Disturbances, collided, lobe_gain_db, place_at
from fieldkit.world.shadowing import ShadowField
from fieldkit.world.sources import TransientSource
from fieldkit.world.walls import walls_loss_db


@dataclass(eq=False)
class Air:
    """Remembers the last packet, with which the next may collide. m receivers, always in the same order."""

    antenna: Antenna
    sources: Sequence[TransientSource]
    disturbed: Disturbances = NONE
    shadow: Sequence[ShadowField] = ()
    """One for each source, or none."""
    offset_db: Sequence[float] = ()
    """Of each receiver, or none."""
    packet_loss: float = 0.0
    elevation: float = 0.0
    source_up_m: float = 0.0
    size_m: float = 1.0
    """Side of the field, within which transmitters move."""
    seed: int = 0
    _last: tuple[float, FloatArray] | None = field(default=None, init=False)

    def source_m(self, number: int, at_s: float) -> FloatArray:
        """(2,) where a transmitter is at a time."""
        source = self.sources[number]
        here = source.east_m, source.north_m
        return np.array(place_at(here, number, at_s, self.size_m, self.disturbed, self.seed))

    def heard_dbm(
        self,
        number: int,
        at_s: float,
        place_m: FloatArray,
        up_m: FloatArray,
        heading_deg: FloatArray,
        rng: np.random.Generator,
    ) -> FloatArray:
        """(m,) what receivers at `place_m` (m, 2) and heights `up_m` (m,) read of a packet; nan where nothing.

        They point to `heading_deg` (m,). `rng` draws the noise.
        """
        what = self.disturbed
        source_m = self.source_m(number, at_s)
        way = source_m - place_m
        off_front = np.degrees(np.arctan2(way[:, 0], way[:, 1])) - heading_deg
        more = lobe_gain_db(what, number, -way, self.seed) - walls_loss_db(source_m, place_m, what.walls)
        if self.shadow:
            more = more + self.shadow[number].at(place_m)
        if len(self.offset_db):
            more = more + np.array(self.offset_db)
        flat_m, higher_m = np.hypot(*way.T), up_m - self.source_up_m
        range_m = np.hypot(flat_m, higher_m)
        if self.elevation:
            cos = np.where(higher_m != 0.0, np.maximum(flat_m / np.maximum(range_m, 1e-9), 0.1), 1.0)
            more = more + self.elevation * 20.0 * np.log10(cos)
        rss = sample_rss_dbm(self.antenna, range_m, self.sources[number].power_db + more, rng, off_front)
        if self.packet_loss > 0.0:
            rss = np.where(rng.random(rss.shape) < self.packet_loss, np.nan, rss)
        rss[list(what.insensitive)] = np.nan
        before, self._last = self._last, (at_s, rss)
        return collided(rss, before and before[1], at_s - before[0] if before else 0.0, what)

    def foreign(self, during_s: float, receivers: int, rng: np.random.Generator) -> list[tuple[int, float]]:
        """Who hears a packet of somebody far away within a short time, and at which strength above the threshold."""
        what = self.disturbed
        if what.foreign_hz <= 0.0 or rng.random() >= what.foreign_hz * during_s:
            return []
        by = rng.choice(receivers, size=min(what.foreign_robots, receivers), replace=False)
        level = np.floor(self.antenna.threshold_dbm + 1.0 + rng.exponential(6.0, by.size))
        return list(zip(by.tolist(), level.tolist(), strict=True))
