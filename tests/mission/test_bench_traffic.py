"""The bench of what agents send keeps to what a telemetry radio can carry; its figures are for the bench to say."""

import pytest

from fieldkit.settings import AGENT_BYTES_S
from mission.lab import bench_traffic


def test_eight_agents_in_contact_send_less_than_they_may(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, seconds in (("TALKS_S", 30.0), ("HOUR_S", 60.0), ("AWAY_S", 20.0)):
        monkeypatch.setattr(bench_traffic, name, seconds)
    told = bench_traffic.agent_traffic()
    four, eight = told["4_robots_bytes_s"], told["8_robots_bytes_s"]
    assert 0.0 < four["all"] < eight["all"] < AGENT_BYTES_S.default
    assert eight["all"] == pytest.approx(sum(each for kind, each in eight.items() if kind != "all"))
    assert 400 < told["own_bytes_of_20_s_away"] < 800
    assert 0.0 < told["laptop_learns_an_hour_of_4_in_s"] < 10.0
