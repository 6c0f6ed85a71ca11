"""How far a survey can be trusted on real readings: every transmitter located with a calibration from the others.

`fieldkit study reality --data FOLDER` takes every data set in the folder (`datasets` says in which form). Nothing is
tuned to one of them: one model, one set of priors. Baselines see the same readings and the same calibration.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.channel.reml import Reml, estimate
from fieldkit.engine.association.packets import PacketLog, packets_of
from fieldkit.engine.location import survey as engine
from fieldkit.engine.location.ground import Ground
from fieldkit.errors import CalibrationRefused, ConfigError
from fieldkit.messages import FloatArray, Pose, RssReading
from mission.lab.study.baselines import BASELINES, independent_grid_holds
from mission.lab.study.datasets import Survey, read_all

MARGIN_SHARE, LEAST_MARGIN_M = 0.6, 20.0
MAX_GAP_S = 5.0
SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95)
Progress = Callable[[float, str], None]


@dataclass(frozen=True, slots=True)
class Row:
    """One survey's outcome."""

    dataset: str
    name: str
    error_m: float
    sigma_m: float
    found: bool
    candidates: int
    inside: tuple[bool, ...]
    """For each of `SHARES` whether the region of that share holds the truth."""
    fit: float
    grid_inside_90: bool
    baselines: dict[str, float]

    def covered(self, share: float) -> bool:
        return self.inside[SHARES.index(share)]


def run(
    trials: int, seed: int, progress: Progress, data: Path | None = None, workers: int | None = None
) -> dict[str, Any]:
    """The study. `trials` and `seed` mean nothing here: the readings are what they are."""
    if data is None:
        raise ConfigError(
            "study reality: needs --data FOLDER, with data sets as docs/studies/reality.md says"
        )
    sets = read_all(data)
    total = sum(len(each.surveys) for each in sets)
    rows: list[Row] = []
    left_out: list[str] = []
    for each in sets:
        for survey in each.surveys:
            progress(len(rows) / total, f"{each.name} {survey.name}")
            try:
                rows.append(look_at(each.name, survey))
            except CalibrationRefused as error:
                left_out.append(f"{each.name} {survey.name}: {error}")
    progress(1.0, "done")
    names = list(dict.fromkeys(row.dataset for row in rows))
    return {
        "datasets": {name: summary([row for row in rows if row.dataset == name]) for name in names},
        "all": summary(rows),
        "left_out": left_out,
        "calibration_curve": {
            str(share): float(np.mean([row.covered(share) for row in rows])) if rows else None
            for share in SHARES
        },
        "surveys_table": [
            {
                "dataset": row.dataset,
                "name": row.name,
                "error_m": round(row.error_m, 3),
                "sigma_m": round(row.sigma_m, 3),
                "found": row.found,
                "candidates": row.candidates,
                "inside_50": row.covered(0.5),
                "inside_90": row.covered(0.9),
                "fit": round(row.fit, 2),
                **{name: round(value, 3) for name, value in row.baselines.items()},
            }
            for row in rows
        ],
    }


def ground_of(survey: Survey) -> Ground:
    """The path and a margin as `survey` takes it."""
    low, high = survey.path_m[:, :2].min(axis=0), survey.path_m[:, :2].max(axis=0)
    margin = max(LEAST_MARGIN_M, MARGIN_SHARE * float((high - low).max()))
    return float(low[0] - margin), float(low[1] - margin), float(high[0] + margin), float(high[1] + margin)


def calibrated(survey: Survey) -> tuple[Antenna, Reml]:
    """The antenna and the spread from the other transmitters; the threshold is under all that was ever heard."""
    found = estimate(survey.calibration)
    weakest = min(float(survey.level_db.min()), *(float(each.level_db.min()) for each in survey.calibration))
    antenna = Antenna(found.path_loss_exponent, found.power_at_1m_dbm, found.sigma_db, weakest - 1.0)
    return antenna, found


def as_log(survey: Survey) -> PacketLog:
    """The survey as one robot's readings and poses."""
    readings = [
        RssReading(round(t * 1e9), "radio", float(level))
        for t, level in zip(survey.t_s, survey.level_db, strict=True)
    ]
    poses = [
        Pose(round(t * 1e9), "radio", float(place[0]), float(place[1]), float(place[2]))
        for t, place in zip(survey.path_t_s, survey.path_m, strict=True)
    ]
    return packets_of(readings, poses, window_s=0.0, max_gap_s=MAX_GAP_S)


def look_at(dataset: str, survey: Survey) -> Row:
    """Locate one transmitter, and have the baselines do so too."""
    antenna, found = calibrated(survey)
    ground, truth, up_m = ground_of(survey), survey.truth_m[:2], float(survey.truth_m[2])
    radio = engine.radio_of(antenna, found.spread, source_up_m=up_m)
    rules = engine.Rules(engine.found_within_m(antenna, ground), 0.9)
    sources = engine.sources_of(as_log(survey), radio, ground, rules)
    best = sources[0]
    estimate_m = np.array([best.estimate.east_m, best.estimate.north_m])
    errors = {}
    for name, baseline in BASELINES.items():
        try:
            errors[name] = _error(baseline(survey, antenna, ground, up_m), truth)
        except ImportError:
            continue
    return Row(
        dataset,
        survey.name,
        _error(estimate_m, truth),
        float(np.sqrt(np.trace(best.estimate.cov_m2) / 2.0)),
        best.estimate.state == "found",
        len(sources),
        tuple(best.posterior.holds(truth, share) for share in SHARES),
        best.fit,
        independent_grid_holds(survey, antenna, ground, up_m, 0.9),
        errors,
    )


def _error(place_m: FloatArray, truth_m: FloatArray) -> float:
    return float(np.hypot(*(np.asarray(place_m) - truth_m)))


def summary(rows: list[Row]) -> dict[str, Any]:
    """Numbers of some surveys together."""
    if not rows:
        return {"n": 0}
    errors = np.array([row.error_m for row in rows])
    finds = [row for row in rows if row.found]
    names = [name for name in BASELINES if all(name in row.baselines for row in rows)]
    return {
        "n": len(rows),
        "covered_50": sum(row.covered(0.5) for row in rows),
        "covered_90": sum(row.covered(0.9) for row in rows),
        "median_error_m": float(np.median(errors)),
        "p90_error_m": float(np.quantile(errors, 0.9)),
        "finds": len(finds),
        "finds_outside_region": sum(not row.covered(0.9) for row in finds),
        "finds_beyond_3_sigma": sum(row.error_m > 3.0 * row.sigma_m for row in finds),
        "several_candidates": sum(row.candidates > 1 for row in rows),
        "baselines": {
            name: {
                "median_error_m": float(np.median([row.baselines[name] for row in rows])),
                "p90_error_m": float(np.quantile([row.baselines[name] for row in rows], 0.9)),
                **(
                    {"covered_90": sum(row.grid_inside_90 for row in rows)}
                    if name == "independent_grid"
                    else {}
                ),
            }
            for name in names
        },
    }
