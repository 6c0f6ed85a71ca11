"""What the default belief holds, in bytes of arrays: hours of a walk take little more than its first half hour."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fieldkit.engine.belief.intensity.belief import IntensityBelief
from fieldkit.engine.belief.intensity.freezing import kept_bytes
from fieldkit.engine.settings import EngineSettings
from fieldkit.messages import Detection, Listening
from fieldkit.tuning import IntensityTuning
from fieldkit.world.channel import sample_rss_dbm
from mission.lab.study.walk import walk_mission
from mission.lab.walk_demo import RADIO, SIZE_M

STEP_S, SPEED_M_S = 30.0, 1.2
EVERY_S = 64.0
"""Between transmissions that are heard."""


def held_bytes(root: Any) -> int:
    """Of all arrays that can be reached from an object, each once however many views there are of it."""
    seen: set[int] = set()
    total, waiting = 0, [root]
    while waiting:
        each = waiting.pop()
        while isinstance(each, np.ndarray) and isinstance(each.base, np.ndarray):
            each = each.base
        if id(each) in seen:
            continue
        seen.add(id(each))
        if isinstance(each, np.ndarray):
            total += each.nbytes
        elif isinstance(each, dict):
            waiting += [*each.keys(), *each.values()]
        elif isinstance(each, list | tuple | set | frozenset):
            waiting += each
        elif type(each).__module__.startswith("fieldkit"):
            waiting += vars(each).values() if hasattr(each, "__dict__") else ()
            slots = [name for kind in type(each).__mro__ for name in getattr(kind, "__slots__", ())]
            waiting += [
                getattr(each, name) for name in slots if hasattr(each, name) and name != "__weakref__"
            ]
    return total


class Walk:
    """A person among transmitters on lanes over the field, heard every 64 s by chance."""

    def __init__(self, engine: EngineSettings, senders: int) -> None:
        self.belief = IntensityBelief(engine)
        self._rng = np.random.default_rng(11)
        self._senders_m = self._rng.uniform(0.2 * SIZE_M, 0.8 * SIZE_M, (senders, 2))
        self._at_s = 0.0

    def go_on(self, until_s: float) -> None:
        """What is heard is taken in by four."""
        heard: list[Detection] = []
        while self._at_s < until_s:
            gone_m = SPEED_M_S * self._at_s
            lane, along_m = divmod(gone_m, SIZE_M)
            east_m = (0.13 + 0.29 * lane) % 1.0 * SIZE_M
            place_m = np.array([[east_m, along_m if lane % 2 == 0 else SIZE_M - along_m]])
            begin_ns, end_ns = round(self._at_s * 1e9), round((self._at_s + STEP_S) * 1e9)
            self.belief.listen(Listening(begin_ns, end_ns, ("walker",), place_m))
            if self._at_s % EVERY_S < STEP_S:
                heard.append(self._heard(end_ns, place_m))
            if len(heard) == 4:
                self.belief.detect_all(heard)
                heard = []
            self._at_s += STEP_S

    def _heard(self, t_ns: int, place_m: Any) -> Detection:
        """One of the transmitters that are heard here."""
        while True:
            sender = self._senders_m[self._rng.integers(len(self._senders_m))]
            rss = sample_rss_dbm(RADIO, np.hypot(*(place_m - sender).T), 0.0, self._rng)
            if not np.isnan(rss).any():
                return Detection(t_ns, ("walker",), place_m, np.zeros(1), rss, np.zeros(1, dtype=bool))


def walk_engine(**tuning: int) -> EngineSettings:
    engine = walk_mission(0).kernel.engine
    intensity = replace(engine.tuning.intensity, **tuning)
    return replace(engine, tuning=replace(engine.tuning, intensity=intensity))


def test_four_hours_of_a_walk_hold_little_more_than_its_first_half_hour() -> None:
    walk = Walk(walk_engine(), senders=12)
    walk.go_on(1_800.0)
    half_an_hour = held_bytes(walk.belief)
    walk.go_on(4 * 3_600.0)
    assert len(walk.belief.candidates) >= 3
    assert held_bytes(walk.belief) - half_an_hour < 50e6


def test_likelihoods_take_no_more_than_they_may() -> None:
    walk = Walk(walk_engine(kept_mb=8), senders=6)
    walk.go_on(2 * 3_600.0)
    mixture = walk.belief.mixture
    assert kept_bytes(mixture) <= 8e6
    assert 20 <= len(mixture.open) < 75 < mixture.tuning.max_open
    assert held_bytes([mixture.arena, mixture.open_arena]) <= 2.5 * 8e6
    # What was closed is still counted.
    receptions = sum(candidate.receptions for candidate in walk.belief.candidates)
    assert receptions == pytest.approx(112, abs=30)


def test_what_names_its_sender_needs_no_likelihood_over_the_ground() -> None:
    belief = IntensityBelief(replace(walk_engine(), identity="address"))
    at, none = np.array([[50.0, 60.0]]), np.zeros(1)
    before = belief.mixture.open_arena.held()
    belief.detect(Detection(0, ("walker",), at, none, none - 70.0, none > 0, sender="a"))
    assert belief.mixture.open_arena.held() == before
    belief.detect(Detection(0, ("walker",), at, none, none - 70.0, none > 0))
    assert belief.mixture.open_arena.held() > before


def test_the_default_bound_is_for_a_laptop_and_a_walks_for_less() -> None:
    assert walk_engine().tuning.intensity.kept_mb < IntensityTuning().kept_mb
