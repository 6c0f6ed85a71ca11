"""The comparison's own parts: each method finds one plain source in plenty of readings."""

from dataclasses import replace

import numpy as np
import pytest

from fieldkit.messages import Detection
from fieldkit.world.channel import sample_rss_dbm
from fieldkit.world.sources import TransientSource
from mission.lab.compare_beliefs import METHODS, Recorded, score
from mission.lab.study.trust import antenna, settings

PLACE = (12.3, 11.7)


def around_one_source() -> Recorded:
    engine = settings(3)
    rng = np.random.default_rng(3)
    kept = Recorded(engine, (TransientSource(*PLACE, -4.0, 0.05),))
    for _ in range(30):
        robots = np.array(PLACE) + rng.normal(0.0, 1.2, (6, 2))
        rss = sample_rss_dbm(antenna(), np.hypot(*(robots - PLACE).T), -4.0, rng)
        if not np.isnan(rss).all():
            kept.heard.append(Detection(0, engine.robots, robots, np.zeros(6), rss, np.zeros(6, dtype=bool)))
    return kept


@pytest.mark.parametrize("name", METHODS)
def test_every_method_places_one_plain_source(name: str) -> None:
    if name.startswith("Stone Soup"):
        pytest.importorskip("stonesoup", reason="Stone Soup is in the dev extra")
    result = score([around_one_source()], METHODS[name])
    assert result["median_error_m"] is not None and result["median_error_m"] < 0.6
    assert result["false_finds_a_mission"] == 0.0


def test_a_find_far_from_every_source_is_counted_as_false() -> None:
    moved = around_one_source()
    moved = replace(moved, sources=(TransientSource(3.0, 3.0, -4.0, 0.05),))
    result = score([moved], METHODS["intensity"])
    assert result["false_finds_a_mission"] == 1.0 and result["sources_found"] == 0
