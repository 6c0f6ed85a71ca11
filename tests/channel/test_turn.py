"""A bearing by one turn: right where there is one, with an honest error, and none where there is none."""

import numpy as np
import pytest

from fieldkit.channel.turn import bearing_of
from fieldkit.world.walker import body_loss_db


def turn(rng: np.random.Generator, bearing_deg: float, behind_db: float, n: int = 16, noise_db: float = 4.0):  # type: ignore[no-untyped-def]
    heading = (np.arange(n) * 360.0 / n + rng.uniform(0.0, 360.0)) % 360.0
    level = -70.0 - body_loss_db(bearing_deg - heading, behind_db) + rng.normal(0.0, noise_db, n)
    return heading, np.round(level)


@pytest.mark.parametrize("bearing_deg", [0.0, 45.0, 181.0, 359.0])
def test_without_noise_the_bearing_is_exact(bearing_deg: float) -> None:
    found = bearing_of(*turn(np.random.default_rng(1), bearing_deg, 20.0, 36, 0.0))
    assert not found.why and (found.bearing_deg - bearing_deg + 180.0) % 360.0 - 180.0 == pytest.approx(
        0.0, abs=1.5
    )
    assert found.swing_db == pytest.approx(20.0, abs=0.5)


def test_ninety_per_cent_of_clear_bearings_are_within_their_error() -> None:
    rng = np.random.default_rng(2)
    within = []
    for _ in range(600):
        true_deg = rng.uniform(0.0, 360.0)
        found = bearing_of(*turn(rng, true_deg, 12.0))
        if not found.why:
            within.append(abs((found.bearing_deg - true_deg + 180.0) % 360.0 - 180.0) <= found.error_90_deg)
    assert len(within) > 400 and 0.87 < float(np.mean(within)) < 0.96


def test_where_nothing_shields_hardly_a_turn_in_fifty_claims_a_bearing() -> None:
    rng = np.random.default_rng(3)
    assert np.mean([not bearing_of(*turn(rng, 0.0, 0.0)).why for _ in range(600)]) < 0.02


def test_what_is_no_turn_is_said() -> None:
    assert "it takes 8" in bearing_of([0.0, 90.0], [-70.0, -80.0]).why
    assert "no whole turn" in bearing_of([10.0] * 12, [-70.0] * 12).why
    assert "no clear bearing" in bearing_of(list(range(0, 360, 30)), [-70.0] * 12).why
