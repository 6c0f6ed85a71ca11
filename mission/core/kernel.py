"""The whole mission as one pure function of its inbox: association, belief, planner, phase.

`step(event)` decides; somebody else acts. It reads no clock, no file and no random state but its own seeded
generators, so feeding a recorded inbox gives the same belief and the same commands, bit for bit.
"""

import copy
import hashlib
import struct
from collections import Counter, deque
from dataclasses import dataclass, field, replace

import numpy as np

from fieldkit import plugins
from fieldkit.engine.association.detections import Associator
from fieldkit.engine.belief.base import Belief, SayingBelief
from fieldkit.engine.planning.base import Planner, Situation, Team
from fieldkit.messages import (
    Command,
    Detection,
    EndMission,
    Event,
    Listening,
    Operator,
    Plan,
    Pose,
    ReceiverState,
    RssReading,
    SourceEstimate,
    Tick,
    VehicleState,
    Waypoint,
)
from mission.core.endings import Progress, reason_to_end
from mission.core.fleet import Fleet, Robot
from mission.core.kernel_settings import KernelSettings
from mission.core.tasks import Task, Tasks
from mission.core.turns import PlanningTurns

MOST_AT_ONCE = 5
"""Transmissions taken in at one tick: a step that takes seconds would leave nobody to steer."""
MOST_WAITING = 200
REFLECT_S = 2.0
"""Thinking over waits for a moment without a transmission, but no longer than this."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one event led to."""

    commands: tuple[Command, ...] = ()
    detections: tuple[Detection, ...] = ()
    plan: Plan | None = None
    notes: tuple[str, ...] = ()


NOTHING = Outcome()


