"""The default planner beside itself with pairs kept abreast, and beside the default of before, on the same missions.

`fieldkit study planners --seed 300 --missions 64`. The worlds are those of the trust study. A mission's time scatters
by 40 %, so what counts is the mean of the differences between two missions of one seed, and its standard error.
Seeds from 300 on are for choosing; 0 to 99 are for judging.
"""

from typing import Any

import numpy as np

from mission.lab.study.pool import Progress, having, run_trials
from mission.lab.study.trust import Job, Scenario, summarise, trial

NOW, IN_TEAMS, BEFORE = "infogain", "infogain in teams", "infogain1"
COUNTS = (4, 8, 2, 1)
"""Sources hidden."""
SCENARIOS = tuple(
    Scenario(
        f"{count} source{'s' * (count > 1)}, {way}",
        count,
        planner=BEFORE if way == BEFORE else NOW,
        keep_teams=way == IN_TEAMS,
    )
    for count in COUNTS
    for way in (BEFORE, IN_TEAMS, NOW)
)
"""The last of each number is what the others are compared with."""


def paired(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> dict[str, float | int | None]:
    """By how much later missions of one seed find all sources now, of those that found all both times."""
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
    """Missions of each planner, `trials` of each row from `seed` on; `only` keeps the rows whose name has these words.

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
        now = groups.get(f"{scenario.name.partition(', ')[0]}, {NOW}")
        if now is None or now is groups[scenario.name]:
            beside = dict.fromkeys(("pairs", "later_s", "standard_error_s"))
        else:
            beside = paired(groups[scenario.name], now)
        scenarios[scenario.name] = summarise(groups[scenario.name]) | beside
    return {
        "study": "planners",
        "trials": trials,
        "seed": seed,
        "scenarios": scenarios,
        "times_s": {name: [row["time_s"] for row in group] for name, group in groups.items()},
    }
