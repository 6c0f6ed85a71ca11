"""The CSMA-PF paper's experiments (section IV.B): the channel model, and the search for the nodes of a network.

Figure 6 over lambda for three networks: the model as it should be, as printed, and a simulation that shares nothing
with either, each for packets that are dropped when the channel is busy and for packets that are tried again.

Figure 7, and what the paper leaves open: the field is 100 m x 100 m; a step is one reading that is not zero, in which
the robot also drives up to 4 m; it turns to the most probable source and its antenna looks where it drives; a source
counts as localised when the robot is within 4 m of it. Readings are integers, 1 at the far corner of the field. The
number of nodes is taken for known: readings determine only the product of nodes and rate; `size_estimate` says what
listening to a hundred packets of each node makes of it for the true rate.
"""

from typing import Any

import numpy as np
from scipy.optimize import brentq

from fieldkit.clock import wall_s
from fieldkit.engine.belief.particles import ParticleFilter, Strength
from fieldkit.engine.likelihood.csma import (
    busy_collision_probability,
    dipole_gain,
    idle_probability,
    load_of,
    network,
    packet_shares,
)
from fieldkit.messages import FloatArray
from mission.lab.study.channel import simulate_channel
from mission.lab.study.experiment import Experiment, Job, run
from mission.lab.study.pool import Progress

NETWORKS = ((10, 0.02), (20, 0.02), (10, 0.1))
"""Nodes, a."""
FORMS = (
    "dropped: model",
    "dropped: as printed",
    "dropped: simulated",
    "tried again: model",
    "tried again: simulated",
)
PACKETS = 20_000
BACKOFF = 50.0
"""Mean back-off in packet lengths: long against a packet, as the model supposes."""

SIZE_M, STEP_M, RADIUS_M = 100.0, 4.0, 4.0
A, RATE = 0.02, 0.05
SCALE = 2.0 * SIZE_M**2
"""A reading of 1 across the diagonal."""
SIGMA_DB = 1.5
"""Of the soft likelihood: integers below ten are that coarse."""
PARTICLES, ROUGHNESS_M, CELL_M = 5000, 1.0, 2.0
CAP_STEPS = 4000


def channel_trial(job: Job) -> dict[str, Any]:
    """One point of figure 6: `method` is "m=10, a=0.02, P_idle; form", x is lambda."""
    where, form = job.method.split("; ")
    m, a = int(where.split("m=")[1].split(",")[0]), float(where.split("a=")[1].split(",")[0])
    again = form.startswith("tried again")
    if form.endswith("simulated"):
        rng = np.random.default_rng([job.seed, 6, m])
        traffic = simulate_channel(m, job.x, a, PACKETS, rng, backoff=BACKOFF if again else None)
        return {"value": traffic.idle if "P_idle" in where else traffic.busy_collision}
    offered = offered_for(m * job.x, a) if again else m * job.x
    printed = "printed" if form.endswith("as printed") else "exact"
    formula = idle_probability if "P_idle" in where else busy_collision_probability
    return {"value": formula(offered, a, form=printed)}  # type: ignore[arg-type]


def offered_for(load: float, a: float) -> float:
    """G with retries for S. Raises `ValueError` for more than the channel carries."""
    grid = np.geomspace(1e-6, 1e3, 400)
    carried = np.array([load_of(float(g), a, retries=True) for g in grid])
    top = int(np.argmax(carried))
    if load > carried[top]:
        raise ValueError(f"load: the channel carries at most {carried[top]:.3f}, got {load:.3f}")
    return float(brentq(lambda g: load_of(g, a, retries=True) - load, 1e-9, float(grid[top]), xtol=1e-13))


def gain_table() -> FloatArray:
    """(360,) linear gain of the log-periodic array, counter-clockwise off its front; its nulls a thousandth."""
    return np.maximum(dipole_gain(np.radians(np.arange(360.0))), 1e-3)


