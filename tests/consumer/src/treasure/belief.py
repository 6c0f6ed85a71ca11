"""A belief in exactly one source: log-likelihood of every reading and of every silence, over the grid.

It also says what there is to learn, so that the planner `infogain` can use it.
"""

import hashlib
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

import fieldkit
from fieldkit.messages import Detection, Listening, SourceEstimate

Array = NDArray[np.float64]
STEPS = 400


class Hearing:
    """P(heard) by squared distance, for the calibrated power alone."""

    def __init__(self, settings: fieldkit.EngineSettings) -> None:
        antenna = settings.antenna
        reach_m = 3.0 * float(antenna.nominal_range_m())
        self.step2_m2 = reach_m**2 / STEPS
        distance_m = np.sqrt((np.arange(STEPS + 2) + 0.5) * self.step2_m2)
        margin = (antenna.mean_rss_dbm(distance_m) - antenna.threshold_dbm) / antenna.sigma_db
        heard = 0.5 * (1.0 + np.array([math.erf(m / math.sqrt(2.0)) for m in margin]))
        self.hear: Array = np.ascontiguousarray(heard[None, :])
        self.hear_known_mean: Array = np.ascontiguousarray(heard)
        self.search_reach_m = reach_m


class OneSource:
    """See the module."""

    def __init__(self, settings: fieldkit.EngineSettings) -> None:
        self.settings = settings
        self.grid = settings.grid
        self.model = Hearing(settings)
        self._log: Array = np.zeros(self.grid.n_cells)
        self._exposure_s: Array = np.zeros(self.grid.n_cells)
        self._receptions = 0

    @property
    def exposure_s(self) -> Array:
        return self._exposure_s.reshape(1, *self.grid.shape)

    def detect(self, detection: Detection) -> None:
        antenna = self.settings.antenna
        for place_m, rss_dbm in zip(detection.position_m, detection.rss_dbm, strict=True):
            distance_m = np.hypot(*(self.grid.centres_m - place_m).T)
            if math.isnan(rss_dbm):
                self._log += np.log(1.0 - 0.99 * self._hears(distance_m))
            else:
                self._log -= (
                    0.5 * ((rss_dbm - antenna.mean_rss_dbm(distance_m)) / (2.0 * antenna.sigma_db)) ** 2
                )
        self._receptions += 1

    def detect_all(self, detections: Sequence[Detection]) -> None:
        for detection in detections:
            self.detect(detection)

    def reflect(self) -> bool:
        return False

    def listen(self, listening: Listening) -> None:
        for place_m in listening.position_m:
            distance_m = np.hypot(*(self.grid.centres_m - place_m).T)
            self._exposure_s += listening.duration_s * self._hears(distance_m)

    def _hears(self, distance_m: Array) -> Array:
        index = np.minimum(distance_m**2 / self.model.step2_m2, STEPS).astype(int)
        return np.asarray(self.model.hear[0][index])

    def _posterior(self) -> Array:
        weight = self._log - self.settings.reference_rate_hz * self._exposure_s
        p = np.exp(weight - weight.max())
        return np.asarray(p / p.sum())

    def presence(self) -> Array:
        return self._posterior().reshape(self.grid.shape)

    def activity(self) -> Array:
        return self.presence()

    def sources(self) -> list[SourceEstimate]:
        if not self._receptions:
            return []
        p = self._posterior()
        mean_m = p @ self.grid.centres_m
        apart_m = self.grid.centres_m - mean_m
        p_here = float(p[np.abs(apart_m).max(axis=1) <= self.grid.cell_m].sum())
        found = p_here >= self.settings.found_probability and self._receptions >= self.settings.min_receptions
        order = np.cumsum(np.sort(p)[::-1])
        return [
            SourceEstimate(
                ident=1,
                east_m=float(mean_m[0]),
                north_m=float(mean_m[1]),
                cov_m2=(apart_m * p[:, None]).T @ apart_m,
                region_90=int(np.searchsorted(order, 0.9)) + 1,
                receptions=float(self._receptions),
                rate_hz=self.settings.reference_rate_hz,
                p_exists=1.0,
                p_here=p_here,
                state="found" if found else "candidate",
            )
        ]

    def probability_left(self) -> float:
        return 0.0 if any(source.state == "found" for source in self.sources()) else 1.0

    def digest(self) -> bytes:
        return hashlib.sha256(self._log.tobytes() + self._exposure_s.tobytes()).digest()

    def ground_value(self) -> Array:
        return self.presence()

    def unresolved(self, samples: int, rng: np.random.Generator) -> list[fieldkit.Unresolved]:
        result = []
        for source in self.sources():
            if source.state == "found":
                continue
            cells = rng.choice(self.grid.n_cells, size=samples, p=self._posterior())
            result.append(
                fieldkit.Unresolved(
                    ident=source.ident,
                    points_m=self.grid.centres_m[cells],
                    level=np.zeros(samples),
                    cov_m2=source.cov_m2,
                    rate_hz=source.rate_hz,
                    receptions=source.receptions,
                    p_here=source.p_here,
                    state=source.state,
                    may_be_two=False,
                )
            )
        return result


def _checked(settings: fieldkit.EngineSettings) -> fieldkit.InformativeBelief:
    """For the type checker: this is a belief that `infogain` takes."""
    return OneSource(settings)
