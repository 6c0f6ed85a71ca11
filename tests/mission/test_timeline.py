"""Whoever has the same logs up to a tick has the same kernel, however and in whatever steps they came to know them."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import settings as budget
from hypothesis import strategies as st

from fieldkit.channel.model import Antenna
from fieldkit.engine.decentralised.logs import NEVER, STEP_NS, TICK_NS, Log, Logs, Part
from fieldkit.engine.decentralised.packing import quantised
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Operator, Pose, RssReading
from mission.core.kernel import Kernel
from mission.core.kernel_settings import KernelSettings
from mission.core.timeline import Timeline

ROBOTS = ("a", "b", "c", "d")
START_NS = 1_800_000_000 * 10**9
TICKS = 16


def kernel() -> Kernel:
    engine = EngineSettings(
        Grid(6.0, 6.0, 1.0), Antenna(2.5, -50.0, 3.3, -70.0), (("a", "b"), ("c", "d")), planning_period_s=3.0
    )
    return Kernel(KernelSettings(engine, belief="spog", planner="random-walk", association_lateness_s=0.5))


def observed(seed: int) -> tuple[Logs, dict[int, dict[str, int]]]:
    """Everybody's own logs in one, and how many entries of each were there when each tick was closed."""
    rng = np.random.default_rng(seed)
    whole: dict[str, Logs] = {name: Logs(name, ROBOTS) for name in ROBOTS}
    begins = dict(zip(ROBOTS, rng.integers(0, 4, len(ROBOTS)), strict=True))
    then: dict[int, dict[str, int]] = {}
    for k in range(TICKS):
        now_ns = START_NS + k * TICK_NS
        for name, logs in whole.items():
            if k < begins[name]:
                continue
            logs.append(quantised(Pose(now_ns, name, *rng.uniform(1.0, 5.0, 2).tolist())), now_ns)
            if rng.random() < 0.4:
                late_ns = int(rng.integers(-5_000, 5_000)) * STEP_NS
                logs.append(quantised(RssReading(now_ns + late_ns, name, -60.0 - k)), now_ns)
            if rng.random() < 0.05:
                logs.append(Operator(now_ns, "hold" if k % 2 else "resume", None, ""), now_ns)
            logs.close(now_ns)
        tick = now_ns // TICK_NS
        then[tick] = {
            f"{key[0]} {key[1]}": len(logs.entries[key])
            for logs in whole.values()
            for key in Logs.keys((logs.me,))
        }
    together = Logs("a", ROBOTS)
    for name, logs in whole.items():
        for key in Logs.keys((name,)):
            together.entries[key] = logs.entries[key]
            together.closed[key] = logs.closed[key]
    return together, then


def at_once(logs: Logs, tick: int) -> tuple[str, str]:
    line = Timeline(kernel(), ROBOTS)
    line.step_to(logs, tick, 10**6)
    return line.kernel.digest(), line.kernel.commands_digest()


@budget(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), loss=st.sampled_from([0.0, 0.4]), me=st.sampled_from(ROBOTS))
def test_any_order_of_delivery_loss_and_repetition_gives_one_belief_and_one_plan(
    seed: int, loss: float, me: str
) -> None:
    whole, then = observed(seed)
    rng = np.random.default_rng([seed, 1])
    mine = Logs(me, ROBOTS)
    line = Timeline(kernel(), ROBOTS)
    looked, keys = 0, list(whole.entries)
    for number in range(500):
        last = number >= 450  # in the end everything has come
        key = keys[number % len(keys) if last else int(rng.integers(len(keys)))]
        log = whole.entries[key]
        first, size = (0, len(log)) if last else (int(rng.integers(len(log) + 1)), int(rng.integers(1, 9)))
        if last or rng.random() >= loss:
            mine.take(Part(*key, first, tuple(log[first : first + size])))
        tick = int(rng.choice(list(then)))
        mine.learn(key, then[tick][f"{key[0]} {key[1]}"], tick)
        if (checkpoint := mine.checkpoint()) > NEVER:
            line.step_to(mine, checkpoint, int(rng.integers(1, 9)))
            looked += 1
    assert mine.left_out == 0 and looked and line.horizon > START_NS // TICK_NS + 8
    assert (line.kernel.digest(), line.kernel.commands_digest()) == at_once(whole, line.horizon)


def test_a_copy_that_waits_for_some_alone_is_the_same_for_all_who_have_the_same() -> None:
    whole, _ = observed(5)
    last = whole.checkpoint()
    digests = set()
    for copied_at in (last - 8, last - 4):
        line = Timeline(kernel(), ROBOTS)
        line.step_to(whole, copied_at, 10**6)
        twin = line.copy(("a", "c"))
        assert twin.members == ("a", "c") and not twin.has_missed(whole)
        twin.step_to(whole, last, 10**6)
        digests.add((twin.kernel.digest(), twin.kernel.commands_digest()))
        assert line.horizon == copied_at
    assert digests == {at_once(whole, last)}


def test_what_comes_to_be_known_too_late_is_noticed() -> None:
    whole, _ = observed(6)
    key = next(key for key, log in whole.entries.items() if key[0] == "d" and len(log) > 3)
    partly = replace(whole)
    partly.entries = {each: Log(*each, log) for each, log in whole.entries.items()}
    known, rest = partly.entries[key][:2], partly.entries[key][2:]
    partly.entries[key] = Log(*key, known)
    line = Timeline(kernel(), ("a", "b", "c"))
    line.step_to(partly, whole.checkpoint(), 10**6)
    assert not line.has_missed(partly)
    partly.entries[key].extend(rest)
    assert line.has_missed(partly)
