"""The trust study's own arithmetic: what is hidden comes from the seed, and no mission is counted twice or left out."""

from itertools import combinations
from math import dist, inf

from mission.lab.study.trust import SCENARIOS, Job, by_nearest_pair

FOUR = next(scenario for scenario in SCENARIOS if scenario.name == "4 sources")
ONE = next(scenario for scenario in SCENARIOS if scenario.name == "1 source")


def test_what_is_hidden_comes_from_the_seed_alone() -> None:
    assert Job(FOUR, 3).sources() == Job(FOUR, 3).sources() != Job(FOUR, 4).sources()
    assert len(Job(FOUR, 3).sources()) == 4


def test_the_nearest_pair_is_the_least_of_all_distances() -> None:
    places = [(source.east_m, source.north_m) for source in Job(FOUR, 3).sources()]
    gaps = sorted(dist(a, b) for a, b in combinations(places, 2))
    assert len(gaps) == 6 and Job(FOUR, 3).nearest_pair_m() == gaps[0]
    assert Job(ONE, 3).nearest_pair_m() == inf


def test_missions_are_dealt_out_by_how_near_their_sources_are() -> None:
    jobs = [Job(FOUR, seed) for seed in range(40)]
    rows = [{"time_s": None if job.seed == 0 else 100.0 + job.seed} for job in jobs]
    dealt = by_nearest_pair(list(zip(jobs, rows, strict=True)))
    near = [100.0 + job.seed for job in jobs[1:] if job.nearest_pair_m() < 2.0]
    assert dealt["under 2 m"]["missions"] == len(near) > 0
    assert dealt["under 2 m"]["mean_time_s"] == sum(near) / len(near)
    assert sum(part["missions"] for part in dealt.values()) == 39
