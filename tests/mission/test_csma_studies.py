"""The CSMA studies: formulas against a channel that knows none of them, and a search that ends."""

import numpy as np
import pytest

from fieldkit.engine.likelihood.csma import busy_collision_probability, collision_cdf, idle_probability
from mission.lab.study.channel import shares, simulate_channel
from mission.lab.study.csma import FIG6, gain_table, offered_for, reading, search_trial
from mission.lab.study.experiment import Job


def test_three_packets_by_hand() -> None:
    # On the air 1..2, 1.5..2.5 and 5..6; the channel is busy 0.1 longer after each.
    traffic = shares(np.array([1.0, 1.5, 5.0]), 0.1, 10.0)
    assert traffic.idle == pytest.approx((1.0 + (5.0 - 2.6) + (10.0 - 6.1)) / 10.0)
    assert traffic.busy_collision == pytest.approx(0.5 / (1.6 + 1.1))


def test_dropped_packets_leave_the_channel_as_idle_as_the_model_says() -> None:
    traffic = simulate_channel(50, 0.01, 0.05, 40_000, np.random.default_rng(1))
    assert traffic.idle == pytest.approx(idle_probability(0.5, 0.05), abs=0.005)
    assert traffic.busy_collision == pytest.approx(busy_collision_probability(0.5, 0.05), rel=0.08)


def test_packets_tried_again_are_the_fixed_point() -> None:
    traffic = simulate_channel(20, 0.015, 0.02, 40_000, np.random.default_rng(2), backoff=50.0)
    assert traffic.idle == pytest.approx(idle_probability(offered_for(0.3, 0.02), 0.02), abs=0.01)
    assert traffic.idle < idle_probability(0.3, 0.02) - 0.005, "trying again makes traffic"
    with pytest.raises(ValueError, match="carries at most"):
        offered_for(5.0, 0.02)


def test_one_node_never_collides_with_itself() -> None:
    assert simulate_channel(1, 0.2, 0.1, 5000, np.random.default_rng(3)).busy_collision == 0.0


def test_two_at_once_are_received_as_eq_8_says() -> None:
    gain = gain_table()
    places = np.array([[60.0, 52.0], [58.0, 45.0]])
    rng = np.random.default_rng(4)
    alone = [reading((50.0, 50.0, 0.0), places[k : k + 1], 0.0, gain) for k in range(2)]
    both = [reading((50.0, 50.0, 0.0), places, float(rng.uniform(0, 2 * np.pi)), gain) for _ in range(4000)]
    for y in np.quantile(both, [0.2, 0.5, 0.8]):
        assert np.mean(np.array(both) <= y) == pytest.approx(float(collision_cdf(y + 0.5, *alone)), abs=0.03)


def test_a_small_network_is_found_the_same_way_every_time() -> None:
    first, again = (search_trial(Job("csma-fig7", "csma-pf", 2, 1)) for _ in range(2))
    assert first["value"] == again["value"] is not None
    assert first["left"] == 0
    assert 1.5 < first["size_estimate"] < 2.5


def test_figure_6_asks_for_nothing_the_channel_cannot_carry() -> None:
    for method in FIG6.methods:
        nodes, a = int(method.split("m=")[1].split(",")[0]), float(method.split("a=")[1].split(",")[0])
        assert offered_for(nodes * max(FIG6.xs), a) > nodes * max(FIG6.xs)
