"""Orders of two laptops that walk between robots: all obey the last one in the end, whatever the network does."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as budget
from hypothesis import strategies as st
from sizes import size

from fieldkit.engine.decentralised.logs import TICK_NS, Logs
from fieldkit.engine.decentralised.sealing import Seal, session_key
from fieldkit.engine.decentralised.talk import WATCHERS, Talk
from fieldkit.messages import Operator, Tick
from fieldkit.world.network import Air, Network
from mission.core.agent import Agent
from mission.core.kernel_settings import KernelSettings
from mission.core.watcher import Watcher
from mission.lab.synthetic import small_mission

S = 1_000_000_000
START_NS = 1_800_000_000 * S
KEY = session_key(bytes(32), "a mission")
NAMES = ("r1", "r2")
PLACES = ((0.0, 0.0), (60.0, 0.0), (30.0, 80.0))
"""Of the robots, and one out of everybody's reach: within 50 m members hear each other."""
QUIET_S = 60


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> KernelSettings:
    return small_mission(tmp_path_factory.mktemp("orders"), robots=2).kernel


class Team:
    """Two robots that stand out of each other's reach, and two laptops."""

    def __init__(self, settings: KernelSettings, air: Air, seed: int) -> None:
        robots = settings.engine.robots
        self.rng = np.random.default_rng(seed)
        self.agents = {
            name: Agent(settings, Talk(Logs(name, robots), Seal(KEY, number)))
            for number, name in enumerate(robots)
        }
        self.laptops = {
            f"laptop {number}": Watcher(settings, Talk(Logs("", robots), Seal(KEY, number)))
            for number in WATCHERS[:2]
        }
        self.network = Network(air, np.random.default_rng([seed, 1]))
        self.at = {"r1": 0, "r2": 1, "laptop 128": 0, "laptop 129": 2}
        self.does = dict.fromkeys(NAMES, "")
        self.tick = 0

    @property
    def now_ns(self) -> int:
        return START_NS + self.tick * TICK_NS

    def places(self) -> dict[str, tuple[float, float]]:
        return {name: PLACES[at] for name, at in self.at.items()}

    def send(self, name: str, data: bytes) -> None:
        self.network.send(self.tick / 2, name, data, self.places())

    def order(self, name: str, action: str) -> None:
        said = Operator(self.now_ns, action)  # type: ignore[arg-type]
        if name in self.laptops:
            _, data = self.laptops[name].give(said, self.now_ns)
        else:  # in the terminal of a robot's agent
            self.does[name] = action
            self.agents[name].step(said)
            data = self.agents[name].talk.order(said, self.now_ns)
        self.send(name, data)

    def step(self) -> None:
        for name, data in self.network.arrived(self.tick / 2):
            if name in self.laptops:
                self.laptops[name].take(data, self.now_ns)
                continue
            agent = self.agents[name]
            for order in agent.take(data, self.now_ns):
                self.does[name] = order.action
            for order in agent.unlogged:
                self.does[name] = order.action
                agent.step(order)
                self.send(name, agent.talk.order(order, self.now_ns))
            agent.unlogged.clear()
        for name, member in (self.agents | self.laptops).items():  # type: ignore[operator]
            if isinstance(member, Agent):
                member.step(Tick(self.now_ns))
            for message in member.messages(self.now_ns):
                self.send(name, message)
        self.tick += 1


@budget(max_examples=size(6, 30), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 10**6),
    loss=st.sampled_from([0.0, 0.3, 0.6]),
    delay_s=st.sampled_from([0.05, 1.0]),
    jitter_s=st.sampled_from([0.0, 1.0]),
)
def test_every_robot_obeys_the_last_order_in_the_end(
    settings: KernelSettings, seed: int, loss: float, delay_s: float, jitter_s: float
) -> None:
    team = Team(settings, Air(50.0, loss, delay_s, jitter_s, repeated=0.2), seed)
    rng, last = np.random.default_rng([seed, 2]), ""
    for _ in range(8):
        for name in team.laptops:
            team.at[name] = int(rng.integers(3))
        if rng.random() < 0.7:
            last = str(rng.choice(["hold", "resume"]))
            team.order(str(rng.choice(list(team.at))), last)
        for _ in range(2 * 8):
            team.step()
    laptops = list(team.laptops)
    for end in range(4):  # both come round to both robots once more
        team.at |= {laptops[0]: end % 2, laptops[1]: (end + 1) % 2}
        for _ in range(2 * QUIET_S):
            team.step()
    assert set(team.does.values()) == {last}
    for laptop in team.laptops.values():
        assert laptop.orders.waiting == [] and not laptop.unheld()
        assert {order.action for order, _ in laptop.orders.standing().values()} <= {last}
    logs = [agent.logs for agent in team.agents.values()]
    for stream in (0, 1, 2):
        for name in NAMES:
            one, other = (each.entries[name, stream] for each in logs)  # type: ignore[index]
            assert list(one)[: len(other)] == list(other)[: len(one)]
    assert not any(agent.talk.lost or agent.logs.left_out for agent in team.agents.values())


def test_the_small_world_is_one_in_which_robots_do_not_hear_each_other(settings: KernelSettings) -> None:
    team = Team(settings, Air(50.0), 1)
    team.at |= dict.fromkeys(team.laptops, 2)
    team.order("laptop 128", "hold")
    for _ in range(40):
        team.step()
    assert team.does == dict.fromkeys(NAMES, "") and not team.agents["r1"].talk.peers
