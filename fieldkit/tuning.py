"""The numbers that belief and planners are tuned by, in one place, each with what it means and where it comes from.

A mission that says nothing takes these. `[tuning.TABLE]` in mission.toml sets one anew, and so does
`--set tuning.TABLE.KEY=VALUE` in a what-if. A recording's header keeps all of them, so that it replays the same after
a later version has chosen otherwise. Tolerances of arithmetic stand beside their loops.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from fieldkit.settings import Quantity

PAPER_RWA = "RWA paper, section VII.C"
PAPER_PRWA = "PRWA paper"
PAPER_DPRWA = "DPRWA paper, section VI"
HAND = "by hand while the trust study was made; not varied since"
FACTORIAL = "factorial of 160 simulated missions with eight sources"
MEMORY = "bounds time and memory"
CHECKS = "missions whose sources are moved, against the time until all is found (docs/studies/world.md)"
PLANNERS = "missions of one pair over one source, then pairs of missions (study planners)"
RADIO = "readings of XBee and 802.15.4 radios in the field logs"


def tuned(
    default: float | int | tuple[float, ...], low: float, high: float, unit: str, meaning: str, source: str
) -> Any:
    """A field of a table: its default, bounds (inclusive; of each, where there are several), unit, meaning, source."""
    first = default[0] if isinstance(default, tuple) else default
    return field(
        default=default,
        metadata={"quantity": Quantity(float(first), low, high, unit, meaning), "source": source},
    )


@dataclass(frozen=True, slots=True)
class _Table:
    def __post_init__(self) -> None:
        for each in fields(self):
            value, quantity = getattr(self, each.name), each.metadata["quantity"]
            values = value if isinstance(value, tuple) else (value,)
            for one in values:
                if not (math.isfinite(one) and quantity.low <= one <= quantity.high):
                    raise ValueError(
                        f"{each.name}: expected a number from {quantity.low:g} to {quantity.high:g}, got {one}"
                    )
            if isinstance(each.default, int) and value != int(value):
                raise ValueError(f"{each.name}: expected a whole number, got {value}")


@dataclass(frozen=True, slots=True)
class LikelihoodTuning(_Table):
    """What a radio may do besides what the antenna file says."""

    packet_loss: float = tuned(0.02, 0.0, 0.5, "", "packets lost at any strength", RADIO)
    outliers: float = tuned(0.02, 1e-6, 0.5, "", "readings that scatter wider than the others", RADIO)
    outlier_width: float = tuned(2.5, 1.0, 20.0, "", "how many times as wide they scatter", RADIO)
    outside_db: tuple[float, ...] = tuned(
        (4.0, 8.0, 12.0),
        0.5,
        60.0,
        "dB",
        "how far outside the known powers hypotheses of a wrong set lie",
        HAND,
    )
    prior_outside: float = tuned(
        0.04, 1e-6, 0.5, "", "prior probability of a power outside the known ones", HAND
    )
    prior_varying: float = tuned(0.1, 1e-6, 0.5, "", "prior probability of a power that varies", HAND)


@dataclass(frozen=True, slots=True)
class IntensityTuning(_Table):
    """Belief `intensity`: candidates, and who sent what."""

    rate_shape: float = tuned(
        1.0, 0.1, 20.0, "", "shape of the Gamma prior of rates: 1 spreads as wide as its mean", HAND
    )
    clutter_hz: float = tuned(
        2e-4, 1e-8, 1.0, "Hz", "prior rate of detections that come from no source", HAND
    )
    max_open: int = tuned(300, 20, 100_000, "", "detections kept open; older ones are marginalised", MEMORY)
    kept_mb: int = tuned(
        256,
        8,
        100_000,
        "MB",
        "likelihoods kept of open detections; beyond it older ones are marginalised",
        MEMORY,
    )
    fine_cells: float = tuned(0.5, 0.5, 0.5, "cell", "spacing of a candidate's points", HAND)
    refine_points: int = tuned(
        300, 12, 100_000, "", "points from which on a candidate gets four for each of its own", MEMORY
    )
    blurred_points: int = tuned(
        100, 12, 100_000, "", "the same where its points are nearer together than hearing is sharp", MEMORY
    )
    ground_cells: int = tuned(
        6_000,
        100,
        4_000_000,
        "",
        "cells of field and surroundings, where the field has not half as many",
        MEMORY,
    )
    most_points: int = tuned(
        2_600, 100, 1_000_000, "", "points of a candidate; one on more ground has them further apart", MEMORY
    )
    compared_points: int = tuned(
        1_000, 100, 1_000_000, "", "points on which one source and two are compared", MEMORY
    )
    sweeps: int = tuned(3, 1, 50, "", "passes over the open detections at each new one", HAND)
    claimed: float = tuned(
        0.5, 0.05, 0.95, "", "responsibility from which a detection is a candidate's own", HAND
    )
    birth_odds: float = tuned(
        1.5, 0.1, 100.0, "", "expected further sources at which one is given a candidate", HAND
    )
    again_odds: float = tuned(
        3.0, 1.0, 1e6, "", "times the odds at which a candidate that did not last is tried again", HAND
    )
    death_receptions: float = tuned(0.3, 0.0, 3.0, "", "receptions under which a candidate is pruned", HAND)
    negligible_nats: float = tuned(
        20.0, 5.0, 200.0, "nat", "points so far under the best are dropped", MEMORY
    )
    fewest_points: int = tuned(12, 4, 10_000, "", "points kept, however certain the place", HAND)
    withdraw: float = tuned(
        0.75, 0.1, 1.0, "", "a find is withdrawn under this share of found_probability", HAND
    )
    look_outside: float = tuned(
        0.1, 0.0, 1.0, "", "a source outside the field is looked at while it is so probably inside", HAND
    )
    slowest: float = tuned(
        0.5, 0.01, 1.0, "", "slowest senders that `probability_left` is for, in reference rates", HAND
    )
    silent_odds: float = tuned(
        0.01, 1e-6, 0.5, "", "a source whose silence is less probable by chance has gone silent", HAND
    )
    surely_silent: float = tuned(
        0.9, 0.5, 1.0, "", "and so has one that has so probably ended or moved since", CHECKS
    )
    change_s: float = tuned(
        3_600.0, 1.0, 1e9, "s", "mean time until a source ends or is moved; how soon finds are doubted", HAND
    )
    doubted: float = tuned(
        0.05, 0.001, 0.5, "", "a find that has so probably ended or moved is listened to again", HAND
    )
    settled: float = tuned(0.995, 0.5, 1.0, "", "a find so certain needs no further look", HAND)
    max_squared_residual: float = tuned(
        2.5, 1.0, 100.0, "", "mean squared standardised residual that says: inconsistent with the model", HAND
    )
    residuals_trusted: int = tuned(
        50, 0, 100_000, "", "residuals as the antenna file says that a mission begins with", HAND
    )
    wider_said: float = tuned(
        1.4, 1.0, 100.0, "", "mean squared standardised residual from which the operator is told of it", HAND
    )
    judged_on: int = tuned(25, 3, 1_000, "", "last detections of which residuals are looked at", HAND)
    first_look: float = tuned(
        5.0, 2.0, 100.0, "", "receptions at which a candidate's hypothesis is first re-estimated", HAND
    )
    undecided_nats: float = tuned(
        -3.0,
        -50.0,
        0.0,
        "nat",
        "evidence of two sources over one from which somebody has to go and see",
        HAND,
    )
    clear_nats: float = tuned(
        -10.0, -100.0, 0.0, "nat", "the same under which nobody need look until receptions have doubled", HAND
    )
    better_nats: float = tuned(
        1.0, 0.0, 50.0, "nat", "evidence by which another hypothesis must be better", HAND
    )
    place_rounds: int = tuned(6, 1, 100, "", "turns in which one of two places is chosen anew", HAND)
    re_estimated_from: int = tuned(30, 5, 1_000, "", "detections a re-estimate is made from", FACTORIAL)
    re_estimated_cells: float = tuned(
        12.0, 2.0, 1_000.0, "cell", "how far beyond where a candidate may be its source is sought", HAND
    )


@dataclass(frozen=True, slots=True)
class PaperBeliefTuning(_Table):
    """Beliefs `spog` and `csma`."""

    dirichlet_alpha: float = tuned(5.0, 0.01, 1_000.0, "", "prior weight of rule `dirichlet`", HAND)
    em_sweeps: int = tuned(5, 1, 100, "", "passes of rule `em`", HAND)
    max_events: int = tuned(
        2_000, 10, 1_000_000, "", "events `em` re-attributes; older ones keep their attribution", MEMORY
    )
    csma_packet_s: float = tuned(
        0.005, 1e-5, 1.0, "s", "length of a packet", "802.15.4: 133 bytes at 250 kbit/s take 4.3 ms"
    )
    csma_vulnerable: float = tuned(
        0.02, 0.0, 2.0, "", "time in which packets collide, in packet lengths", "CSMA paper, figure 7"
    )
    csma_particles: int = tuned(5_000, 10, 1_000_000, "", "particles", "CSMA paper")


@dataclass(frozen=True, slots=True)
class InfogainTuning(_Table):
    """Planner `infogain`: which paths it compares, and by which reward."""

    horizon_s: float = tuned(45.0, 1.0, 3_600.0, "s", "how far ahead paths are judged", HAND)
    step_s: float = tuned(1.5, 0.1, 60.0, "s", "time between the points of a path that are weighed", MEMORY)
    ground_paths: int = tuned(60, 2, 10_000, "", "paths over unsearched ground", MEMORY)
    paths_per_candidate: int = tuned(40, 1, 1_000, "", "paths round each candidate", PLANNERS)
    budget: int = tuned(
        0,
        0,
        100_000,
        "",
        "paths that local search values beside the first ones; 0: it is left out",
        PLANNERS,
    )
    max_candidates: int = tuned(6, 1, 1_000, "", "nearest candidates that get paths", MEMORY)
    most_legs: int = tuned(8, 2, 100, "", "legs of a path", MEMORY)
    samples: int = tuned(16, 2, 1_000, "", "samples of where a candidate may be", MEMORY)
    spacings: tuple[float, ...] = tuned(
        (0.6, 1.3, 2.0), 0.01, 10.0, "range", "how far abreast teams search, in typical ranges", FACTORIAL
    )
    ground_value: float = tuned(1.0, 0.0, 1_000.0, "", "of a source newly heard", HAND)
    ground_block: float = tuned(
        0.4, 0.05, 10.0, "range", "side of the squares in which ground is weighed, in shortest ranges", MEMORY
    )
    ground_rate: float = tuned(
        0.25, 0.01, 10.0, "", "rate of sources not yet heard, in reference rates", FACTORIAL
    )
    resolve_value: float = tuned(4.0, 0.0, 1_000.0, "", "of a candidate's place made certain", PLANNERS)
    reception_value: float = tuned(3.0, 0.0, 1_000.0, "", "of its receptions", PLANNERS)
    target_cells: float = tuned(0.3, 0.01, 100.0, "cell", "standard deviation that is aimed at", PLANNERS)
    settled_cells: float = tuned(
        0.25, 0.01, 100.0, "cell", "the same of a find that is looked at again", HAND
    )
    settle_value: float = tuned(
        8.0,
        0.0,
        1_000.0,
        "",
        "of a find's place made certain, times the probability that it is off",
        FACTORIAL,
    )
    check_value: float = tuned(
        0.05, 0.0, 1_000.0, "", "of listening again to a find that may have ended or moved", CHECKS
    )
    check_left: float = tuned(
        1.0,
        0.001,
        100.0,
        "",
        "expected sources on the ground at which that is worth 1/e of it: search comes first",
        CHECKS,
    )
    inconsistent_value: float = tuned(
        0.3, 0.0, 10.0, "", "of readings that the model does not explain, against others", HAND
    )


@dataclass(frozen=True, slots=True)
class Infogain1Tuning(InfogainTuning):
    """Planner `infogain1`, the default of before: which paths it compares, and by which reward."""

    paths_per_candidate: int = tuned(16, 1, 1_000, "", "paths round each candidate", MEMORY)
    resolve_value: float = tuned(2.0, 0.0, 1_000.0, "", "of a candidate's place made certain", HAND)
    reception_value: float = tuned(0.3, 0.0, 1_000.0, "", "of its receptions", HAND)
    target_cells: float = tuned(0.45, 0.01, 100.0, "cell", "standard deviation that is aimed at", HAND)
    settle_value: float = tuned(
        4.0,
        0.0,
        1_000.0,
        "",
        "of a find's place made certain, times the probability that it is off",
        FACTORIAL,
    )


@dataclass(frozen=True, slots=True)
class RidgeTuning(_Table):
    """Planners `rwa`, `prwa` and `dprwa`, as their papers say, and ways on the ground."""

    rwa_level: float = tuned(6.0, 0.1, 1_000.0, "", "threshold over the mean of P(C)", PAPER_RWA)
    prwa_level: float = tuned(0.1, 1e-6, 1.0, "", "threshold plane p", f"{PAPER_PRWA}, figure 4")
    prwa_spacings: int = tuned(8, 1, 1_000, "", "spacings of a pair that are compared", HAND)
    prwa_positions: int = tuned(5, 1, 1_000, "", "positions along a ridge where the entropy is taken", HAND)
    prwa_max_cells: int = tuned(250, 10, 100_000, "", "cells of a cluster of which it is taken", MEMORY)
    dprwa_level: float = tuned(0.1, 1e-6, 1.0, "", "threshold plane p", PAPER_DPRWA)
    dprwa_tau0_s: float = tuned(500.0, 1.0, 100_000.0, "s", "circumference of the time ring", PAPER_DPRWA)
    dprwa_ridges: int = tuned(12, 1, 1_000, "", "real and virtual ridges together", PAPER_DPRWA)
    walk_legs: int = tuned(3, 1, 100, "", "legs of a random walk", "the papers give none")
    walk_draws: int = tuned(20, 1, 1_000, "", "draws of a leg before a detour is taken", HAND)
    least_lanes: int = tuned(
        6, 1, 1_000, "", "lanes of a patrol", "radios heard across the field would see it from two lines only"
    )
    clearance_m: float = tuned(0.25, 0.0, 100.0, "m", "distance of detours from closed ground", HAND)


@dataclass(frozen=True, slots=True)
class Tuning:
    """All tables."""

    likelihood: LikelihoodTuning = LikelihoodTuning()
    intensity: IntensityTuning = IntensityTuning()
    paper_beliefs: PaperBeliefTuning = PaperBeliefTuning()
    infogain: InfogainTuning = InfogainTuning()
    infogain1: Infogain1Tuning = Infogain1Tuning()
    ridges: RidgeTuning = RidgeTuning()

    def tables(self) -> dict[str, dict[str, Any]]:
        """Every value by table and key, as a recording's header keeps them."""
        return {
            table.name: {each.name: _plain(getattr(part, each.name)) for each in fields(part)}
            for table in fields(self)
            for part in (getattr(self, table.name),)
        }

    def with_tables(self, given: Mapping[str, Mapping[str, Any]]) -> "Tuning":
        """The same with some values set anew. Raises `ValueError`: which key, what was expected, what was there."""
        changed: dict[str, Any] = {}
        known = [table.name for table in fields(self)]
        for name, values in given.items():
            if name not in known:
                raise ValueError(f"tuning.{name}: no such table; expected one of {', '.join(known)}")
            part = getattr(self, name)
            try:
                new = {key: _typed(part, key, value) for key, value in values.items()}
                changed[name] = replace(part, **new)
            except ValueError as error:
                raise ValueError(f"tuning.{name}.{error}") from None
        return replace(self, **changed)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _typed(part: Any, key: str, value: Any) -> Any:
    """A value for `key` as its table keeps it. Raises `ValueError`."""
    default = {each.name: each.default for each in fields(part)}.get(key)
    if default is None:
        raise ValueError(
            f"{key}: no such key; expected one of {', '.join(each.name for each in fields(part))}"
        )
    several = isinstance(default, tuple)
    values = list(value) if several and isinstance(value, list | tuple) else [value]
    if not values or any(isinstance(one, bool) or not isinstance(one, int | float) for one in values):
        raise ValueError(f"{key}: expected {'numbers' if several else 'a number'}, got {value!r}")
    if several:
        return tuple(float(one) for one in values)
    if not isinstance(default, int):
        return float(value)
    if not math.isfinite(value) or value != int(value):
        raise ValueError(f"{key}: expected a whole number, got {value}")
    return int(value)
