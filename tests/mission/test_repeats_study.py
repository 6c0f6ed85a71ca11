"""More readings at the same places make a survey no sharper than the places allow."""

from mission.lab.study.repeats import SCENARIOS, Job, run, trial


def test_ten_readings_a_place_sharpen_no_more_than_the_shadow_allows() -> None:
    told = run(12, 0, lambda *_: None, workers=1)["scenarios"]
    once, ten = told["1 reading a place"], told["10 readings a place"]
    assert ten["stated_m"] > 0.8 * once["stated_m"]
    assert min(row["covered_90"] for row in told.values()) >= 0.75


def test_the_first_reading_of_each_place_is_the_same_whatever_the_number() -> None:
    one, again = trial(Job(SCENARIOS[0], 3)), trial(Job(SCENARIOS[0], 3))
    assert one == again
    assert abs(one["error_m"] - trial(Job(SCENARIOS[2], 3))["error_m"]) < 3.0
