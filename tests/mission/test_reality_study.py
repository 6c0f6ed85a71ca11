"""The study on real readings: its form, its numbers on a few surveys, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from fieldkit.errors import ConfigError, DataError
from mission.lab.study import reality
from mission.lab.study.datasets import read_all
from mission.lab.study.plot import plot_surveys

DATA = Path(__file__).parents[3] / "shared" / "datasets"
shared = pytest.mark.skipif(not DATA.is_dir(), reason="the shared data sets are not here")


def made_up(folder, transmitters=3):
    """A campaign under the model's own law: 4 dB from place to place."""
    rng = np.random.default_rng(5)
    truth = {}
    for number in range(transmitters):
        source = rng.uniform(2.0, 18.0, 2)
        truth[f"T{number}"] = source.tolist()
        place = np.array(
            [(east, north) for north in range(0, 21, 3) for east in range(0, 21, 3)], dtype=float
        )
        away = np.maximum(np.hypot(*(place - source).T), 0.3)
        level = -45.0 - 22.0 * np.log10(away) + rng.normal(0.0, 4.0, away.size)
        rows = "\n".join(f"{k},{value:.1f}" for k, value in enumerate(level))
        (folder / f"T{number}_readings.csv").write_text(f"time_s,rss_dbm\n{rows}\n")
        rows = "\n".join(f"{k},{east},{north}" for k, (east, north) in enumerate(place))
        (folder / f"T{number}_positions.csv").write_text(f"time_s,east_m,north_m\n{rows}\n")
    (folder / "truth.json").write_text(json.dumps(truth))


def test_a_made_up_campaign_gives_the_documented_form(tmp_path):
    made_up(tmp_path)
    result = reality.run(1, 0, lambda share, text: None, data=tmp_path)
    total = result["all"]
    assert total["n"] == 3 and set(result["datasets"]) == {tmp_path.name}
    for key in ("covered_50", "covered_90", "median_error_m", "p90_error_m", "finds", "finds_outside_region"):
        assert key in total
    assert total["several_candidates"] == 0 and total["covered_90"] >= 2
    assert {"strongest_reading", "least_squares", "independent_grid"} <= set(total["baselines"])
    plot_surveys(result, tmp_path / "reality.png")
    assert (tmp_path / "reality.png").stat().st_size > 10_000


def test_what_cannot_be_read_is_named(tmp_path):
    with pytest.raises(ConfigError, match="--data"):
        reality.run(1, 0, lambda share, text: None)
    with pytest.raises(DataError, match="no data set"):
        read_all(tmp_path)
    (tmp_path / "truth.json").write_text('{"A": [1, 2]}')
    with pytest.raises(DataError, match="A_readings"):
        read_all(tmp_path)


@shared
def test_an_office_of_real_access_points():
    result = reality.run(1, 0, lambda share, text: None, data=DATA / "localise" / "wifi_office")
    total = result["all"]
    assert total["n"] == 5 and total["covered_90"] >= 4
    assert total["several_candidates"] == 0 and total["finds_beyond_3_sigma"] == 0
    assert total["median_error_m"] < 2.0


@shared
def test_flights_are_read_as_two_data_sets():
    sets = read_all(DATA / "find_a_rover")
    assert [each.name for each in sets] == ["find_a_rover_at_180_s", "find_a_rover_at_600_s"]
    flight = sets[0].surveys[0]
    assert flight.t_s.max() <= 181.0 and 20.0 < np.median(flight.place_m[:, 2]) < 60.0
    # Calibrated on the other two places alone.
    assert len(flight.calibration) == 4 and all(
        np.hypot(*(each.source_m - flight.truth_m)[:2]) > 50.0 for each in flight.calibration
    )