@dataclass
class Kernel:
    """See the module."""

    settings: KernelSettings
    started_ns: int | None = None
    ended: bool = False
    found_at_s: dict[int, float] = field(default_factory=dict)
    """Source identity to mission time of its (last) find."""

    def __post_init__(self) -> None:
        engine = self.settings.engine
        self.belief: Belief = plugins.load("fieldkit.beliefs", self.settings.belief)(engine)
        self.planner: Planner = plugins.load("fieldkit.planners", self.settings.planner)(engine)
        self.associator = Associator(
            engine.robots,
            window_s=self.settings.association_window_s,
            lateness_s=self.settings.association_lateness_s,
            max_pose_gap_s=self.settings.max_pose_gap_s,
            flying=self.settings.altitude_m,
        )
        self._warned: set[str] = set()
        self._order: Operator | None = None
        """The last that was noted: of a laptop's order every robot's log has a copy."""
        self.fleet = Fleet(self.settings, self.planner.teams(engine.teams))
        self.tasks = Tasks(self.settings, self.fleet)
        self.turns = PlanningTurns(engine)
        self.removed: set[int] = set()
        """Sources the operator has taken away, by identity."""
        self.detections = 0
        self._closed = engine.keep_out
        self._backlog: deque[Detection] = deque()
        self.left_out = 0
        """Transmissions that were not thought about for lack of time."""
        self._reflected_ns = 0
        self._steered_ns: int | None = None
        self._commands_digest = hashlib.sha256()
        self._sources: list[SourceEstimate] | None = None

    # -- the one entry ---------------------------------------------------------------------------------------

    def step(self, event: Event) -> Outcome:
        """Take in one event and say what to do. Unknown robots are ignored."""
        match event:
            case RssReading():
                self.associator.reading(event)
                outcome = NOTHING
            case Pose():
                self.associator.pose(event)
                self.fleet.take_in(event)
                outcome = self._height_missing(event.robot)
            case ReceiverState():
                self.associator.receiver(event)
                self.fleet.take_in(event)
                outcome = NOTHING
            case VehicleState():
                self.fleet.take_in(event)
                outcome = NOTHING
            case Operator():
                outcome = self._operator(event)
            case Tick():
                outcome = self._tick(event.t_ns)
        for command in outcome.commands:
            self._commands_digest.update(repr(command).encode())
        return outcome

    @property
    def robots(self) -> dict[str, Robot]:
        """Robot to what is known of it."""
        return self.fleet.robots

    @property
    def legs_timed_out(self) -> Counter[str]:
        """Robot to how many of its legs ended by time-out, not at their way-points."""
        return self.tasks.timed_out

    def copy(self) -> "Kernel":
        """The same state once more, to go its own way; only the settings, which never change, are shared."""
        shared = {id(each): each for each in (self.settings, self.settings.engine)}
        return copy.deepcopy(self, {**shared, id(self._commands_digest): self._commands_digest.copy()})

    def digest(self) -> str:
        """Hex digest of the belief."""
        return self.belief.digest().hex()

    def commands_digest(self) -> str:
        """Hex digest of all commands given so far."""
        return self._commands_digest.hexdigest()

    def sources(self) -> list[SourceEstimate]:
        """The belief's present estimates."""
        if self._sources is None:
            self._sources = [
                replace(source, state="removed") if source.ident in self.removed else source
                for source in self.belief.sources()
            ]
        return self._sources

    def elapsed_s(self, t_ns: int) -> float:
        """Mission time since the first tick."""
        return 0.0 if self.started_ns is None else (t_ns - self.started_ns) * 1e-9

    # -- decisions ---------------------------------------------------------------------------------------

    def _operator(self, event: Operator) -> Outcome:
        if event.action == "remove":
            return self._remove(event)
        if event.action == "exclude":
            return self._exclude(event)
        if event.action in ("mark", "bearing"):
            return self._word_of(event)
        targets = self.robots if event.robot is None else {event.robot: self.robots.get(event.robot)}
        for robot in targets.values():
            if robot is None or (event.robot is None and robot.released):
                continue  # somebody else has it, and only its own name takes it back
            if event.action in ("hold", "return", "release", "withdraw"):
                robot.held = True
                robot.released = event.action == "release" or (robot.released and event.action == "withdraw")
            elif event.action == "resume":
                robot.held = robot.released = False
        self.tasks.drop(targets)
        if event.action == "resume":
            self.turns.start_anew()
        if event.action == "end":
            return self._end(event.t_ns, event.reason or "the operator ended the mission")
        if event == self._order:
            return NOTHING
        self._order = event
        who = "safety" if event.action == "withdraw" else "operator"
        why = f": {event.reason}" if event.reason else ""
        return Outcome(notes=(f"{who}: {event.action} {event.robot or 'all'}{why}",))

    def _word_of(self, event: Operator) -> Outcome:
        """A person's word of where they stand: written down, and kept apart from the belief's."""
        robot = self.robots.get(event.robot or "")
        if robot is None or robot.pose is None:
            return Outcome(notes=(f"operator: {event.action} {event.robot}: where that is, is not known",))
        place = f"{robot.pose.east_m:.1f} m east, {robot.pose.north_m:.1f} m north"
        if event.action == "bearing":
            return Outcome(notes=(f"{event.robot} says: {event.reason}, taken at {place}",))
        return Outcome(notes=(f"{event.robot} says: a transmitter is here, at {place}",))

    def _remove(self, event: Operator) -> Outcome:
        """A transmitter that was taken away stays in the list and is looked for no more."""
        known = {source.ident for source in self.sources()}
        if event.source is None or event.source not in known:
            return Outcome(notes=(f"operator: there is no source {event.source} to remove",))
        self.removed.add(event.source)
        self._sources = None
        return Outcome(notes=(f"operator: source {event.source} has been taken away",))

    def _exclude(self, event: Operator) -> Outcome:
        """Plan anew round an area that robots must not enter from now on."""
        if len(event.area_m) < 3 or not np.isfinite(event.area_m).all():
            return Outcome(notes=("operator: an area needs at least three corners: nothing was closed",))
        self._closed = self._closed.also(event.area_m)
        planner = plugins.load("fieldkit.planners", self.settings.planner)
        self.planner = planner(replace(self.settings.engine, keep_out=self._closed))
        self.tasks.of.clear()
        self.turns.start_anew()
        return Outcome(notes=("operator: an area was closed to all robots",))

    def _tick(self, now_ns: int) -> Outcome:
        if self.ended:
            return NOTHING
        if self.started_ns is None:
            self.started_ns = now_ns
        teams = self.fleet.steerable_teams(now_ns)
        if teams or self.fleet.any_held() or self._steered_ns is None:
            self._steered_ns = now_ns  # a hold by the operator may last
        notes: list[str] = []
        detections, stretches = self._due(now_ns, notes)
        for stretch in stretches:
            self.belief.listen(stretch)
        changed = self._believe(now_ns, detections)
        if isinstance(self.belief, SayingBelief):
            notes += self.belief.said()
        found_more = changed and self._note_finds(now_ns, notes)
        if reason := self._reason_to_end(now_ns, changed):
            ended = self._end(now_ns, reason)
            return Outcome(ended.commands, tuple(detections), None, (*notes, *ended.notes))
        one_at_a_time = self.planner.TEAM_BY_TEAM
        if detections and one_at_a_time:
            self.turns.hear(now_ns, teams, detections, self.sources())
        turns = self.turns.take(
            now_ns, teams, self.tasks.of, found_more=found_more, one_at_a_time=one_at_a_time
        )
        plan = self._plan(now_ns, turns)
        commands = self.tasks.follow(now_ns, notes)
        return Outcome(tuple(commands), tuple(detections), plan, tuple(notes))

    def _believe(self, now_ns: int, detections: list[Detection]) -> bool:
        """Take in what was heard, or think it over when nothing is; whether the belief may have changed."""
        if detections:
            self.belief.detect_all(detections)
            self.detections += len(detections)
        changed = bool(detections)
        if not detections or (now_ns - self._reflected_ns) * 1e-9 > REFLECT_S:
            self._reflected_ns = now_ns
            changed = self.belief.reflect() or changed
        if changed:
            self._sources = None
        return changed

    def _due(self, now_ns: int, notes: list[str]) -> tuple[list[Detection], list[Listening]]:
        """What has become certain, no more at once than leaves time to steer; beyond a backlog the oldest are left."""
        certain, stretches = self.associator.advance(now_ns)
        self._backlog.extend(certain)
        if (too_many := len(self._backlog) - MOST_WAITING) > 0:
            for _ in range(too_many):
                self._backlog.popleft()
            if not self.left_out:
                notes.append("more is heard than can be thought about: the oldest transmissions are left out")
            self.left_out += too_many
        count = min(MOST_AT_ONCE, len(self._backlog))
        return [self._backlog.popleft() for _ in range(count)], stretches

    def _note_finds(self, now_ns: int, notes: list[str]) -> bool:
        """Keep the times of finds; whether one was made or withdrawn."""
        changed = False
        found = {source.ident: source for source in self.sources() if self._counts(source)}
        for ident, source in found.items():
            if ident not in self.found_at_s:
                self.found_at_s[ident] = self.elapsed_s(now_ns)
                notes.append(
                    f"found source {ident} at {source.east_m:.2f} m east, {source.north_m:.2f} m north "
                    f"(P {source.p_here:.2f}, {source.receptions:.1f} receptions)"
                )
                changed = True
        for ident in [i for i in self.found_at_s if i not in found]:
            del self.found_at_s[ident]
            why = next((s.note for s in self.sources() if s.ident == ident), "") or "merged with another"
            notes.append(f"source {ident} is no longer found: {why}")
            changed = True
        return changed

    def _counts(self, source: SourceEstimate) -> bool:
        """Found; one that was taken away counts only if it had been found before."""
        return source.state == "found" or (source.state == "removed" and source.ident in self.found_at_s)

    def _reason_to_end(self, now_ns: int, changed: bool) -> str:
        """Why the mission is over, or nothing. What changes slowly and costs a look at the field is asked seldom."""
        steered_ns = now_ns if self._steered_ns is None else self._steered_ns
        progress = Progress(
            self.elapsed_s(now_ns), (now_ns - steered_ns) * 1e-9, tuple(self.found_at_s.values())
        )
        if reason := reason_to_end(self.settings, progress):
            return reason
        limit = self.settings.stop_probability_left
        if limit is None or not (changed or self.turns.is_due(now_ns)):
            return ""
        if (left := self.belief.probability_left()) < limit:
            words = self.belief.left_words() if isinstance(self.belief, SayingBelief) else ""
            return f"the probability that a source is left is {left:.3f}" + (f", {words}" if words else "")
        return ""

    def _height_missing(self, robot: str) -> Outcome:
        """Said once of a robot that flies and whose positions have no height."""
        origin = self.associator.without_height.get(robot)
        if origin is None or robot in self._warned:
            return NOTHING
        self._warned.add(robot)
        return Outcome(
            notes=(
                f"{robot}: it flies, and its positions ({origin}) have no height: what it hears is left out; "
                "take positions that have one, such as the vehicle's own",
            )
        )

    def _end(self, now_ns: int, reason: str) -> Outcome:
        self.ended = True
        self.tasks.of.clear()
        return Outcome(commands=(EndMission(now_ns, reason),), notes=(f"end: {reason}",))

    def _plan(self, now_ns: int, teams: tuple[Team, ...]) -> Plan | None:
        """New tasks for these teams; those that stand outside the fence go back inside first."""
        if not teams:
            return None
        self.tasks.keep(set(self.fleet.steerable_teams(now_ns)).difference(teams))
        position_m = self.fleet.positions_m()
        range_m = {name: left for name in position_m if (left := self.fleet.range_m(name)) is not None}
        stray = {
            name: back for name, place in position_m.items() if (back := self._way_back(place)) is not None
        }
        inside = tuple(team for team in teams if not stray.keys() & team)
        situation = Situation(
            now_ns,
            position_m,
            inside,
            self.tasks.remaining(now_ns),
            range_m,
            self.fleet.homes_m(),
            self.fleet.heights_m(),
            frozenset(self.removed),
        )
        plan = self.planner.plan(situation, self.belief)
        for team in teams:
            if team not in inside:
                for robot in team:
                    plan.paths[robot] = (stray[robot],) if robot in stray else ()
                    plan.purpose[robot] = "back inside" if robot in stray else "wait"
            self.tasks.of[team] = Task({robot: plan.paths.get(robot, ()) for robot in team}, now_ns)
        return plan

    def _way_back(self, place_m: tuple[float, float]) -> Waypoint | None:
        """Where a robot that stands outside the fence or on closed ground goes first; None for one that does not."""
        closed = self._closed if self._closed.fence else replace(self._closed, fence=self._rectangle())
        if closed.wider(0.0).clearance_m(place_m) >= 0.0:
            return None
        engine = self.settings.engine
        east_m, north_m = closed.wider(engine.fence_margin_m + self.settings.arrive_m).nearest_open(place_m)
        return Waypoint(east_m, north_m, engine.max_speed_m_s)

    def _rectangle(self) -> tuple[tuple[float, float], ...]:
        grid = self.settings.engine.grid
        east_m, north_m = grid.size_east_m, grid.size_north_m
        return ((0.0, 0.0), (east_m, 0.0), (east_m, north_m), (0.0, north_m))


def state_digest(kernel: Kernel) -> str:
    """Hex digest over belief, commands and counters: equal only for equal histories."""
    whole = hashlib.sha256()
    whole.update(kernel.belief.digest())
    whole.update(kernel.commands_digest().encode())
    whole.update(struct.pack("<q", kernel.detections))
    return whole.hexdigest()
