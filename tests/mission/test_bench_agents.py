"""The bench of HOLD ALL over Zenoh reaches every vehicle; how soon is for the bench to say."""

import pytest

from mission.lab import bench_agents

pytest.importorskip("zenoh")


def test_a_hold_at_one_agent_reaches_all_vehicles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench_agents, "ROBOTS", 2)
    monkeypatch.setattr(bench_agents, "ROUNDS", 2)
    monkeypatch.setattr(bench_agents, "LIMIT_S", 20.0)
    monkeypatch.setattr(bench_agents, "APART_S", 0.2)
    told = bench_agents.hold_agents()
    assert (told["agents"], told["holds"], told["not_reached"]) == (2, 2, 0)
    assert set(told["own_vehicle_ms"]) == set(told["other_vehicles_ms"]) == {"median", "p99", "worst"}
