"""What the kernel makes of its belief: finds, removals, what waits, and when it is thought over."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from light import S, light_settings

from fieldkit.messages import (
    Detection,
    EndMission,
    Listening,
    Operator,
    Plan,
    Pose,
    RssReading,
    SourceEstimate,
    Tick,
    VehicleState,
    Waypoint,
)
from mission.core.kernel import MOST_AT_ONCE, MOST_WAITING, REFLECT_S, Kernel, Outcome, state_digest
from mission.core.kernel_settings import KernelSettings


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> KernelSettings:
    return light_settings(tmp_path_factory.mktemp("mission"))


def source(ident: int, state: str = "found", note: str = "") -> SourceEstimate:
    return SourceEstimate(ident, 3.0, 4.0, np.eye(2), 4, 5.25, 0.1, 1.0, 0.93, state, note)  # type: ignore[arg-type]


class Scripted:
    """A belief that believes what a test says."""

    def __init__(self) -> None:
        self.believed: list[SourceEstimate] = []
        self.taken: list[int] = []
        self.stretches: list[Listening] = []
        self.reflections = self.looks = self.asked = 0
        self.changes_its_mind = False
        self.left = 1.0

    def listen(self, listening: Listening) -> None:
        self.stretches.append(listening)

    def detect_all(self, detections: Sequence[Detection]) -> None:
        self.taken += [d.t_ns for d in detections]

    def reflect(self) -> bool:
        self.reflections += 1
        return self.changes_its_mind

    def sources(self) -> list[SourceEstimate]:
        self.looks += 1
        return self.believed

    def probability_left(self) -> float:
        self.asked += 1
        return self.left

    def digest(self) -> bytes:
        return bytes(32)


class Driven:
    """A kernel with a belief and a planner that say what a test wants."""

    TEAM_BY_TEAM = False

    def __init__(self, settings: KernelSettings, *, team_by_team: bool = False) -> None:
        self.kernel, self.belief = Kernel(settings), Scripted()
        self.kernel.belief = self.belief  # type: ignore[assignment]
        self.kernel.planner = self  # type: ignore[assignment]
        self.TEAM_BY_TEAM = team_by_team  # type: ignore[misc]
        self.asked: list[Any] = []
        self.robots = settings.engine.robots
        self.posed_s = 0.0
        self.stand(1.0)
        for robot in self.robots:
            self.kernel.step(VehicleState(0, robot, "guided", True))

    def plan(self, situation: Any, belief: Any) -> Plan:
        self.asked.append(situation)
        return Plan(situation.t_ns, {robot: (Waypoint(5.0, 5.0, 0.4),) for robot in self.robots})

    def stand(self, until_s: float) -> None:
        """Poses of robots that stand where they are, twice a second."""
        while self.posed_s < until_s:
            self.posed_s += 0.5
            for k, robot in enumerate(self.robots):
                self.kernel.step(Pose(round(self.posed_s * S), robot, 2.0 + k, 1.0))

    def tick(self, t_s: float) -> Outcome:
        self.stand(t_s)
        return self.kernel.step(Tick(round(t_s * S)))

    def hear(self, t_s: float, robot: str = "r1") -> None:
        self.kernel.step(RssReading(round(t_s * S), robot, -60.0))

    def believe(self, *sources: SourceEstimate) -> None:
        self.belief.believed = list(sources)
        self.belief.changes_its_mind = True


def notes(outcome: Outcome) -> list[str]:
    return [note for note in outcome.notes if "source" in note]


# Finds


def test_a_find_is_noted_once_with_its_time_and_lost_with_its_reason(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.tick(10)
    field.believe(source(1, "candidate"))
    assert notes(field.tick(11)) == [] and field.kernel.found_at_s == {}
    field.believe(source(1))
    assert notes(field.tick(12)) == ["found source 1 at 3.00 m east, 4.00 m north (P 0.93, 5.2 receptions)"]
    field.believe(source(1), source(2))
    assert len(notes(field.tick(14))) == 1
    assert field.kernel.found_at_s == {1: 2.0, 2: 4.0}
    field.believe(source(1, "candidate", "heard too seldom"), source(2))
    assert notes(field.tick(15)) == ["source 1 is no longer found: heard too seldom"]
    field.believe(source(1, "candidate"))
    assert notes(field.tick(16)) == ["source 2 is no longer found: merged with another"]
    assert field.kernel.found_at_s == {}


def test_only_a_belief_that_has_changed_is_looked_at(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.belief.believed = [source(1)]
    field.tick(10)
    assert field.belief.looks == 0 and field.kernel.found_at_s == {}
    field.belief.changes_its_mind = True
    field.tick(11)
    assert field.belief.looks == 1 and field.kernel.found_at_s == {1: 1.0}
    field.kernel.sources()
    assert field.belief.looks == 1, "it has not changed since"


def test_a_find_makes_everybody_plan_anew(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.tick(10)
    field.believe(source(1))
    assert field.tick(11).plan is not None
    assert field.tick(12).plan is None, "nothing more was found"
    field.believe(source(1, "candidate"))
    assert field.tick(13).plan is not None, "one less"
    assert len(field.asked) == 3


def test_a_source_that_was_taken_away_counts_if_it_had_been_found(settings: KernelSettings) -> None:
    field = Driven(replace(settings, sources_expected=2))
    field.tick(10)
    field.believe(source(1), source(2, "candidate"))
    field.tick(11)
    for ident in (1, 2):
        (said,) = field.kernel.step(Operator(12 * S, "remove", source=ident)).notes
        assert said == f"operator: source {ident} has been taken away"
    assert [s.state for s in field.kernel.sources()] == ["removed", "removed"]
    assert notes(field.tick(13)) == [] and field.kernel.found_at_s == {1: 1.0}
    field.believe(source(1), source(2), source(3))
    last = field.tick(14)
    assert [c.reason for c in last.commands if isinstance(c, EndMission)] == [
        "all 2 expected sources are found"
    ]
    assert last.plan is None and field.kernel.found_at_s == {1: 1.0, 3: 4.0}


def test_the_planner_is_told_what_was_taken_away(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.believe(source(1))
    field.tick(10)
    field.kernel.step(Operator(11 * S, "remove", source=1))
    field.kernel.step(Operator(11 * S, "resume"))
    field.tick(12)
    assert [situation.removed for situation in field.asked] == [frozenset(), frozenset({1})]
    assert field.asked[-1].t_ns == 12 * S and field.asked[-1].teams == settings.engine.teams


# What is heard


def test_little_is_taken_in_at_once_and_more_than_can_wait_is_left_out(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.tick(5)
    flood = MOST_WAITING + 7
    for k in range(flood):
        field.hear(10.0 + 0.11 * k)
    first = field.tick(35)
    assert first.notes == ("more is heard than can be thought about: the oldest transmissions are left out",)
    assert len(first.detections) == len(field.belief.taken) == MOST_AT_ONCE
    assert field.belief.taken[0] == round((10.0 + 0.11 * 7) * S) and field.kernel.left_out == 7
    assert field.tick(35.1).notes == () and field.kernel.detections == 2 * MOST_AT_ONCE
    for k in range(2 * MOST_AT_ONCE + 3):
        field.hear(36.0 + 0.11 * k)
    assert field.tick(40).notes == (), "said once"
    assert field.kernel.left_out == 7 + 3


def test_as_much_as_can_wait_waits(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.tick(5)
    for k in range(MOST_WAITING):
        field.hear(10.0 + 0.11 * k)
    assert field.tick(35).notes == () and field.kernel.left_out == 0


def test_it_is_thought_over_when_nothing_is_heard_or_not_for_long(settings: KernelSettings) -> None:
    for off_s, reflections in ((0.0, 1), (0.01, 2)):
        field = Driven(settings)
        field.tick(20)
        assert field.belief.reflections == 1
        for k in range(40):
            field.hear(19.0 + 0.3 * k)
        for t_s in (20.5, 21.0, 20.0 + REFLECT_S + off_s):
            assert field.tick(t_s).detections
        assert field.belief.reflections == reflections


def test_silence_goes_to_the_belief(settings: KernelSettings) -> None:
    field = Driven(settings)
    for t_s in range(10, 15):
        field.tick(t_s)
    assert [(s.t0_ns // S, s.t1_ns // S) for s in field.belief.stretches] == [
        (9, 10),
        (10, 11),
        (11, 12),
        (12, 13),
    ]


@pytest.mark.parametrize("team_by_team", [True, False])
def test_news_is_for_planners_that_go_team_by_team(settings: KernelSettings, team_by_team: bool) -> None:
    field = Driven(settings, team_by_team=team_by_team)
    field.believe(source(1, "candidate"))
    for t_s in (10, 10.5, 11):
        field.tick(t_s)
    assert field.tick(20).plan is None
    field.hear(20.0)
    assert (field.tick(22).plan is not None) == team_by_team


# Ends


def test_what_is_left_is_asked_only_when_it_may_have_changed(settings: KernelSettings) -> None:
    field = Driven(replace(settings, stop_probability_left=0.05))
    assert field.tick(10).commands and field.belief.asked == 1, "at the beginning"
    field.tick(11)
    assert field.belief.asked == 1, "nothing has changed"
    field.belief.changes_its_mind = True
    field.belief.left = 0.05
    assert not any(isinstance(c, EndMission) for c in field.tick(12).commands) and field.belief.asked == 2
    field.belief.left = 0.0499
    (end,) = [c for c in field.tick(13).commands if isinstance(c, EndMission)]
    assert end.reason == "the probability that a source is left is 0.050"
    assert field.tick(14) == Outcome(), "it is over"
    nobody_asked = Driven(settings)
    nobody_asked.tick(10)
    assert nobody_asked.belief.asked == 0


def test_the_clock_of_a_mission_starts_with_its_first_tick(settings: KernelSettings) -> None:
    field = Driven(settings)
    assert field.kernel.elapsed_s(50 * S) == 0.0
    field.tick(10)
    field.tick(20)
    assert field.kernel.elapsed_s(50 * S) == 40.0 and field.kernel.started_ns == 10 * S


# The operator


def test_a_word_to_one_is_not_to_the_others(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.tick(10)
    assert field.kernel.step(Operator(11 * S, "hold", "r1")).notes == ("operator: hold r1",)
    assert [r for r in field.robots if field.kernel.robots[r].held] == ["r1"]
    assert set(field.kernel.tasks.of) == {("r3", "r4")}
    assert field.kernel.step(Operator(11 * S, "hold", reason="rain")).notes == ("operator: hold all: rain",)
    assert not field.kernel.step(Operator(11 * S, "hold", reason="rain")).notes, "from another robot's log"
    assert all(field.kernel.robots[r].held for r in field.robots) and not field.kernel.tasks.of
    field.kernel.step(Operator(12 * S, "resume", "r1"))
    assert [r for r in field.robots if not field.kernel.robots[r].held] == ["r1"]
    assert field.kernel.step(Operator(12 * S, "hold", "stranger")).notes == ("operator: hold stranger",)


def test_the_operators_end_has_his_reason(settings: KernelSettings) -> None:
    field = Driven(settings)
    outcome = field.kernel.step(Operator(5, "end", reason="lunch"))
    assert outcome.commands == (EndMission(5, "lunch"),) and outcome.notes == ("end: lunch",)
    assert field.kernel.ended


def test_closing_ground_makes_everybody_plan_anew_round_it(settings: KernelSettings) -> None:
    field = Driven(settings)
    field.tick(10)
    square = ((4.0, 4.0), (6.0, 4.0), (6.0, 6.0), (4.0, 6.0))
    assert field.kernel.step(Operator(11 * S, "exclude", area_m=square)).notes == (
        "operator: an area was closed to all robots",
    )
    assert not field.kernel.tasks.of and field.kernel.turns.is_due(11 * S)
    assert field.kernel.planner is not field
    assert field.kernel.planner.settings.keep_out.polygons == (square,)  # type: ignore[attr-defined]


# Back inside


@pytest.mark.parametrize(
    ("place_m", "outside"),
    [((0.0, 5.0), False), ((-0.001, 5.0), True), ((5.0, 10.001), True), ((5.0, 10.0), False)],
)
def test_a_robot_outside_the_field_goes_back_in_and_its_team_waits(
    settings: KernelSettings, place_m: tuple[float, float], outside: bool
) -> None:
    field = Driven(settings)
    field.stand(2.0)
    field.kernel.step(Pose(2 * S + 1, "r1", *place_m))
    plan = field.tick(2).plan
    assert plan is not None
    (situation,) = field.asked
    assert situation.teams == ((("r3", "r4"),) if outside else settings.engine.teams)
    if outside:
        assert plan.purpose == {"r1": "back inside", "r2": "wait"} and plan.paths["r2"] == ()
        assert len(plan.paths["r1"]) == 1
    assert set(field.kernel.tasks.of) == set(settings.engine.teams)


def test_digests_tell_histories_apart(settings: KernelSettings) -> None:
    one, other = Driven(settings), Driven(settings)
    assert state_digest(one.kernel) == state_digest(other.kernel)
    other.kernel.detections += 1
    assert state_digest(one.kernel) != state_digest(other.kernel)
    other.kernel.detections -= 1
    one.tick(10)
    assert one.kernel.commands_digest() != other.kernel.commands_digest()


class Talking(Scripted):
    """A belief that has something to say of the receivers and of what is left."""

    def said(self) -> list[str]:
        return ["r1 hears too little"] if len(self.stretches) == 1 else []

    def left_words(self) -> str:
        return "of those that send once a minute"


def test_what_a_belief_says_is_noted_and_qualifies_the_end(settings: KernelSettings) -> None:
    field = Driven(replace(settings, stop_probability_left=0.05))
    field.belief = Talking()
    field.kernel.belief = field.belief  # type: ignore[assignment]
    said = [note for t_s in range(5, 15) for note in field.tick(t_s).notes]
    assert said.count("r1 hears too little") == 1
    field.belief.left, field.belief.changes_its_mind = 0.01, True
    (end,) = [c for t_s in (15, 16) for c in field.tick(t_s).commands if isinstance(c, EndMission)]
    assert end.reason == "the probability that a source is left is 0.010, of those that send once a minute"
