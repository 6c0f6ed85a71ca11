"""A person walks to one hidden transmitter: by advice, in lanes, or to where it was loudest. Same worlds for all three.

Field 300 m, heard to 80 m, 0.2 packets a second; 1.2 m/s; a satellite receiver whose 3 m wander over a minute; a body
that takes 8 dB from behind; one hint in three is ignored. What is found is judged by the same belief in all three.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit import settings as given
from fieldkit.channel.antenna_file import dump_antenna
from fieldkit.messages import EndMission, Event, GoTo, Hold, Pose, RssReading, Tick, VehicleState
from fieldkit.world.channel import sample_rss_dbm
from fieldkit.world.sources import Transmissions
from fieldkit.world.walker import Walker, WanderingError, body_loss_db
from mission.core.kernel import Kernel
from mission.core.mission_file import Mission, assemble, parse_mission
from mission.core.walk_text import WalkOptions, walk_text
from mission.lab.study.pool import run_trials
from mission.lab.walk_demo import (
    BEHIND_DB,
    ORIGIN_DEG,
    RADIO,
    RATE_HZ,
    SIZE_M,
    believed,
    hidden,
)

STEP_S = 0.5
CAP_S = 3_600.0
GUIDES = ("advice", "lanes", "loudest")
LANE_M = 100.0
"""Between lanes: a little over the range, so that ground is heard from both sides."""
WITHIN_M = 10.0
LOUDER_S = 20.0
"""How often the one who goes where it was loudest thinks again."""


@dataclass(frozen=True, slots=True)
class Job:
    """One person in one world."""

    number: int
    seed: int
    guide: str


def walk_mission(seed: int) -> Mission:
    """As `fieldkit walk` writes it."""
    antenna = believed()
    receiver = {"driver": "lines", "port": "-", "map": "json"}
    text = walk_text(WalkOptions(receiver, "-", "antenna.toml", ORIGIN_DEG, SIZE_M, RATE_HZ, seed=seed))
    return assemble(parse_mission(text, "walk"), text, antenna, dump_antenna(antenna), "walk")


def trial(job: Job) -> dict[str, Any]:
    """When the transmitter was found, and how far off."""
    mission, (source,) = walk_mission(job.seed), hidden(job.seed)
    kernel = Kernel(mission.kernel)
    rng = [np.random.default_rng([job.seed, 0x57A1, k]) for k in range(4)]
    ignores = 1.0 / 3.0 if job.guide == "advice" else 0.0
    walker = Walker(SIZE_M / 2.0, 10.0, rng[0], ignores=ignores, size_m=(SIZE_M, SIZE_M))
    error, traffic = WanderingError(3.0, 60.0, rng[1]), Transmissions([source], rng[2])
    guide = _Guide(job.guide, rng[3])
    inbox: list[Event] = [VehicleState(0, given.WALKER, "guided", True)]
    at_s, reason = 0.0, ""
    while not reason and at_s < CAP_S:
        east, north = walker.east_m + float(error.off_m[0]), walker.north_m + float(error.off_m[1])
        inbox.append(Pose(round(at_s * 1e9), given.WALKER, east, north, 0.0, walker.heading_deg, 3.0, "gnss"))
        for heard_s, _ in traffic.until(at_s):
            way = np.array([[source.east_m - walker.east_m, source.north_m - walker.north_m]])
            off_deg = np.degrees(np.arctan2(way[:, 0], way[:, 1])) - walker.heading_deg
            rss = sample_rss_dbm(
                RADIO, np.hypot(*way.T), -body_loss_db(off_deg, BEHIND_DB), guide.channel, np.zeros(1)
            )
            if not np.isnan(rss[0]):
                inbox.append(RssReading(round(heard_s * 1e9), given.WALKER, float(rss[0]), "lines"))
                guide.hear(float(rss[0]), (east, north))
        inbox.append(Tick(round(at_s * 1e9)))
        for event in inbox:
            for command in kernel.step(event).commands:
                match command:
                    case GoTo(_, _, waypoint) if job.guide == "advice":
                        walker.advise((waypoint.east_m, waypoint.north_m))
                    case Hold() if job.guide == "advice":
                        walker.advise(None)
                    case EndMission(_, why):
                        reason = why
                    case _:
                        pass
        inbox = []
        if job.guide != "advice":
            walker.advise(guide.next((walker.east_m, walker.north_m), at_s))
        walker.step(STEP_S)
        error.step(STEP_S)
        at_s += STEP_S
    finds = [s for s in kernel.sources() if s.state == "found"]
    off_m = min(
        (math.dist((s.east_m, s.north_m), (source.east_m, source.north_m)) for s in finds), default=None
    )
    return {
        "guide": job.guide,
        "seed": job.seed,
        "found_s": at_s if finds else None,
        "off_m": off_m,
        "false": sum(
            math.dist((s.east_m, s.north_m), (source.east_m, source.north_m)) > 2.0 * WITHIN_M for s in finds
        ),
        "detections": kernel.detections,
    }


class _Guide:
    """Where the two who are not advised go."""

    def __init__(self, kind: str, channel: np.random.Generator) -> None:
        self.kind, self.channel = kind, channel
        self._lanes = _lanes()
        self._loudest: tuple[float, tuple[float, float]] | None = None
        self._side_m: tuple[float, float] | None = None
        self._thought_s = -LOUDER_S
        self._turn = 0

    def hear(self, rss_dbm: float, place_m: tuple[float, float]) -> None:
        """Remember the strongest reading."""
        if self._loudest is None or rss_dbm > self._loudest[0]:
            self._loudest = (rss_dbm, place_m)

    def next(self, here_m: tuple[float, float], at_s: float) -> tuple[float, float]:
        """Along the lanes; the other one, once it has heard something, round where it was loudest, ever further."""
        if self.kind == "loudest" and self._loudest is not None:
            if at_s - self._thought_s >= LOUDER_S or self._side_m is None:
                self._thought_s = at_s
                radius_m = 4.0 + 3.0 * (self._turn % 8)
                angle = math.radians(137.5 * self._turn)
                east, north = self._loudest[1]
                self._side_m = (
                    min(max(east + radius_m * math.sin(angle), 1.0), SIZE_M - 1.0),
                    min(max(north + radius_m * math.cos(angle), 1.0), SIZE_M - 1.0),
                )
                self._turn += 1
            return self._side_m
        if math.dist(here_m, self._lanes[0]) < 2.0:
            self._lanes.append(self._lanes.pop(0))
        return self._lanes[0]


def _lanes() -> list[tuple[float, float]]:
    """Corners of lanes over the field, and back."""
    count = round(SIZE_M / LANE_M)
    corners: list[tuple[float, float]] = []
    for lane in range(count):
        east = (lane + 0.5) * SIZE_M / count
        ends = (20.0, SIZE_M - 20.0)
        corners += [(east, north) for north in (ends if lane % 2 == 0 else ends[::-1])]
    return corners + corners[-2::-1]


def run(
    trials: int,
    seed: int,
    on_progress: Callable[[float, str], None],
    *,
    workers: int | None = None,
    kept: Path | None = None,
) -> dict[str, Any]:
    """The three on common worlds.

    JSON: {"guides": {name: {"n", "found", "median_s", "p90_s", ...}}, "trials": [...]}.
    """
    jobs = [Job(3 * k + n, seed + k, guide) for k in range(trials) for n, guide in enumerate(GUIDES)]
    rows = run_trials(trial, jobs, on_progress, workers=workers, kept=kept)
    return {
        "study": "walk",
        "guides": {name: summary([r for r in rows if r["guide"] == name]) for name in GUIDES},
        "trials": rows,
    }


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Of one guide's walks; one that found nothing counts as longer than all that did."""
    times = np.array([row["found_s"] if row["found_s"] is not None else np.inf for row in rows])
    off = np.array([row["off_m"] for row in rows if row["off_m"] is not None])
    ordered = np.sort(times)

    def at_share(share: float) -> float | None:
        """The time by which that share had found it; None where it had not."""
        value = float(ordered[max(0, math.ceil(share * len(ordered)) - 1)]) if len(ordered) else math.inf
        return value if math.isfinite(value) else None

    return {
        "n": len(rows),
        "found": int(np.isfinite(times).sum()),
        "median_s": at_share(0.5),
        "p90_s": at_share(0.9),
        "within_10_m": int((off <= WITHIN_M).sum()),
        "off_median_m": float(np.median(off)) if off.size else None,
        "false_finds": int(sum(row["false"] for row in rows)),
    }
