"""The study of bearings by turning round, in short."""

import pytest

from mission.lab.study.turn import run


def test_turns_give_the_more_bearings_the_more_a_body_shields_and_these_are_as_good_as_they_say() -> None:
    said: list[float] = []
    told = run(400, 1, lambda share, text: said.append(share))["scenarios"]
    shares = [row["with_bearing"] for row in told.values()]
    assert shares == sorted(shares) and shares[0] < 0.04 and shares[-1] > 0.97
    assert told["12 dB"]["covers"] > 0.88 and told["20 dB"]["covers"] > 0.88
    assert told["20 dB"]["off_median_deg"] < told["8 dB"]["off_median_deg"] < 25.0
    assert said[-1] == 1.0


def test_a_study_without_one_bearing_has_no_figures_for_them() -> None:
    told = run(1, 3, lambda share, text: None)["scenarios"]["0 dB"]
    assert told == pytest.approx(
        {"n": 1, "with_bearing": 0.0, "covers": None, "off_median_deg": None, "says_median_deg": None}
    )
