"""`fieldkit bench refit` in small: it says what was measured, on how many missions, and that workers change no bit."""

import pytest

from mission.lab import bench_refit


def test_a_campaign_is_measured_with_one_worker_and_two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_refit, "SEEDS", (1,))
    monkeypatch.setattr(bench_refit, "LASTS_S", 60.0)
    measured = bench_refit.refit()
    assert measured["missions"] == 2 and measured["detections"] > 5 and measured["tiles"] == 1
    assert measured["same_bits"] and measured["done_again"] == 0
    for name in ("one_worker_s_per_mission", "two_workers_s_per_mission", "times_faster_with_two"):
        assert measured[name] > 0.0
