"""`fieldkit bench scale`: how the default engine's cost grows with cells, detections, robots and sources, each alone.

One update is a second of listening and one transmission, with all the thinking it gives rise to; a plan is for all
teams, of which a live mission plans for one a tick; `left` is the probability that a source is left. Times are of the
processor, so that other work on the machine counts little, and each row's are also given as ratios to the base's of the
same run.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fieldkit.channel.model import Antenna
from fieldkit.channel.spread import assumed
from fieldkit.clock import cpu_s
from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.freezing import kept_bytes
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.base import Situation
from fieldkit.engine.planning.infogain import InfoGainPlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, FloatArray, Listening
from fieldkit.world.channel import sample_rss_dbm
from mission.lab.bench import settings

CELLS, DETECTIONS, ROBOTS, SOURCES = 2_500, 300, 8, 8
VARIED = {
    "cells": (625, 2_500, 10_000, 40_000),
    "detections": (100, 300, 1_000, 3_000),
    "robots": (2, 4, 8, 16),
    "sources": (2, 8, 32),
}
AT_ONCE = 20
"""Detections taken in together while a belief is filled: as after a gap in the radio's line, and quickly."""
LOOKS = 7


def scale() -> dict[str, Any]:
    """Every row's times and memory, and how steeply each grows: the slope of the line through its logarithms."""
    base: dict[str, Any] = {"cells": CELLS, "detections": DETECTIONS, "robots": ROBOTS, "sources": SOURCES}
    at_base = _small_field(**base)
    result: dict[str, Any] = {"base": base | at_base}
    for axis, values in VARIED.items():
        rows = [
            {axis: value} | (at_base if value == base[axis] else _small_field(**(base | {axis: value})))
            for value in values
        ]
        for row in rows:
            row["times_base"] = round(row["both_ms"] / at_base["both_ms"], 2)
        result[axis] = {
            "rows": rows,
            "slope": {name: _slope(rows, axis, name) for name in ("update_ms", "plan_ms", "kept_mb")},
        }
    result["place noise"] = _small_field(**base, place_noise=True)
    kilometre: dict[str, Any] = {
        "side_m": 1_000.0,
        "range_m": 300.0,
        "robots": 3,
        "sources": 8,
        "detections": DETECTIONS,
    }
    result["1 km, range 300 m, 3 robots at 10 m/s, 8 sources"] = _drones(cell_m=10.0, **kilometre)
    result["the same in cells of 5 m"] = _drones(cell_m=5.0, **kilometre)
    ten: dict[str, Any] = {
        "side_m": 10_000.0,
        "cell_m": 20.0,
        "range_m": 1_000.0,
        "robots": 16,
        "sources": 64,
    }
    for heard in (60, DETECTIONS):
        result[f"10 km, range 1 km, 16 robots at 10 m/s, 64 sources, {heard} detections"] = _drones(
            detections=heard, **ten
        )
    return result


def _slope(rows: list[dict[str, Any]], axis: str, name: str) -> float:
    x, y = np.log([row[axis] for row in rows]), np.log([max(row[name], 1e-3) for row in rows])
    return round(float(np.polyfit(x, y, 1)[0]), 2)


