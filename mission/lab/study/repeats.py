"""More readings at the same places: how much sharper a survey may become of them, and how much sharper it says it is.

`fieldkit study repeats`. A transmitter somewhere in a field of `FIELD_M`, `PLACES` places on a walk through it, and
1, 3 or 10 readings at each: the same places, and the same shadow over them, whatever the number. Noise in time
averages out, what belongs to a place does not. The calibration knows the channel; the power is like that of its
transmitters.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import ChannelSpread
from fieldkit.engine.location.one_source import OneSource, Radio, locate
from fieldkit.messages import FloatArray
from fieldkit.world.shadowing import ShadowField
from mission.lab.study.pool import Progress
from mission.lab.study.scenarios import run_scenarios

FIELD_M, PLACES = 30.0, 24
TIME_DB, PLACE_DB, LENGTH_M, POWER_SD_DB = 2.0, 5.0, 4.0, 3.0
RADIO = Antenna(2.5, -45.0, float(np.hypot(TIME_DB, PLACE_DB)), -95.0)
SPREAD = ChannelSpread(
    TIME_DB,
    PLACE_DB,
    LENGTH_M,
    transmitter_db=POWER_SD_DB,
    transmitter_exponent=0.0,
    lobe_db=0.0,
    transmitters=10,
    # What the study's world is drawn from is known, as after a long calibration.
    mean_covariance=((1e-4, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-4)),
    log_covariance=tuple(map(tuple, (1e-4 * np.eye(6)).tolist())),
)


@dataclass(frozen=True, slots=True)
class Scenario:
    """One row."""

    name: str
    readings: int
    """At each place."""


SCENARIOS = tuple(Scenario(f"{n} reading{'s' * (n > 1)} a place", n) for n in (1, 3, 10))


@dataclass(frozen=True, slots=True)
class Job:
    """One trial."""

    scenario: Scenario
    seed: int


def walked(rng: np.random.Generator) -> FloatArray:
    """(PLACES, 2) places a few metres apart, on a way that turns and stays in the field."""
    places, at, heading = [], rng.uniform(0.2, 0.8, 2) * FIELD_M, rng.uniform(0.0, 2.0 * np.pi)
    for _ in range(PLACES):
        places.append(at)
        heading += rng.normal(0.0, 0.7)
        step = 2.5 * np.array([np.sin(heading), np.cos(heading)])
        if not ((at + step > 0.0) & (at + step < FIELD_M)).all():
            heading += np.pi / 2.0
            step = np.zeros(2)
        at = at + step
    return np.array(places)


def trial(job: Job) -> dict[str, Any]:
    """One survey: what it says and what is true. Place, shadow and noise are the same for all numbers of readings."""
    rng = np.random.default_rng([job.seed, 0x8E9])
    source_m, places = rng.uniform(0.0, FIELD_M, 2), walked(rng)
    shadow_db = ShadowField(PLACE_DB, LENGTH_M, rng).at(places)
    power_db = rng.normal(0.0, POWER_SD_DB)
    noise_db = rng.normal(0.0, TIME_DB, (PLACES, max(each.readings for each in SCENARIOS)))
    away_m = np.maximum(np.hypot(*(places - source_m).T), 0.1)
    level = RADIO.mean_rss_dbm(away_m) + power_db + shadow_db
    readings = np.round(level[:, None] + noise_db[:, : job.scenario.readings])
    at = np.column_stack([places, np.zeros(PLACES)])
    source = OneSource(np.repeat(at, job.scenario.readings, axis=0), readings.ravel())
    posterior = locate(source, Radio(RADIO, SPREAD), (0.0, 0.0, FIELD_M, FIELD_M)).posterior
    return {
        "error_m": float(np.hypot(*(posterior.centre_m() - source_m))),
        "sigma_m": float(np.sqrt(np.trace(posterior.cov_m2))),
        "covered_50": posterior.holds(source_m, 0.5),
        "covered_90": posterior.holds(source_m, 0.9),
    }


def summarise(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one number of readings: `stated_m` and `rms_error_m` are alike where a survey is honest."""
    error, sigma = (np.array([row[name] for row in rows]) for name in ("error_m", "sigma_m"))
    return {
        "surveys": len(rows),
        "covered_50": float(np.mean([row["covered_50"] for row in rows])),
        "covered_90": float(np.mean([row["covered_90"] for row in rows])),
        "median_error_m": float(np.median(error)),
        "rms_error_m": float(np.sqrt(np.mean(error**2))),
        "stated_m": float(np.sqrt(np.mean(sigma**2))),
    }


def run(trials: int, seed: int, progress: Progress, *, only: str = "", **how: Any) -> dict[str, Any]:
    """All numbers of readings, `trials` surveys each from `seed` on."""
    return run_scenarios(
        "repeats", SCENARIOS, Job, trial, summarise, trials, seed, progress, only=only, **how
    )
