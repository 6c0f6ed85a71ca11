"""The default planner beside the one that was the default before, on the same missions.

`fieldkit study planners --seed 300 --missions 64`. The worlds are those of the trust study. A mission's time scatters
by 40 %, so what counts is the mean of the differences between two missions of one seed, and its standard error.
Seeds from 300 on are for choosing; 0 to 99 are for judging.
"""

from typing import Any

import numpy as np

from mission.lab.study.pool import Progress, having, run_trials
from mission.lab.study.trust import Job, Scenario, summarise, trial

NOW, BEFORE = "infogain", "infogain1"
COUNTS = (4, 8, 2, 1)
"""Sources hidden."""
SCENARIOS = tuple(
    Scenario(f"{count} source{'s' * (count > 1)}, {planner}", count, planner=planner)
    for count in COUNTS
    for planner in (BEFORE, NOW)
)


def paired(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> dict[str, float | int | None]:
    """By how much later missions of one seed found all sources now, of those that found all both times."""
    both = [
        b["time_s"] - a["time_s"]
        for a, b in zip(before, now, strict=True)
        if a["time_s"] is not None and b["time_s"] is not None
    ]
    return {
        "pairs": len(both),
        "later_s": float(np.mean(both)) if both else None,
        "standard_error_s": float(np.std(both, ddof=1)) / len(both) ** 0.5 if len(both) > 1 else None,
    }


def run(trials: int, seed: int, progress: Progress, *, only: str = "", **how: Any) -> dict[str, Any]:
    """Missions of both planners, `trials` of each row from `seed` on; `only` keeps the numbers of sources it names.

    `how` goes to `run_trials`.
    """
    names = having(only, (each.name for each in SCENARIOS))
    wanted = [each for each in SCENARIOS if each.name in names]
    jobs = [Job(scenario, seed + k) for scenario in wanted for k in range(trials)]
    rows = run_trials(trial, jobs, progress, **how)
    groups = {
        scenario.name: rows[trials * index : trials * (index + 1)] for index, scenario in enumerate(wanted)
    }
    scenarios = {}
    for scenario in wanted:
        row = summarise(groups[scenario.name])
        before = groups.get(scenario.name.replace(f", {NOW}", f", {BEFORE}"))
        if scenario.planner == NOW and before is not None:
            row |= paired(before, groups[scenario.name])
        else:
            row |= dict.fromkeys(("pairs", "later_s", "standard_error_s"))
        scenarios[scenario.name] = row
    return {
        "study": "planners",
        "trials": trials,
        "seed": seed,
        "scenarios": scenarios,
        "times_s": {name: [row["time_s"] for row in group] for name, group in groups.items()},
    }
