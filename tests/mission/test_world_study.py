"""The disturbed worlds: laws of what they do to a packet, and that a mission in each of them gives its figures."""

import numpy as np
import pytest

from fieldkit.world.disturbed import NONE, Disturbances, collided, lobe_gain_db, place_at
from fieldkit.world.sources import TransientSource, Transmissions
from fieldkit.world.walls import Wall, random_walls, walls_loss_db
from mission.lab.study import world


def test_a_wall_weakens_what_passes_through_it_and_nothing_else() -> None:
    wall = Wall(((2.0, -1.0), (2.0, 1.0)), 10.0)
    places = np.array([[4.0, 0.0], [1.0, 0.0], [4.0, 5.0], [-4.0, 0.0]])
    assert walls_loss_db(np.zeros(2), places, (wall, wall)).tolist() == [20.0, 0.0, 0.0, 0.0]
    assert walls_loss_db(places[0], np.zeros((1, 2)), (wall,)).tolist() == [10.0]  # both ways alike
    assert random_walls(3, 10.0, 2.0, 5.0, np.random.default_rng(1)) == random_walls(
        3, 10.0, 2.0, 5.0, np.random.default_rng(1)
    )


def test_a_stronger_packet_captures_the_receiver_and_a_weaker_is_lost() -> None:
    what = Disturbances(collision_s=0.1)
    before = np.array([-70.0, -70.0, np.nan])
    now = np.array([-60.0, -68.0, -80.0])
    survived = collided(now, before, 0.05, what)
    assert survived[0] == -60.0 and np.isnan(survived[1]) and survived[2] == -80.0
    assert collided(now, before, 0.2, what) is now and collided(now, None, 0.0, what) is now


def test_one_that_walks_goes_straight_and_stays_in_the_field() -> None:
    walks = Disturbances(walk_m_s=0.05)
    places = np.array([place_at((5.0, 5.0), 1, t, 25.0, walks, 7) for t in np.arange(0.0, 3000.0, 10.0)])
    steps = np.hypot(*np.diff(places, axis=0).T)
    assert places.min() >= 0.0 and places.max() <= 25.0 and np.median(steps) == pytest.approx(0.5)
    carried = Disturbances(jump_m=5.0, jump_s=100.0)
    before, after = (np.array(place_at((12.0, 12.0), 0, t, 25.0, carried, 7)) for t in (99.0, 100.0))
    assert np.hypot(*(after - before)) == pytest.approx(5.0)
    assert place_at((12.0, 12.0), 0, 50.0, 25.0, NONE, 7) == (12.0, 12.0)


def test_a_beacon_sends_once_a_period_from_anywhere_in_it() -> None:
    beacon = TransientSource(1.0, 1.0, 0.0, 0.1, beacon=True)
    first_s = []
    for seed in range(200):
        sent = [t_s for t_s, _ in Transmissions([beacon], np.random.default_rng(seed)).until(100.0)]
        assert len(sent) == 10
        np.testing.assert_allclose(np.diff(sent), 10.0)
        first_s.append(sent[0])
    assert min(first_s) < 0.5 and max(first_s) > 9.5 and abs(np.mean(first_s) - 5.0) < 0.7


def test_a_lobe_is_seen_from_all_round() -> None:
    what = Disturbances(lobe_db=world.LOBE_DB)
    angle = np.linspace(0.0, 2.0 * np.pi, 360)
    gain = lobe_gain_db(what, 0, np.column_stack([np.sin(angle), np.cos(angle)]), 3)
    assert gain.max() == pytest.approx(6.0, abs=0.1) and gain.min() == pytest.approx(-6.0, abs=0.1)


@pytest.mark.parametrize("name", ["2 of 4 sources 2 m outside", "an insensitive receiver", "a jump of 5 m"])
def test_a_mission_in_a_disturbed_world_gives_its_figures(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world, "CAP_S", 60.0)
    result = world.run(1, 0, lambda share, text: None, only=name, workers=1)
    (row,) = result["scenarios"].values()
    assert row["missions"] == 1 and row["false_finds"] >= 0


def test_all_scenarios_have_names_of_their_own() -> None:
    names = [each.name for each in world.SCENARIOS]
    assert len(set(names)) == len(names)