def _small_field(
    *, cells: int, detections: int, robots: int, sources: int, place_noise: bool = False
) -> dict[str, float]:
    """The PRWA paper's field and radios, larger or smaller; robots in pairs, each transmission near one of them."""
    engine = settings(
        cells=round(np.sqrt(cells)), pairs=max(1, robots // 2), prior_rule="em", sensing="levels"
    )
    engine = replace(
        engine,
        expected_sources=float(sources),
        spread=assumed(engine.antenna) if place_noise else None,
    )
    side_m = engine.grid.size_east_m
    rng = np.random.default_rng(7)
    places_m = rng.uniform(0.1 * side_m, 0.9 * side_m, (sources, 2))

    def near(number: int) -> FloatArray:
        middle = places_m[number % sources]
        at = np.clip(middle + rng.normal(0.0, 2.0, (len(engine.robots), 2)), 0.0, side_m)
        return np.asarray(at, dtype=float)

    return _measured(engine, near, lambda number: (20.0, places_m[number % sources]), detections, rng)


def _drones(
    *, side_m: float, cell_m: float, range_m: float, robots: int, sources: int, detections: int
) -> dict[str, float]:
    """Drones at 10 m/s on their ways over a large field; every source sends at the rate that is believed."""
    exponent, threshold_dbm = 2.53, -90.0
    antenna = Antenna(exponent, threshold_dbm + 10 * exponent * np.log10(range_m), 3.3, threshold_dbm)
    engine = EngineSettings(
        Grid(side_m, side_m, cell_m),
        antenna,
        tuple((f"r{k}",) for k in range(robots)),
        expected_sources=float(sources),
        max_speed_m_s=10.0,
        min_separation_m=10.0,
    )
    rng = np.random.default_rng(7)
    edge_m = 0.1 * side_m
    places_m = rng.uniform(edge_m, side_m - edge_m, (sources, 2))
    angle = rng.uniform(0.0, 2.0 * np.pi, robots)
    at = rng.uniform(edge_m, side_m - edge_m, (robots, 2))
    all_send_s = 1.0 / (engine.reference_rate_hz * sources)

    def on_their_way(_: int) -> FloatArray:
        nonlocal at, angle
        angle = angle + rng.normal(0.0, 0.5, robots)
        step_m = 10.0 * all_send_s * np.column_stack([np.sin(angle), np.cos(angle)])
        at = np.clip(at + step_m, 0.0, side_m)
        return at.copy()

    def any_sends(_: int) -> tuple[float, FloatArray]:
        return float(rng.exponential(all_send_s)), places_m[rng.integers(sources)]

    return _measured(engine, on_their_way, any_sends, detections, rng)


def _measured(
    engine: EngineSettings,
    robots_at: Callable[[int], FloatArray],
    sent: Callable[[int], tuple[float, FloatArray]],
    detections: int,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Fill a belief with so many detections, and time some more.

    `sent` says how long after the last the next packet is sent, in seconds, and from where (2,) in m.
    """
    belief, planner = IntensityBelief(engine), InfoGainPlanner(engine)
    teams = planner.teams(engine.teams)
    m, now_ns = len(engine.robots), 0

    def heard(number: int) -> Detection:
        nonlocal now_ns
        while True:
            at = robots_at(number)
            listen_s, place_m = sent(number)
            rss = sample_rss_dbm(engine.antenna, np.hypot(*(at - place_m).T), 0.0, rng)
            before_ns, now_ns = now_ns, now_ns + round(listen_s * 1e9)
            belief.listen(Listening(before_ns, now_ns, engine.robots, at))
            if not np.isnan(rss).all():
                return Detection(now_ns, engine.robots, at, np.zeros(m), rss, np.zeros(m, dtype=bool))

    for first in range(0, detections, AT_ONCE):
        belief.detect_all([heard(k) for k in range(first, min(first + AT_ONCE, detections))])
    while belief.reflect():
        pass
    update_s, left_s, plan_s = [], [], []
    for look in range(LOOKS + 1):
        news = heard(detections + look)
        place_m = dict(zip(engine.robots, map(tuple, news.position_m.tolist()), strict=True))
        situation = Situation(news.t_ns, place_m, teams, {})
        began_s = cpu_s()
        belief.detect(news)
        updated_s = cpu_s()
        belief.probability_left()
        known_s = cpu_s()
        planner.plan(situation, belief)
        done_s = cpu_s()
        if look:  # the first loads what is compiled
            update_s.append(updated_s - began_s)
            left_s.append(known_s - updated_s)
            plan_s.append(done_s - known_s)
    update_ms, left_ms, plan_ms = (1e3 * float(np.median(each)) for each in (update_s, left_s, plan_s))
    return {
        "update_ms": round(update_ms, 1),
        "left_ms": round(left_ms, 1),
        "plan_ms": round(plan_ms, 1),
        "plan_of_one_ms": round(plan_ms / len(teams), 1),
        "both_ms": round(update_ms + plan_ms, 1),
        "kept_mb": round(kept_bytes(belief.mixture) / 1e6, 2),
        "ground_cells": belief.mixture.grid.n_cells,
        "candidates": len(belief.candidates),
    }


def plot_scale(result: dict[str, Any], path: Path) -> None:
    """Update and plan over each of the four, both axes logarithmic."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, len(VARIED), figsize=(12.0, 3.2), sharey=True)
    for axes, axis in zip(panels, VARIED, strict=True):
        rows = result[axis]["rows"]
        for name, label in (("update_ms", "update"), ("plan_ms", "plan"), ("left_ms", "probability left")):
            axes.plot([row[axis] for row in rows], [row[name] for row in rows], marker="o", ms=4, label=label)
        axes.set(xscale="log", yscale="log", xlabel=axis)
        values = [row[axis] for row in rows]
        axes.set_xticks(values, [f"{value:,}" for value in values])
        axes.minorticks_off()
        axes.grid(alpha=0.3, which="both")
    panels[0].set_ylabel("processor time, ms")
    panels[-1].legend(fontsize=8, frameon=False)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)
