"""What readings have in common: the file's table, restricted maximum likelihood, what is assumed."""

import numpy as np
import pytest

from fieldkit.channel.antenna_file import AntennaFile, Receiver, dump_antenna, parse_antenna, spread_of
from fieldkit.channel.model import Antenna
from fieldkit.channel.reml import Transmitter, estimate
from fieldkit.channel.spread import ChannelSpread, parse_spread, table_of
from fieldkit.errors import CalibrationRefused, ConfigError

ANTENNA = Antenna(2.0, -40.0, 5.0, -95.0)


def parsed(text):
    import tomllib

    return parse_antenna(tomllib.loads(text), "a.toml")


def test_a_file_keeps_spread_and_receivers():
    spread = ChannelSpread(1.5, 4.0, 3.0, transmitter_db=2.0, transmitters=3)
    file = AntennaFile(ANTENNA, spread=spread, receivers={"ada": Receiver(2.5, -90.0)})
    back = parsed(dump_antenna(file))
    assert back.spread == spread and back.receivers == file.receivers


def test_an_old_file_says_what_it_lacks():
    text = dump_antenna(AntennaFile(ANTENNA)).replace("schema = 2", "schema = 1")
    file = parsed(text)
    assert file.spread is None
    told = spread_of(file)
    assert "no place noise" in told.assumed
    parts = np.array([told.sigma_time_db, told.sigma_place_db, told.lobe_db])
    assert np.sqrt((parts**2).sum()) == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sigma_time_db": "x"}, "sigma_time_db: expected a finite number"),
        ({"sigma_time_db": 0.0}, "positive"),
        ({"correlation_m": -1.0}, "no less than 0"),
        ({"log_covariance": [[1.0]]}, "6 rows of 6"),
        ({"colour": 1.0}, "unknown keys colour"),
        ({"sigma_place_db": None}, "expected also sigma_place_db"),
    ],
)
def test_a_bad_table_is_named(change, words):
    table = {**table_of(ChannelSpread(1.5, 4.0, 3.0)), **change}
    table = {name: value for name, value in table.items() if value is not None}
    with pytest.raises(ConfigError, match=words):
        parse_spread(table, "a.toml")


def campaign(seed, transmitters=8, sp=4.0, st=1.5, length_m=3.0, own_db=2.5):
    rng = np.random.default_rng(seed)
    east, north = np.meshgrid(np.arange(0.0, 20.0, 1.8), np.arange(0.0, 20.0, 1.8))
    place = np.column_stack([east.ravel(), north.ravel(), np.zeros(east.size)])
    apart = np.sqrt(((place[:, None] - place[None]) ** 2).sum(axis=-1))
    root = np.linalg.cholesky(sp**2 * np.exp(-apart / length_m) + 1e-9 * np.eye(place.shape[0]))
    found = []
    for _ in range(transmitters):
        source = np.append(rng.uniform(-2.0, 22.0, 2), 0.0)
        mean = ANTENNA.mean_rss_dbm(np.maximum(np.sqrt(((place - source) ** 2).sum(axis=1)), 0.3))
        level = mean + own_db * rng.standard_normal() + root @ rng.standard_normal(place.shape[0])
        twice = np.concatenate([level, level]) + st * rng.standard_normal(2 * level.size)
        found.append(Transmitter(np.concatenate([place, place]), twice, source))
    return found


def test_what_was_put_in_is_found_again():
    found = estimate(campaign(1), cell_m=0.05)
    assert found.spread.sigma_time_db == pytest.approx(1.5, rel=0.1)
    assert found.spread.sigma_place_db == pytest.approx(4.0, rel=0.2)
    assert found.correlation_95_m[0] < 3.0 < found.correlation_95_m[1]
    assert found.path_loss_exponent == pytest.approx(2.0, abs=0.4)
    assert 1.0 < found.spread.transmitter_db < 5.0


def test_too_few_places_are_refused():
    few = [Transmitter(np.zeros((20, 3)), np.full(20, -60.0), np.array([5.0, 0.0, 0.0]))]
    with pytest.raises(CalibrationRefused, match="5 places"):
        estimate(few)
