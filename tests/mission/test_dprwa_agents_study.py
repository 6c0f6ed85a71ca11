"""The DPRWA paper's experiments by agents, in short: what a trial says."""

import pytest

from mission.lab.study import dprwa_agents
from mission.lab.study.apart import LOOK_S
from mission.lab.study.dprwa_agents import FIG3A, LATE_S, Watch, flock, trial
from mission.lab.study.experiment import Job
from mission.lab.study.prwa import engine


def test_a_trial_by_agents_says_how_far_they_agree() -> None:
    row = trial(Job("dprwa-agents-fig3b", "agents", 4, 3), cap_s=20.0)
    assert row["value"] is None and row["simulated_s"] == 20.0
    assert row["same_belief"] and row["rings"] == row["rings_alike"] == 1 and row["ordered_too_near"] == 0
    assert 0.3 < row["nearest_m"] <= 1.6, "they start 1.6 m apart"
    assert row["mean_lag_s"] > 0.0 and 50.0 < row["most_bytes_s"] < 1_400.0


def test_the_value_of_figure_3a_is_what_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Watch, "look", lambda self: True)
    monkeypatch.setattr(Watch, "told", lambda self, time_s: {"value": time_s, "most_held": 7})
    row = trial(Job(FIG3A.name, "agents", 15, 3))
    assert (row["value"], row["time_s"]) == (7, LOOK_S)
    monkeypatch.setattr(dprwa_agents, "replicas", lambda job: {"value": job.study, "method": job.method})
    assert trial(Job(FIG3A.name, "replicas", 15, 3)) == {"value": "dprwa-fig3a", "method": "dprwa"}


def test_a_meeting_is_kept_where_its_teams_were_in_range_at_its_time() -> None:
    team = flock(engine(1, 4), "dprwa-apart", (), 1, 6.0)
    first, second = team.settings.engine.teams
    watch = Watch(team, [], 6.0, lag_s=[0.0])
    watch.meetings = {(50.0, first, second), (100.0, second, first), (199.0, first, second)}
    watch.met = [(50.0 + LATE_S, first, second), (80.0, first, second)]
    team.world.t_s, team.network.carried["r0"] = 200.0, 2_000
    told = watch.told(None)
    assert (told["meetings"], told["meetings_kept"]) == (2, 1), "the last may still come"
    assert told["most_bytes_s"] == 10.0