def reading(
    robot: tuple[float, float, float], senders_m: FloatArray, phase_rad: float, gain: FloatArray
) -> float:
    """The integer reading at x, y, heading of one sender, or of two whose carriers differ by `phase_rad`."""
    x, y, theta = robot
    east, north = senders_m[:, 0] - x, senders_m[:, 1] - y
    turn = np.degrees(np.arctan2(north, east) - theta) % 360.0
    strength = (
        SCALE
        / np.maximum(np.hypot(east, north), 1.0) ** 2
        * np.interp(turn, np.arange(361.0), np.append(gain, gain[0]))
    )
    total = float(strength.sum())
    if len(strength) == 2:
        total += 2.0 * float(np.sqrt(strength.prod())) * float(np.cos(phase_rad))
    return float(np.floor(total + 0.5))


def search_trial(job: Job) -> dict[str, Any]:
    """One network of `x` nodes: how many steps until all are localised."""
    m = round(job.x)
    chance = np.random.default_rng([job.seed, 7, m])
    sources = chance.uniform(0.0, SIZE_M, (m, 2))
    p_bc = busy_collision_probability(m * RATE, A) if m > 1 else 0.0
    gain = gain_table()
    strength = Strength(SCALE, 2.0, gain, SIGMA_DB, 1.0)
    belief = ParticleFilter(
        (SIZE_M, SIZE_M), m, strength, np.random.default_rng([job.seed, 8, m]), PARTICLES, ROUGHNESS_M
    )
    shares = packet_shares(p_bc, m)
    began = wall_s()
    x, y, theta = SIZE_M / 2.0, SIZE_M / 2.0, 0.0
    left = set(range(m))
    steps = 0
    while left and steps < CAP_STEPS:
        steps += 1
        east, north = belief.most_probable(CELL_M)
        way = float(np.hypot(east - x, north - y))
        if way > CELL_M:
            theta, go = float(np.arctan2(north - y, east - x)), min(STEP_M, way)
        else:  # it is there and nothing is: look round
            theta, go = float(chance.uniform(-np.pi, np.pi)), STEP_M
        x = float(np.clip(x + go * np.cos(theta), 0.0, SIZE_M))
        y = float(np.clip(y + go * np.sin(theta), 0.0, SIZE_M))
        for found in sorted(left):
            if np.hypot(*(sources[found] - (x, y))) <= RADIUS_M:
                left.remove(found)
                belief.identify((float(sources[found, 0]), float(sources[found, 1])))
        z = 0.0
        while left and z < 1.0:
            count = 2 if chance.random() < p_bc else 1
            senders = sources[chance.choice(m, count, replace=False)]
            z = reading((x, y, theta), senders, float(chance.uniform(0.0, 2.0 * np.pi)), gain)
        if left:
            belief.update((x, y, theta), z, *shares)
    listened = simulate_channel(m, RATE, A, 100 * m, np.random.default_rng([job.seed, 9, m]))
    return {
        "value": None if left else float(steps),
        "left": len(left),
        "size_estimate": float(network(listened.idle, A, RATE).size or 0.0),
        "wall_s": wall_s() - began,
    }


FIG6 = Experiment(
    "csma-fig6", "Idle and busy-collision probability of a CSMA channel", "lambda, packets per packet length and node",
    "probability",
    tuple(f"m={m}, a={a:g}, {what}; {form}" for what in ("P_idle", "P_bc") for m, a in NETWORKS for form in FORMS),
    (0.002, 0.005, 0.01, 0.02, 0.03), channel_trial,
)  # fmt: skip
FIG7 = Experiment(
    "csma-fig7", "Steps to localise all nodes", "nodes", "steps", ("csma-pf",),
    tuple(range(1, 11)), search_trial, CAP_STEPS,
)  # fmt: skip


def fig6(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 6: P_idle and P_bc against lambda."""
    return run(FIG6, trials, seed, progress, **how)


def fig7(trials: int, seed: int, progress: Progress, **how: Any) -> dict[str, Any]:
    """Figure 7: steps against the number of nodes."""
    return run(FIG7, trials, seed, progress, **how)
