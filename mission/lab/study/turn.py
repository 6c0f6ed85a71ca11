"""A bearing by turning round once: how many turns give one, and how often it is off by no more than it says.

A person turns on the spot and hears one transmitter `READINGS` times at headings all round; the body takes so many
decibels behind, and each reading has `NOISE_DB`. Readings are whole decibels, as radios print them.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from fieldkit.channel.turn import bearing_of
from fieldkit.world.walker import body_loss_db

READINGS = 16
NOISE_DB = 4.0
BEHIND_DB = (0.0, 8.0, 12.0, 20.0)
HEADING_SIGMA_DEG = 5.0
"""Of a phone's compass in the hand."""


def turn(rng: np.random.Generator, bearing_deg: float, behind_db: float) -> tuple[list[float], list[float]]:
    """Headings and levels of one turn; headings as the compass says them."""
    heading = (np.arange(READINGS) * 360.0 / READINGS + rng.uniform(0.0, 360.0)) % 360.0
    level = -70.0 - body_loss_db(bearing_deg - heading, behind_db) + rng.normal(0.0, NOISE_DB, READINGS)
    said = (heading + rng.normal(0.0, HEADING_SIGMA_DEG, READINGS)) % 360.0
    return said.tolist(), np.round(level).tolist()


def run(trials: int, seed: int, on_progress: Callable[[float, str], None]) -> dict[str, Any]:
    """JSON: {"scenarios": {decibels behind: {"n", "with_bearing", "covers", "off_median_deg", "says_median_deg"}}}."""
    scenarios = {}
    for number, behind_db in enumerate(BEHIND_DB):
        on_progress(number / len(BEHIND_DB), f"{behind_db:g} dB behind")
        rng = np.random.default_rng([seed, 0x7084, number])
        scenarios[f"{behind_db:g} dB"] = _summary([_trial(rng, behind_db) for _ in range(trials)])
    on_progress(1.0, "done")
    return {"study": "turn", "trials": trials, "scenarios": scenarios}


def _trial(rng: np.random.Generator, behind_db: float) -> tuple[float, float] | None:
    """How far the bearing is off and how far it says it may be (90 %); None where it says that there is none."""
    true_deg = float(rng.uniform(0.0, 360.0))
    found = bearing_of(*turn(rng, true_deg, behind_db))
    if found.why:
        return None
    return abs((found.bearing_deg - true_deg + 180.0) % 360.0 - 180.0), found.error_90_deg


def _summary(trials: list[tuple[float, float] | None]) -> dict[str, Any]:
    given = np.array([each for each in trials if each is not None]).reshape(-1, 2)
    some = len(given) > 0
    return {
        "n": len(trials),
        "with_bearing": round(len(given) / len(trials), 3),
        "covers": round(float(np.mean(given[:, 0] <= given[:, 1])), 3) if some else None,
        "off_median_deg": round(float(np.median(given[:, 0])), 1) if some else None,
        "says_median_deg": round(float(np.median(given[:, 1])), 1) if some else None,
    }
