"""Whatever the readings are, there is a verdict or an error of ours, never a crash."""

import json
import warnings

import numpy as np
import pytest
from sizes import size

from calibration import output
from calibration.dataset import from_arrays
from calibration.fit import Options, fit
from calibration.report import report_html
from calibration.verdict import judge
from fieldkit.channel.antenna_file import dump_antenna
from fieldkit.errors import FieldkitError


def odd_readings(seed):
    rng = np.random.default_rng(seed)
    places, packets = rng.integers(1, 60), rng.integers(1, 15)
    distance = np.repeat(np.exp(rng.uniform(-3, 3, places) * rng.choice([0.01, 0.3, 1])), packets)
    level = (
        -60
        - rng.uniform(-5, 40) * np.log10(distance)
        + rng.normal(0, rng.choice([0, 0.3, 3, 12]), len(distance))
    )
    level = np.minimum(np.round(level), rng.choice([-1, -50]))
    level = np.where(level > rng.choice([-200, -75, -60]), level, np.nan)
    if rng.random() < 0.2:
        level[rng.random(len(level)) < 0.3] = np.nan
    options = Options(
        rng.choice(["auto", "none", "uncounted", "counted"]), receiver_offsets=rng.random() < 0.2
    )
    return from_arrays(distance, level), options


@pytest.mark.parametrize("block", range(5))
def test_there_is_always_a_verdict_or_an_error_of_ours(block):
    for seed in range(40 * block, 40 * block + 40):
        readings, options = odd_readings(seed)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # What an earlier test left unclosed is collected at any time, and is no warning about these readings.
            warnings.simplefilter("ignore", ResourceWarning)
            try:
                result = fit(readings, options)
                judgement = judge(result)
            except FieldkitError:
                continue
            json.dumps(output.plain(result, judgement), allow_nan=False)
            assert output.words(result, judgement)
            assert dump_antenna(output.antenna_file(result, judgement))


def test_a_report_can_be_written_of_any_fit():
    for seed in range(size(2, 6)):
        readings, options = odd_readings(seed)
        try:
            result = fit(readings, options)
        except FieldkitError:
            continue
        assert "</html>" in report_html(result, judge(result))
