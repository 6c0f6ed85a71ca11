"""The CSMA particle filter as a belief of the engine: for networks whose number of nodes is known or assumed.

The number of sources is the settings' `expected_sources`, rounded: from traffic alone only the product of nodes and
rate can be estimated (`sensing.csma`). One power level, as the paper assumes: the loudest of several is taken.
Strengths are in units of the weakest that is heard. Packets are rare, so collisions get the share that the load gives.
"""

import hashlib
from collections.abc import Sequence

import numpy as np

from fieldkit.engine.belief.particles import ParticleFilter, Strength
from fieldkit.engine.likelihood.csma import busy_collision_probability, packet_shares
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening, SourceEstimate


class CsmaBelief:
    """See the module."""

    def __init__(self, settings: EngineSettings) -> None:
        self.settings = settings
        self.grid = settings.grid
        antenna, tuning = settings.antenna, settings.tuning.paper_beliefs
        sources = max(1, round(settings.expected_sources))
        gain_db = antenna.gain_db(-np.arange(0.0, 360.0, 1.0))  # counter-clockwise here, clockwise there
        power_dbm = antenna.power_at_1m_dbm + max(settings.power_levels_db)
        strength = Strength(
            float(10.0 ** ((power_dbm - antenna.threshold_dbm) / 10.0)),
            antenna.path_loss_exponent,
            np.asarray(10.0 ** (gain_db / 10.0)),
            antenna.sigma_db,
            nearest_m=self.grid.cell_m / 2.0,
        )
        size = (self.grid.size_east_m, self.grid.size_north_m)
        rng = np.random.default_rng([settings.seed, 0xC5A])
        self.filter = ParticleFilter(
            size, sources, strength, rng, tuning.csma_particles, self.grid.cell_m / 2.0
        )
        load = sources * settings.reference_rate_hz * tuning.csma_packet_s
        self._shares = packet_shares(busy_collision_probability(load, tuning.csma_vulnerable), sources)
        self._readings = 0

    def detect(self, detection: Detection) -> None:
        """Each robot that heard it updates the filter in turn; robots hear independently."""
        for index in np.flatnonzero(detection.heard):
            if self.filter.all_found:
                return
            self._readings += 1
            east, north = (float(v) for v in detection.position_m[index])
            theta = float(np.radians(90.0 - detection.heading_deg[index]))
            z = 10.0 ** ((float(detection.rss_dbm[index]) - self.settings.antenna.threshold_dbm) / 10.0)
            self.filter.update((east, north, theta), z, *self._shares)
        place = self.filter.most_probable(self.grid.cell_m)
        if self.filter.probability_near(place, self.grid.cell_m) >= self.settings.found_probability:
            self.filter.identify(place)

    def detect_all(self, detections: Sequence[Detection]) -> None:
        """Take in several, one after another."""
        for detection in detections:
            self.detect(detection)

    def reflect(self) -> bool:
        """Nothing is left to think over."""
        return False

    def listen(self, listening: Listening) -> None:
        """Silence says nothing in this belief."""

    def presence(self) -> FloatArray:
        """(n_north, n_east) probability that the cell holds a source, at most 1."""
        free = (
            np.zeros(self.grid.shape) if self.filter.all_found else self.filter.density(self.grid.shape, 0.0)
        )
        for east, north in self.filter.found:
            free[self.grid.cell_of(east, north)] += 1.0
        return np.minimum(free, 1.0 - 1e-9)

    def activity(self) -> FloatArray:
        """(n_north, n_east), sums to 1: all sources send alike."""
        presence = self.presence()
        return np.asarray(presence / max(float(presence.sum()), 1e-300))

    def most_probable(self) -> tuple[float, float] | None:
        """Where to go: the place at which an unidentified source most probably is; None when all are found."""
        return None if self.filter.all_found else self.filter.most_probable(self.grid.cell_m)

    def sources(self) -> list[SourceEstimate]:
        """The identified ones."""
        cell = self.grid.cell_m
        return [
            SourceEstimate(
                ident=k + 1,
                east_m=east,
                north_m=north,
                cov_m2=np.eye(2) * (cell / 1.645) ** 2,
                region_90=9,
                receptions=self._readings / self.filter.sources,
                rate_hz=float("nan"),
                p_exists=self.settings.found_probability,
                p_here=self.settings.found_probability,
                state="found",
            )
            for k, (east, north) in enumerate(self.filter.found)
        ]

    def probability_left(self) -> float:
        """1 until as many are found as there are said to be: without silence as evidence nothing else is known."""
        return 0.0 if self.filter.all_found else 1.0

    def digest(self) -> bytes:
        """SHA-256 over particles, weights and finds."""
        state = hashlib.sha256(self.filter.place.tobytes())
        state.update(self.filter.weight.tobytes())
        state.update(repr(self.filter.found).encode())
        return state.digest()
