"""What the traffic of a CSMA network determines, and how strong two packets at once are received.

Song, Kim and Yi, "Simultaneous localization of multiple unknown CSMA-based wireless sensor network nodes using a
mobile robot with a directional antenna" (CSMA-PF). Time is in packet lengths; `a` is the propagation delay in them,
`offered` (G) packets per packet length that want to be sent, `load` (S) those that are new. Strengths are linear.

The printed formulas and what is wrong with them:

- eq 14 (idle probability) takes E[Y] = (1 - e^-aG)/G - a e^-aG; that is E[a - Y]. Right is E[Y] = a - (1 - e^-aG)/G,
  which gives P_idle = 1 / (G (1 + 2a) + e^-aG). Both agree to first order in a.
- eq 13 has the retry rate fall with the back-off delay: it does not depend on it. Without retries G = S; with them
  S solves S = G e^-aG / (G (1 + 2a) + e^-aG).
- eq 15 counts the collision time as 1 - E[Y]; right is (P_pc - E[Y]) / (1 + a + E[Y]).

The number of nodes m and their rate lambda come only as the product m lambda: from how busy a channel is, many quiet
nodes cannot be distinguished from few busy ones. So m is given out only for a lambda that is given in.
"""

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from fieldkit.messages import FloatArray

Form = Literal["exact", "printed"]
FORM: Final = "exact"
FRONT, BACK = 1.4825, 1.0654
"""Gains of the half-wave dipole fitted to a log-periodic array, ahead and behind (eq 3)."""


def mean_last_arrival(offered: float, a: float, *, form: Form = FORM) -> float:
    """E[Y]: when, within the vulnerable time, the last packet of a busy period comes."""
    none = math.exp(-a * offered)
    if form == "printed":
        return (1.0 - none) / offered - a * none
    return a + math.expm1(-a * offered) / offered


def idle_probability(offered: float, a: float, *, form: Form = FORM) -> float:
    """P_idle of the channel (eq 14)."""
    none = math.exp(-a * offered)
    if form == "printed":
        return 1.0 / (offered * (1.0 + a) + 2.0 - none - a * offered * none)
    return 1.0 / (offered * (1.0 + 2.0 * a) + none)


def busy_collision_probability(offered: float, a: float, *, form: Form = FORM) -> float:
    """P_bc: the share of the busy time in which two packets overlap (eq 15)."""
    collides = -math.expm1(-a * offered)
    y = mean_last_arrival(offered, a, form=form)
    overlap = collides * (1.0 - y) if form == "printed" else collides - y
    return max(0.0, overlap) / (1.0 + a + y)


def load_of(
    offered: float, a: float, *, retries: bool = False, backoff: float = math.inf, form: Form = FORM
) -> float:
    """S, the new packets per packet length, behind the offered traffic G.

    `exact`: G itself where blocked packets are dropped, the fixed point with `retries`; `printed`: eq 13 with its
    mean back-off delay.
    """
    if form == "printed":
        return offered / (1.0 + 2.0 * -math.expm1(-a * offered) / backoff)
    if not retries:
        return offered
    none = math.exp(-a * offered)
    return offered * none / (offered * (1.0 + 2.0 * a) + none)


@dataclass(frozen=True, slots=True)
class Network:
    """What an idle probability says of a network."""

    load: float
    """m lambda: new packets per packet length. This is what the data give."""
    size: float | None
    """m, for the lambda that was given; None where none was."""
    note: str


def network(
    p_idle: float,
    a: float,
    rate: float | None = None,
    *,
    retries: bool = False,
    backoff: float = math.inf,
    form: Form = FORM,
) -> Network:
    """The load behind a measured idle probability, and the number of nodes if `rate` (lambda) is known.

    Raises `ValueError` for a probability that no traffic gives.
    """
    if not 0.0 < p_idle < 1.0:
        raise ValueError(f"p_idle: expected a probability between 0 and 1, got {p_idle}")
    offered = float(
        brentq(lambda g: idle_probability(g, a, form=form) - p_idle, 1e-12, 1e6, xtol=1e-14, rtol=1e-14)
    )
    load = load_of(offered, a, retries=retries, backoff=backoff, form=form)
    if rate is None:
        return Network(
            load, None, "only the product of nodes and rate can be estimated from how busy the channel is"
        )
    return Network(
        load, load / rate, f"for a rate of {rate:g} packets per packet length, which is taken as known"
    )


def size_by_conservation(p_idle: float, a: float, rate: float) -> float:
    """m if every packet occupies the channel for 1 + a: a check that needs no model of collisions."""
    return (1.0 - p_idle) / (rate * (1.0 + a))


def packet_shares(p_bc: float, size: int) -> tuple[float, float]:
    """p and q of eq 12: the probability that a given node, or a given pair of nodes, is heard when the channel is busy.

    A network of one node has no pairs: (1, 0); the printed q is 0/0 there.
    """
    if size == 1:
        return 1.0, 0.0
    return (1.0 - p_bc) / size, 2.0 * p_bc / (size * (size - 1))


def dipole_gain(off_front_rad: ArrayLike) -> FloatArray:
    """Linear gain of the log-periodic array (eq 3)."""
    cosine = np.cos(np.asarray(off_front_rad, dtype=float))
    result: FloatArray = np.where(cosine >= 0.0, FRONT * cosine, -BACK * cosine)
    return result


def collision_cdf(y: ArrayLike, z_i: float, z_j: float) -> FloatArray:
    """P(two packets of strength z_i and z_j at once are received at most as strong as y): eq 8."""
    cosine = (np.asarray(y, dtype=float) - z_i - z_j) / (2.0 * math.sqrt(z_i * z_j))
    return np.asarray(1.0 - np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi)


def collision_pmf(y: ArrayLike, z_i: float, z_j: float) -> FloatArray:
    """P(the integer reading is y) when two packets collide: eq 9."""
    at = np.asarray(y, dtype=float)
    return np.asarray(collision_cdf(at + 0.5, z_i, z_j) - collision_cdf(at - 0.5, z_i, z_j))
