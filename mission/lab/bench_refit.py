"""`fieldkit bench refit`: what a campaign costs by the mission, with one worker, with two, and where all is done.

A few missions of twenty minutes in one field, flown with different seeds, and the same recordings again on later days.
Each is read, decoded, associated and believed in as if it had been flown then. Wall times hold on a machine that has
nothing else to do; of two workers' processor time that of the belief's process is given, which the others wait for.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fieldkit.clock import cpu_s, wall_s
from fieldkit.recording.reader import open_recording
from fieldkit.recording.writer import RecordingWriter
from mission.analysis.refit import Refitted, Work
from mission.analysis.refit import refit as refit_all
from mission.lab.simulate import Truth
from mission.lab.simulated import fly_simulated
from mission.lab.synthetic import hidden_sources, small_mission
from mission.replay.command import Changes
from mission.shell.setups import radio_of, start_places

SEEDS, DAYS = (1, 2), 2
LASTS_S = 1200.0
DAY_NS = 24 * 3600 * 10**9
MORE_THAN_THERE_ARE = 9
"""Sources asked for, so that the missions do not end before their time."""


def refit() -> dict[str, Any]:
    """Seconds a mission with one worker and with two, of a campaign of this many missions; none is extrapolated."""
    with tempfile.TemporaryDirectory() as made:
        logs = campaign(Path(made), SEEDS, DAYS, LASTS_S)
        one, two = Work(Path(made) / "one", 1), Work(Path(made) / "two", 2)
        refit_all(logs[:1], Changes(), work=Work(workers=1))  # loads what is compiled
        one_s, one_cpu_s, alone = _timed(logs, one)
        two_s, two_cpu_s, both = _timed(logs, two)
        again_s, _, again = _timed(logs, two)
        return {
            "missions": len(logs),
            "mission_lasts_s": LASTS_S,
            "detections": alone.detections,
            "tiles": len(alone.tiles),
            "one_worker_s_per_mission": round(one_s / len(logs), 2),
            "one_worker_cpu_s_per_mission": round(one_cpu_s / len(logs), 2),
            "two_workers_s_per_mission": round(two_s / len(logs), 2),
            "two_workers_cpu_s_per_mission_of_the_belief": round(two_cpu_s / len(logs), 2),
            "times_faster_with_two": round(one_s / two_s, 2),
            "again_s": round(again_s, 2),
            "done_again": sum(again.done_now),
            "same_bits": alone.belief_hash == both.belief_hash == again.belief_hash,
            "found": sum(source.state == "found" for source in alone.sources()),
        }


def campaign(folder: Path, seeds: Sequence[int], days: int, lasts_s: float) -> list[Path]:
    """Recordings of missions in one field, with the same sources: one a day, each seed `days` times."""
    logs = []
    for number, seed in enumerate(seeds):
        flown = folder / f"flown-{seed}"
        mission = small_mission(flown, seed=seed, duration_s=lasts_s, sources_found=MORE_THAN_THERE_ARE)
        truth = Truth(radio_of(mission), hidden_sources(1), tuple(start_places(mission).values()))
        fly_simulated(mission, truth, seed, flown / "mission.mcap", {"mission": "synthetic", "seed": seed})
        for day in range(days):
            out = folder / f"day-{number * days + day}.mcap"
            logs.append(later(flown / "mission.mcap", out, (number * days + day) * DAY_NS))
    return logs


def later(log: Path, out: Path, by_ns: int) -> Path:
    """What entered a mission, as of another day; `out`."""
    recording = open_recording(log)
    with RecordingWriter(
        out, mission_toml=recording.mission_toml, antenna_toml=recording.antenna_toml, start_ns=by_ns
    ) as writer:
        for number, log_time_ns, event in recording.events():
            writer.event(number, log_time_ns + by_ns, replace(event, t_ns=event.t_ns + by_ns))
    return out


def _timed(logs: Sequence[Path], work: Work) -> tuple[float, float, Refitted]:
    """Wall seconds, those of this process's processor, and what came out."""
    began_s, began_cpu_s = wall_s(), cpu_s()
    done = refit_all(logs, Changes(), work=work)
    return wall_s() - began_s, cpu_s() - began_cpu_s, done
