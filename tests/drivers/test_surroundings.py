"""What the ground adds to an emulated field: by laws, by words, and at the radios of vehicles."""

import math

import numpy as np
import pytest

from drivers.emulators.rehearsal import read_rehearsal
from fieldkit.channel.model import Antenna
from fieldkit.errors import ConfigError
from fieldkit.world.sources import TransientSource
from fieldkit.world.surroundings import NOTHING_AROUND, Surroundings, surroundings_of
from fieldkit.world.wander import WANDER_S, Wander

RADIO = Antenna(2.53, -40.0, 1e-6, -200.0)
SOURCES = (TransientSource(5.0, 5.0, 0.0, 1.0), TransientSource(15.0, 12.0, -3.0, 1.0))
PLACES = np.random.default_rng(1).uniform(0.0, 20.0, (400, 2))
GROUND = np.zeros(len(PLACES))


def heard(around: Surroundings, number: int = 0, at_s: float = 0.0, seed: int = 3) -> np.ndarray:
    air = around.air(RADIO, SOURCES, len(PLACES), 20.0, seed)
    return air.heard_dbm(number, at_s, PLACES, GROUND, GROUND, np.random.default_rng(2))


def test_with_nothing_around_what_is_heard_is_the_law_of_distance() -> None:
    far_m = np.hypot(*(PLACES - (5.0, 5.0)).T)
    assert heard(NOTHING_AROUND) == pytest.approx(np.round(RADIO.mean_rss_dbm(far_m)), abs=1.0)


def test_shadows_belong_to_places_and_scatter_as_wide_as_said() -> None:
    more = heard(Surroundings(shadow_db=6.0, shadow_m=1.0)) - heard(NOTHING_AROUND)
    again = heard(Surroundings(shadow_db=6.0, shadow_m=1.0), at_s=50.0) - heard(NOTHING_AROUND)
    assert more == pytest.approx(again)
    assert np.std(more) == pytest.approx(6.0, rel=0.2)
    other = heard(Surroundings(shadow_db=6.0, shadow_m=1.0), number=1) - heard(NOTHING_AROUND, number=1)
    assert abs(np.corrcoef(more, other)[0, 1]) < 0.2


@pytest.mark.parametrize(
    ("around", "least", "most"),
    [
        (Surroundings(walls=30), -90.0, 1.0),
        (Surroundings(lobe_db=12.0), -7.0, 7.0),
        (Surroundings(offset_db=5.0), -25.0, 25.0),
    ],
)
def test_walls_take_lobes_and_offsets_shift(around: Surroundings, least: float, most: float) -> None:
    more = heard(around) - heard(NOTHING_AROUND)
    assert np.ptp(more) > 5.0 and more.min() >= least and more.max() <= most


def test_deaf_receivers_hear_nothing_and_lost_packets_are_lost() -> None:
    assert np.isnan(heard(Surroundings(deaf=7))).sum() == 7
    lost = np.isnan(heard(Surroundings(packet_loss=0.3))).mean()
    assert 0.2 < lost < 0.4


def test_a_source_that_jumps_is_heard_from_where_it_then_is() -> None:
    air = Surroundings(jump_m=5.0, jump_s=100.0).air(RADIO, SOURCES, 1, 20.0, 3)
    before, after = air.source_m(0, 99.0), air.source_m(0, 101.0)
    assert before == pytest.approx([5.0, 5.0]) and math.dist(before, after) == pytest.approx(5.0)


def test_foreign_packets_come_as_often_as_said() -> None:
    air = Surroundings(foreign_hz=0.5).air(RADIO, SOURCES, 4, 20.0, 3)
    rng = np.random.default_rng(6)
    packets = [each for _ in range(10_000) for each in air.foreign(0.1, 4, rng)]
    assert len(packets) == pytest.approx(500, rel=0.2) and {robot for robot, _ in packets} == {0, 1, 2, 3}


def test_positions_wander_together_and_within_a_minute() -> None:
    at = np.array([Wander(2.0, 5).at(t) for t in np.arange(0.0, 60_000.0, 30.0)])
    assert at.std() == pytest.approx(2.0, rel=0.15)
    kept = np.corrcoef(at[:-1, 0], at[1:, 0])[0, 1]
    assert kept == pytest.approx(math.exp(-30.0 / WANDER_S), abs=0.1)


def test_words_say_what_is_around() -> None:
    assert surroundings_of(()) == NOTHING_AROUND
    assert surroundings_of(["shadow_db=6", "walls=4"]) == Surroundings(shadow_db=6.0, walls=4)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("shadows=6", "expected NAME=VALUE"),
        ("walls=1.5", "expected a whole number from 0"),
        ("shadow_db=-1", "expected a number from 0"),
        ("shadow_m=0", "over 0"),
        ("packet_loss=2", "from 0 to 1"),
        ("offset_db=nan", "got 'nan'"),
        ("walls", "got ''"),
    ],
)
def test_a_wrong_word_is_named(word: str, said: str) -> None:
    with pytest.raises(ConfigError, match=word) as error:
        surroundings_of([word])
    assert said in str(error.value)


def test_a_word_given_twice_is_refused() -> None:
    with pytest.raises(ConfigError, match="each once"):
        surroundings_of(["walls=1", "walls=2"])


def test_positions_of_real_vehicles_are_not_made_to_wander(tmp_path: object) -> None:
    with pytest.raises(ConfigError, match="wander_m"):
        read_rehearsal(tmp_path / "mission.toml", around=Surroundings(wander_m=1.0))  # type: ignore[operator]
