"""What a calibration hands on beyond the mean law, and the readings it refuses for it."""

import numpy as np
import pytest

from calibration import channel, output
from calibration.dataset import read_readings
from calibration.fit import fit
from calibration.verdict import judge
from fieldkit.channel.antenna_file import dump_antenna, parse_antenna
from fieldkit.errors import DataError


def campaign(tmp_path, *, up=False, distance_factor=None, seed=2):
    """Three transmitters, each heard twice at 49 places under 3 dB from place to place."""
    rng = np.random.default_rng(seed)
    names = ["rss_dbm", "tx_east_m", "tx_north_m", "rx_east_m", "rx_north_m"]
    names += ["tx_up_m", "rx_up_m"] if up else []
    names += ["distance_m"] if distance_factor else []
    rows = [",".join(names)]
    for source in ((3.0, 4.0), (17.0, 5.0), (9.0, 18.0)):
        own = 2.0 * rng.standard_normal()
        for east in range(0, 21, 3):
            for north in range(0, 21, 3):
                away = max(0.5, float(np.hypot(east - source[0], north - source[1])))
                high = float(np.hypot(away, 10.0)) if up else away
                level = -40.0 + own - 25.0 * np.log10(high) + 3.0 * rng.standard_normal()
                for _ in range(2):
                    cells = [
                        round(level + rng.standard_normal(), 1),
                        source[0],
                        source[1],
                        east,
                        north + 0.01,
                    ]
                    cells += [0.0, 10.0] if up else []
                    cells += [away * distance_factor] if distance_factor else []
                    rows.append(",".join(map(str, cells)))
    path = tmp_path / "readings.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def test_positions_give_place_noise_and_how_transmitters_differ(tmp_path):
    result = fit(read_readings(campaign(tmp_path)))
    spread, found, why_not = channel.measured(result)
    assert found is not None and why_not == ""
    assert spread.transmitters == 3
    assert spread.sigma_time_db == pytest.approx(1.0, abs=0.25)
    assert spread.sigma_place_db == pytest.approx(3.0, abs=0.8)
    low, high = found.correlation_95_m
    assert low < spread.correlation_m < high
    text = dump_antenna(output.antenna_file(result, judge(result)))
    import tomllib

    assert parse_antenna(tomllib.loads(text), "a.toml").spread is not None
    assert output.plain(result, judge(result))["channel"]["transmitters"] == 3


def test_heights_of_both_ends_count(tmp_path):
    readings = read_readings(campaign(tmp_path, up=True))
    assert readings.climb_m is not None and readings.distance_m.min() >= 10.0
    spread, found, _ = channel.measured(fit(readings))
    assert found is not None and found.path_loss_exponent == pytest.approx(2.5, abs=0.9)
    assert spread.elevation_sd < 1.0


def test_heights_of_one_end_are_refused(tmp_path):
    path = campaign(tmp_path, up=True)
    path.write_text(path.read_text().replace("tx_up_m", "colour"))
    with pytest.raises(DataError, match="rx_up_m and no tx_up_m"):
        read_readings(path)


def test_distances_that_contradict_positions_by_a_factor_are_refused(tmp_path):
    with pytest.raises(DataError, match="factor of 100"):
        read_readings(campaign(tmp_path, distance_factor=100.0))


def test_relative_levels_are_read_where_the_user_says_so(tmp_path):
    path = campaign(tmp_path)
    lines = path.read_text().splitlines()
    moved = [lines[0], *(f"{float(line.split(',')[0]) + 90.0},{line.split(',', 1)[1]}" for line in lines[1:])]
    path.write_text("\n".join(moved))
    with pytest.raises(DataError):
        read_readings(path)
    assert read_readings(path, relative=True).rss_dbm.max() > 20.0


def test_without_positions_it_says_what_is_assumed(tmp_path):
    path = tmp_path / "r.csv"
    rng = np.random.default_rng(1)
    rows = [
        f"p{k},{d},{-40 - 25 * np.log10(d) + rng.normal(0, 3):.1f}"
        for k, d in enumerate(np.linspace(1, 30, 40))
    ]
    path.write_text("place,distance_m,rss_dbm\n" + "\n".join(rows))
    spread, found, why_not = channel.measured(fit(read_readings(path)))
    assert found is None and "no positions" in why_not and "assumed" in spread.assumed


def test_lengths_are_said_without_powers_of_ten() -> None:
    assert [channel._metres(length) for length in (0.031, 1.44, 16.2, 188.0, 2440.0)] == [
        "0.031", "1.4", "16", "190", "2400"
    ]  # fmt: skip
