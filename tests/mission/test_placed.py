"""A report's places by the whole log: as wide as the channel makes them, and where the transmitters are."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import Point, Polygon

from fieldkit.messages import Detection
from mission.analysis.history import History, read_history
from mission.analysis.placed import placed
from mission.analysis.refine import Refined
from mission.analysis.report import refinements, write_report
from mission.lab.synthetic import ANTENNA, record_simulated


@pytest.fixture(scope="module")
def history(tmp_path_factory: pytest.TempPathFactory) -> History:
    return read_history(record_simulated(tmp_path_factory.mktemp("placed"), seed=3, duration_s=90.0))


def heard(at: np.ndarray, source: np.ndarray, shadow_db: np.ndarray, rng: np.random.Generator) -> Detection:
    away = np.hypot(*(source - at).T)
    rss = np.round(ANTENNA.mean_rss_dbm(away) + shadow_db + rng.normal(0.0, 2.3, len(at)))
    rss = np.where(rss > ANTENNA.threshold_dbm, rss, np.nan)
    return Detection(10**9, ("r1", "r2", "r3", "r4"), at, np.zeros(4), rss, np.zeros(4, dtype=bool))


def of_one(history: History, detections: list[Detection]) -> Refined:
    """What placing makes of a source that all of these are of."""
    alone = replace(history, detections=[(1.0 + k, each) for k, each in enumerate(detections)], tracks={})
    start = Refined(1, 5.0, 5.0, 0.0, np.eye(2), 1.0, float(len(detections)), np.ones(len(detections)))
    (found,) = placed(alone, [start])
    return found


def test_thirty_packets_at_one_place_sharpen_no_more_than_the_place_allows(history: History) -> None:
    rng = np.random.default_rng(2)
    at = np.array([[4.0, 4.0], [6.0, 4.5], [5.5, 6.5], [3.5, 6.0]])
    shadow_db = rng.normal(0.0, 2.3, 4)
    few, many = (
        of_one(history, [heard(at, np.array([5.0, 5.0]), shadow_db, rng) for _ in range(count)])
        for count in (3, 90)
    )
    assert 0.4 * few.sigma_m < many.sigma_m < 1.5 * few.sigma_m
    assert many.sigma_m > 0.25, "four places know no better than their shadows let them"


def test_the_region_holds_the_truth_as_often_as_it_says(history: History) -> None:
    inside = 0
    for seed in range(24):
        rng = np.random.default_rng(seed)
        source = rng.uniform(2.0, 8.0, 2)
        detections = []
        for _ in range(10):
            at = source + rng.normal(0.0, 1.8, (4, 2))
            detections.append(heard(at, source, rng.normal(0.0, 2.3, 4), rng))
        found = of_one(history, detections)
        outer = max((Polygon(ring) for ring in found.region), key=lambda each: each.area)
        inside += outer.contains(Point(source))
    assert inside >= 19, "of 24 by 90 %: fewer are seen once in 60 times"


def test_a_mission_whose_channel_has_no_place_noise_keeps_its_refinement(tmp_path: Path) -> None:
    log = record_simulated(tmp_path, seed=3, duration_s=60.0, engine={"place_noise": False})
    assert all(each.region == () for each in refinements(read_history(log)))


def test_the_page_shows_the_region_and_says_what_it_is(history: History, tmp_path: Path) -> None:
    assert any(each.region for each in refinements(history))
    write_report(history.recording.path, tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "sharing its shadowing (blue, the region that holds it with 90 %)" in " ".join(page.split())
