"""CSMA networks: against the reference values, a simulated channel, and the laws of two waves."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fieldkit.engine.likelihood.csma import (
    busy_collision_probability,
    collision_cdf,
    collision_pmf,
    dipole_gain,
    idle_probability,
    load_of,
    network,
    packet_shares,
    size_by_conservation,
)
from fieldkit.engine.likelihood.csma_loops import reading_likelihood

VECTORS = {
    v["id"]: v
    for v in json.loads((Path(__file__).parent.parent / "golden" / "single_robot.json").read_text())[
        "vectors"
    ]
}
FULL_CIRCLE = dipole_gain(np.arange(0, 2 * np.pi, 2 * np.pi / 36_000))


def test_network_sizes_match_the_reference() -> None:
    expected = VECTORS["csma_m"]["expect"]
    for backoff, name in ((20.0, "m_eq14_delta20"), (1.0, "m_eq14_delta1")):
        size = network(0.75, 0.02, 0.05, backoff=backoff, form="printed").size
        assert size == pytest.approx(expected[name], abs=1e-9)
    assert size_by_conservation(0.75, 0.02, 0.05) == pytest.approx(expected["m_conservation"], abs=1e-9)


def test_collisions_of_two_packets_match_the_reference() -> None:
    vector = VECTORS["collision"]
    assert collision_cdf(vector["input"]["y"], 40, 10) == pytest.approx(vector["expect"]["cdf"], abs=1e-9)
    assert collision_pmf(vector["input"]["y"], 40, 10) == pytest.approx(vector["expect"]["pmf"], abs=1e-9)


def plain_likelihood(particle: np.ndarray, z: float, sigma_db: float, p_bc: float) -> float:
    """Eq 10 for one particle, C = 1e5, beta = 2, robot at (10, 20) heading 0.3."""
    m = len(particle)
    p, q = packet_shares(p_bc, m)
    way = particle - np.array([10.0, 20.0])
    r = np.maximum(np.hypot(*way.T), 1.0)
    strength = 1e5 * r**-2.0 * dipole_gain(np.arctan2(way[:, 1], way[:, 0]) - 0.3)
    if sigma_db > 0:
        t = 10 * np.log10(z / strength) / sigma_db
        single = np.exp(-0.5 * t**2) / (sigma_db * math.sqrt(2 * math.pi)) * 10 / (z * math.log(10))
    else:
        single = (np.floor(strength + 0.5) == z).astype(float)
    pairs = sum(float(collision_pmf(z, strength[i], strength[j])) for i in range(m) for j in range(i + 1, m))
    return float(p * single.sum() + q * pairs)


@pytest.mark.parametrize("case", VECTORS["pf_lik"]["expect"])
def test_the_likelihood_of_a_reading_matches_the_reference(case: str) -> None:
    z, sigma_db = (float(part.split("=")[1]) for part in case.split(","))
    particles = np.array(VECTORS["pf_lik"]["input"]["X"])
    expected = VECTORS["pf_lik"]["expect"][case]
    plain = [plain_likelihood(particle, z, sigma_db, 0.01) for particle in particles]
    assert plain == pytest.approx(expected, abs=1e-9)
    out = np.empty(len(particles))
    p, q = packet_shares(0.01, 3)
    reading_likelihood(
        particles, np.array([10.0, 20.0, 0.3]), 1e5, 2.0, FULL_CIRCLE, z, p, q, sigma_db, 1.0, out
    )
    assert out == pytest.approx(plain, rel=1e-5)


def simulated_channel(
    offered: float, a: float, rng: np.random.Generator, periods: int = 60_000
) -> tuple[float, float]:
    """P_idle and P_bc of a channel on which blocked packets are dropped, packet length 1."""
    gap = rng.exponential(1.0 / offered, periods)
    extra = rng.poisson(offered * a, periods)
    last = np.array([rng.uniform(0, a, k).max() if k else 0.0 for k in extra])
    busy = 1.0 + a + last
    overlap = np.where(extra > 0, 1.0 - last, 0.0)
    return float(gap.sum() / (gap.sum() + busy.sum())), float(overlap.sum() / busy.sum())


@pytest.mark.parametrize(("offered", "a"), [(0.25, 0.02), (1.5, 0.1), (4.0, 0.2)])
def test_the_exact_forms_agree_with_a_simulated_channel_and_the_printed_ones_only_in_light_traffic(
    offered: float, a: float
) -> None:
    idle, collided = simulated_channel(offered, a, np.random.default_rng(3))
    assert idle_probability(offered, a) == pytest.approx(idle, abs=0.005)
    assert busy_collision_probability(offered, a) == pytest.approx(collided, abs=0.005)
    if offered * a < 0.01:
        assert idle_probability(offered, a, form="printed") == pytest.approx(idle, abs=0.005)


@given(size=st.integers(1, 40), rate=st.floats(0.001, 0.2), a=st.floats(0.0001, 0.1))
def test_a_network_is_recovered_from_its_idle_probability(size: int, rate: float, a: float) -> None:
    p_idle = idle_probability(size * rate, a)
    found = network(p_idle, a, rate)
    assert found.size == pytest.approx(size, rel=1e-6)
    twice = network(p_idle, a, rate / 2.0)
    assert twice.load == found.load and twice.size == pytest.approx(2 * size, rel=1e-6)
    assert network(p_idle, a).size is None


def test_retries_carry_less_than_is_offered_and_an_impossible_idle_share_is_refused() -> None:
    assert load_of(0.5, 0.02, retries=True) < load_of(0.5, 0.02)
    with pytest.raises(ValueError, match="between 0 and 1"):
        network(1.0, 0.02)


def test_a_network_of_one_node_has_no_collisions() -> None:
    assert packet_shares(0.3, 1) == (1.0, 0.0)
    p, q = packet_shares(0.1, 5)
    assert 5 * p + 10 * q == pytest.approx(1.0)


@given(z_i=st.floats(1.0, 1e4), z_j=st.floats(1.0, 1e4))
def test_collision_probabilities_sum_to_one(z_i: float, z_j: float) -> None:
    low, high = z_i + z_j - 2 * math.sqrt(z_i * z_j), z_i + z_j + 2 * math.sqrt(z_i * z_j)
    every = np.arange(math.floor(low) - 1, math.ceil(high) + 2)
    assert collision_pmf(every, z_i, z_j).sum() == pytest.approx(1.0, abs=1e-9)
