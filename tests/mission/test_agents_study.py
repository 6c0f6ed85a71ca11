"""The study of agents, in short: the rows it makes, and what it makes of rows."""

import math
from typing import Any

import pytest

from mission.lab.study import agents, killed
from mission.lab.study.agents import CENTRAL, SCENARIOS, Job, summarise, trial


def scenario(name: str) -> agents.Scenario:
    return next(each for each in SCENARIOS if each.name == name)


def test_a_trial_compares_every_belief_with_that_of_one_computer() -> None:
    row = trial(Job(scenario("30 % lost"), 1, most_s=15.0))
    assert row["same"] and row["compared"] >= 8 and row["time_s"] is None and row["elapsed_s"] >= 15.0
    assert 0.0 < row["most_bytes_s"] < 400.0 and row["ordered_too_near"] == 0


def row(seed: int, time_s: float | None, **more: Any) -> dict[str, Any]:
    return {"seed": seed, "time_s": time_s, "false_finds": 0, "elapsed_s": 100.0, **more}


def test_times_are_compared_on_the_seeds_on_which_both_found_all(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = {
        "same": True, "compared": 9, "most_bytes_s": 150.0, "oldest_s": 1.0, "merged_s": 4.0, "nearest_m": 0.5,
        "ordered_too_near": 0, "could_be_known": 0,
    }  # fmt: skip
    times = {CENTRAL: (100.0, 200.0, None), "full contact": (110.0, None, 50.0)}

    def flown(job: Job) -> dict[str, Any]:
        more = {} if job.scenario.name == CENTRAL else measured
        return row(job.seed, times[job.scenario.name][job.seed], **more)

    monkeypatch.setattr(agents, "SCENARIOS", tuple(scenario(name) for name in times))
    monkeypatch.setattr(
        "mission.lab.study.scenarios.run_trials",
        lambda trial, jobs, progress, **how: [flown(job) for job in jobs],
    )
    told = agents.run(3, 0, lambda share, text: None)["scenarios"]
    assert told["full contact"]["times_central"] == 1.1 and told["full contact"]["found_all"] == 2
    assert told["full contact"]["same_belief"] and told["full contact"]["merged_within_s"] == 4.0
    assert summarise([row(0, None)])["mean_time_s"] is None


def test_a_scenario_named_in_full_is_run_alone_and_eight_are_compared_with_eight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    jobs: list[Job] = []

    def flown(trial: object, wanted: list[Job], progress: object, **how: object) -> list[dict[str, Any]]:
        jobs[:] = wanted
        return [row(job.seed, 100.0 if job.scenario.name.endswith("computer") else 80.0) for job in wanted]

    monkeypatch.setattr("mission.lab.study.scenarios.run_trials", flown)
    agents.run(2, 0, lambda share, text: None, only="30 % lost")
    assert [(job.scenario.name, job.seed) for job in jobs] == [("30 % lost", 0), ("30 % lost", 1)]
    told = agents.run(1, 0, lambda share, text: None, only="eight robots")["scenarios"]
    assert told["eight robots, full contact"]["times_central"] == 0.8
    assert {job.scenario.robots for job in jobs} == {8}


def test_eight_robots_are_a_trial_too() -> None:
    told = trial(Job(scenario("eight robots, full contact"), 1, most_s=5.0))
    assert told["same"] and told["compared"] >= 8 and told["nearest_m"] > 1.0


@pytest.mark.parametrize(
    "kill",
    [
        killed.Kill("r1", 10.0, 14.0, keeps_journal=False),
        killed.Kill("r1", 10.0, math.inf, keeps_journal=True),
        killed.Kill(killed.LAPTOP, 10.0, math.inf, keeps_journal=True),
    ],
    ids=["back without its journal", "for good", "the laptop"],
)
def test_the_others_go_on_whoever_is_killed(monkeypatch: pytest.MonkeyPatch, kill: killed.Kill) -> None:
    monkeypatch.setattr(killed, "drawn", lambda seed: kill)
    monkeypatch.setattr(killed, "AFTER_S", 25.0)
    row = trial(Job(scenario("killed"), 3))
    assert (row["victim"], row["back"]) == (kill.victim, math.isfinite(kill.away_s))
    assert row["goes_on"] and row["holds"] and row["same"] and row["compared"] >= 12
    assert row["unknown_to_others"] == 0
    told = summarise([row, row])
    assert told["trials"] == told["others_go_on"] == told["robot_holds"] == 2 and told["same_belief"]
    if kill.victim == killed.LAPTOP:
        assert 0.0 < told["all_held_within_s"] < 10.0 and told["laptop_killed"] == 2
    elif row["back"]:
        assert told["rejoined"] == told["came_back"] == told["without_journal"] == 2
        assert told["rejoined_within_s"] < 20.0


def test_an_agent_that_has_lost_its_journal_begins_when_it_has_its_whole_log_back() -> None:
    """Over a narrow link that takes longer than it listens anyway."""
    flock = killed.light_flock(1)
    flock.begin()
    for _ in range(80):
        flock.step()
    flock.kill("r1")
    for agent in flock.agents.values():
        agent.talk.bytes_s = 400.0
    flock.revive("r1", with_journal=False)
    for _ in range(30):
        flock.step()
    back = flock.agents["r1"]
    assert back.logs.has_begun and not back.talk.lost and flock.agrees()


def test_victims_and_times_are_drawn_over_all() -> None:
    kills = [killed.drawn(seed) for seed in range(200)]
    assert {kill.victim for kill in kills} == {*killed.NAMES, killed.LAPTOP}
    back = sum(math.isfinite(kill.away_s) for kill in kills)
    assert 70 < back < 130 and all(killed.EARLIEST_S <= kill.at_s <= killed.LATEST_S for kill in kills)


def test_every_scenario_has_a_name_of_its_own() -> None:
    assert len({each.name for each in SCENARIOS}) == len(SCENARIOS)
