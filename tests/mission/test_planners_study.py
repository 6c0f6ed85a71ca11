"""The study that compares two planners pairs missions of one seed."""

import pytest

from mission.lab.study.planners import SCENARIOS, paired


def test_differences_are_those_of_missions_that_found_all_both_times() -> None:
    before = [{"time_s": t} for t in (700.0, 500.0, None, 900.0)]
    now = [{"time_s": t} for t in (600.0, 520.0, 400.0, 780.0)]
    told = paired(before, now)
    assert told["pairs"] == 3
    assert told["later_s"] == pytest.approx(-200.0 / 3.0)
    assert told["standard_error_s"] == pytest.approx(43.72, abs=0.01)
    assert paired(before[2:3], now[2:3]) == {"pairs": 0, "later_s": None, "standard_error_s": None}


def test_both_planners_fly_each_number_of_sources() -> None:
    flown = {(each.sources, each.planner, each.keep_teams) for each in SCENARIOS}
    ways = (("infogain", False), ("infogain", True), ("infogain1", False))
    assert flown == {(count, *way) for count in (1, 2, 4, 8) for way in ways}
