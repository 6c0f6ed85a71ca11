"""What faults do to a mission: random ones, many missions, the real shell and driver on emulated vehicles.

Each trial is one mission on the real runner, safety, recorder and MAVLink driver. Vehicles are emulated behind real
UDP sockets, radios at the port (their wires have tests of their own), and time jumps (`fieldkit.jumploop`), so a
trial is repeatable by its seed. Every fourth trial has 16 robots, the others 4; half of them a polygon for a
fence. Each is flown twice (`fault_flight`): with faults (`fault_kinds`) and, from the same seed, without.
`fault_judge` judges.
"""

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from fieldkit import jumploop
from mission.lab.study.fault_flight import fly
from mission.lab.study.fault_kinds import KINDS, Job, draw_faults
from mission.lab.study.pool import Progress, run_trials


def trial(job: Job) -> dict[str, Any]:
    """One mission with faults and one without."""
    with tempfile.TemporaryDirectory(prefix="fieldkit-") as folder:
        return _judge(
            job,
            jumploop.run(fly(job, Path(folder) / "with", with_faults=True)),
            jumploop.run(fly(job, Path(folder) / "without", with_faults=False)),
        )


def _judge(job: Job, flown: dict[str, Any], twin: dict[str, Any]) -> dict[str, Any]:
    robots = tuple(f"r{k}" for k in range(1, job.size.robots + 1))
    return {
        "seed": job.seed,
        "robots": job.size.robots,
        "faults": [fault.kind for fault in draw_faults(job, robots)],
        **flown,
        "expected": twin["found"],
        "twin": {
            key: twin[key] for key in ("fence_breaches", "separation_breaches", "false_finds", "ended_s")
        },
    }


def run(
    trials: int,
    seed: int,
    progress: Progress,
    *,
    workers: int | None = None,
    kept: Path | None = None,
    dask: str | None = None,
) -> dict[str, Any]:
    """The campaign; every trial's seed is `seed` plus its number. The rest as for `run_trials`."""
    jobs = [Job(number, seed + number) for number in range(trials)]
    return summary(run_trials(trial, jobs, progress, workers=workers, kept=kept, dask=dask))


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over all trials, by fleet and by kind of fault."""
    kinds = Counter(kind for row in rows for kind in row["faults"])
    bad = [
        row
        for row in rows
        if row["fence_breaches"]
        or row["separation_breaches"]
        or row["not_held"]
        or row["resumed_wrongly"]
        or row["others_stopped"]
        or row["unreadable"]
    ]
    return {
        "study": "faults",
        "trials": len(rows),
        "trials_16_robots": sum(row["robots"] == 16 for row in rows),
        "faults": sum(kinds.values()),
        "fence_breaches": sum(row["fence_breaches"] for row in rows),
        "separation_breaches": sum(row["separation_breaches"] for row in rows),
        "lost_not_held": sum(len(row["not_held"]) for row in rows),
        "resumed_unasked": sum(len(row["resumed_wrongly"]) for row in rows),
        "others_stopped": sum(row["others_stopped"] for row in rows),
        "unreadable_recordings": sum(len(row["unreadable"]) for row in rows),
        "found": sum(row["found"] for row in rows),
        "expected": sum(row["expected"] for row in rows),
        "sources": sum(row["sources"] for row in rows),
        "false_finds": sum(row["false_finds"] for row in rows),
        "closest_m": round(min(row["closest_m"] for row in rows), 3) if rows else None,
        "by_kind": {kind: kinds[kind] for kind in KINDS},
        "not_good": [
            {
                key: row[key]
                for key in ("seed", "robots", "faults", "not_held", "resumed_wrongly", "unreadable")
            }
            | {"fence": row["fence_breaches"], "separation": row["separation_breaches"]}
            for row in bad
        ],
    }
