"""Agents that plan with `dprwa-apart` plan the same rings out of contact, and keep their meetings (Lemma 2)."""

from dataclasses import replace

from fieldkit.channel.model import Antenna
from fieldkit.engine.decentralised.logs import TICK_NS
from fieldkit.engine.grid import Grid
from fieldkit.engine.planning.dprwa_apart import DprwaApartPlanner
from fieldkit.engine.settings import EngineSettings
from fieldkit.world.network import Air
from fieldkit.world.sources import TransientSource
from mission.core.kernel_settings import KernelSettings
from mission.lab.flock import START_NS, Flock
from mission.lab.simulate import Truth
from mission.safety.limits import SafetySettings

ROBOTS, FIELD_M, RANGE_M, TAU0_S = ("r1", "r2"), 14.0, 4.0, 100.0
S = 10**9


def flock(planner: str) -> Flock:
    antenna = Antenna(2.53, -76.4, 3.3, -90.0)
    engine = EngineSettings(
        Grid(FIELD_M, FIELD_M, 1.0), antenna, (("r1",), ("r2",)), (0.0,), prior_rule="dirichlet", seed=4,
        sensing="levels", planning_period_s=40.0,
    )  # fmt: skip
    tuned = replace(engine.tuning, ridges=replace(engine.tuning.ridges, dprwa_tau0_s=TAU0_S))
    kernel = KernelSettings(replace(engine, tuning=tuned), "spog", planner, max_duration_s=1e5)
    sources = (TransientSource(3.0, 11.0, 0.0, 0.2), TransientSource(11.0, 11.0, 0.0, 0.2))
    truth = Truth(antenna, sources, ((2.0, 1.0), (5.0, 1.0)))
    safety = SafetySettings(ROBOTS, FIELD_M, FIELD_M, min_separation_m=0.5)
    return Flock(kernel, safety, truth, Air(range_m=RANGE_M), 1, contact_m=RANGE_M)


def test_agents_out_of_contact_plan_the_same_rings_and_meet_on_them() -> None:
    team = flock("dprwa-apart")
    team.begin()
    rings: dict[tuple[str, int], tuple[int, int]] = {}
    meetings_ns: set[int] = set()
    apart, whole_ns = 0, []
    while len(rings) < 6 and team.world.t_s < 300.0:
        team.step()
        now_ns = START_NS + round(team.world.t_s * S)
        apart += all(len(agent.line.members) == 1 for agent in team.agents.values())
        for name, agent in team.agents.items():
            planner = agent.line.kernel.planner
            assert isinstance(planner, DprwaApartPlanner)
            if planner.period:
                rings[name, planner.period] = planner.ring_ns, planner.until_ns
                meetings_ns |= {t_ns for t_ns, *_ in planner.meetings_ns if t_ns < now_ns}
        if all(agent.common.horizon * TICK_NS > now_ns - 5 * S for agent in team.agents.values()):
            whole_ns.append(now_ns)
    periods = {period for _, period in rings}
    assert periods == {1, 2, 3} and apart > 100, "the third ring must have been planned apart"
    assert all(rings["r1", period] == rings["r2", period] for period in periods)
    assert len(meetings_ns) == 2
    for t_ns in meetings_ns:
        assert min(abs(t_ns - each) for each in whole_ns) < 10 * S
    assert team.agrees()
