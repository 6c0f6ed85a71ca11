"""Safety on a robot that hears the others late, or not at all. Pure.

Of a robot that is heard promptly (within `pose_timeout_s`) the rules of one computer hold. Of one heard late, or no
more, nobody knows where it is by now. Against it this robot goes a way

- that leads nowhere the other can have come to since, at the speed limit: that ground grows until it is heard again;
- or that the other has **confirmed** to know. Every robot announces its way at every tick, with the number of the last
  way that it knows of each other's. A new way that needs to be confirmed is announced and waits, its robot standing at
  its start, until all who need to have confirmed it and what they announce themselves is clear of it. Of two waiting
  ways that cross, the one announced first goes, by number and name. A robot leaves its way for another only where it
  stands or where both rules allow it, so it is on its way, or stopped on it, until it has announced another;
- or that the operator's promise covers (`contact_m`): one that lives and is not heard is further away than that, and
  one that does not live stands on the path it was last on, which safety keeps clear of anyway. Where several fall
  silent at once, and one of them cannot have gone so far, it is the network that was cut and the promise does not
  hold: of those the first two rules hold until they are heard again.

Who comes back into range says where it goes long before its positions have been caught up with. One that stands is
taken to be where it says; against one that drives the first two rules hold.

Why no two meet: take r1 on a way that r2 has confirmed. What r2 drove when it confirmed stands in that very message,
and r1 keeps clear of it. Whatever way r2 takes afterwards, by whichever rule, it takes knowing of r1's, and keeps clear
of all of it until r1 announces another. Where both waited, both know both ways before either goes, and decide alike.
Take r1 on unconfirmed ground: it holds as soon as r2 may have come to what is left of its path, so wherever r2 is, it
is not there. Clocks, delays and losses appear nowhere in this: they cost waiting. A way costs a round trip.

Not covered: the way home after a low battery or an order to return is announced, but waits for nobody.
"""

import math
from dataclasses import dataclass, field, replace

from fieldkit.engine.decentralised.logs import TICK_NS
from fieldkit.engine.decentralised.ways import NO_WAY, Way
from fieldkit.geometry.segments import Place, Segment, ever_m, leaves, standing
from fieldkit.messages import Command, Event, GoTo, Hold, Tick, Waypoint
from mission.safety.limits import SafetySettings
from mission.safety.monitor import SLOW_M_S, Watched
from mission.safety.rules import Safety, segment_to
from mission.safety.separation import CLEAR_OF_NEAR, Occupancy, are_layered, conflict

ASKED_S = 5.0
"""A waiting way that is not asked for again within this time is given up."""
SAME_END_M = 0.01
TOGETHER_S = 3.0
"""Robots that fall silent within so long do so for one reason: they do not die all at once."""
MOVED_SHARE = 0.5
"""One that stands has moved when it is further from where it stood than this share of what is too near."""


def least_contact_m(settings: SafetySettings) -> float:
    """Robots must hear each other at least this far away: two that come towards each other have to stop in between."""
    closing_m = 2.0 * settings.max_speed_m_s * settings.pose_timeout_s
    return settings.min_separation_m + closing_m + 2.0 * settings.braking_m


@dataclass
class SafetyApart(Safety):
    """The safety of robot `me`, which is told of others only what is heard of them."""

    me: str = ""
    contact_m: float | None = None
    way: Way | None = None
    """What it announces; None before its own robot is seen."""
    ways: dict[str, Way] = field(default_factory=dict)
    """What others announce."""
    knows: dict[str, int] = field(default_factory=dict)
    """The number of the last way of its own that each other has confirmed."""
    heard_ns: dict[str, int] = field(default_factory=dict)
    """When each other was last heard, by the clock of its own robot."""
    beside: tuple[GoTo, ...] = ()
    """Where the plan that it follows sends others at this very moment, before it: they may go, unheard of as yet."""
    unpromised: set[str] = field(default_factory=set)
    """Of whom the promise evidently does not hold."""
    _asked_ns: int = 0
    """When the waiting way was last asked for."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, robot in self.robots.items():
            robot.has_agent = name != self.me

    @property
    def _clear_m(self) -> float:
        return CLEAR_OF_NEAR * self.settings.near_m

    @property
    def announced(self) -> Way | None:
        """Its way as it is told to others: at no speed where its robot was told to stop on it, and rolls out."""
        way, mine = self.way, self.robots[self.me]
        homeward = self.returning.segments(self.robots, self.settings)
        stops = way is not None and not way.waits and not mine.moving and self.me not in homeward
        return replace(way, speed_m_s=0.0) if way is not None and stops else way

    # -- what happens --------------------------------------------------------------------------------------

    def observe(self, event: Event) -> list[Command]:
        """As for one computer; and a hold where the path under way leads to where another may be by now."""
        commands = super().observe(event)
        if not isinstance(event, Tick):
            return commands
        self._look_at_promise(event.t_ns)
        mine = self.robots[self.me]
        segment = mine.segment() if mine.moving else None
        reason = "" if segment is None else self._may_meet(segment, event.t_ns, under_way=True)
        if reason:
            hold = Hold(event.t_ns, self.me, reason)
            self._note(hold)
            self.interventions += 1
            commands.append(hold)
        self._announce_rest(event.t_ns)
        return commands

    def expect(
        self,
        robot: str,
        way: Way | None,
        knows: int = NO_WAY,
        heard_ns: int | None = None,
        said_ns: int | None = None,
    ) -> None:
        """Another has announced its way, and which of ours it knows.

        It was last heard at `heard_ns` of our clock, and said so at `said_ns` of its own.
        """
        other = self.robots[robot]
        self.knows[robot] = knows
        if heard_ns is not None:
            self.heard_ns[robot] = heard_ns
        if way is None:
            return
        self.ways[robot] = way
        if way.waits or way.start_m == way.end_m:  # announced only once it stands
            other.stop()
            other.fading = None
            self._stands(other, way, said_ns)
        elif way.speed_m_s == 0.0:  # told to stop: it may stand already, or roll on
            self._stops(other, way)
        elif other.place_m is not None:
            segment = Segment(other.place_m, way.end_m, max(way.speed_m_s, 0.01))
            known = other.target
            if known is None or (known.end_m, known.speed_m_s) != (segment.end_m, segment.speed_m_s):
                other.send(segment, other.now_ns)

    def _stands(self, other: Watched, way: Way, said_ns: int | None) -> None:
        """It stood where it says when it said so, where the positions known of it are older.

        Not where words come late: it may have set out since.
        """
        heard_ns, pose, holds_s = self.heard_ns.get(other.name), other.pose, self.settings.pose_timeout_s
        if heard_ns is None or said_ns is None or pose is None or (heard_ns - said_ns) * 1e-9 > holds_s:
            return
        if (said_ns - pose.t_ns) * 1e-9 > holds_s:
            east_m, north_m = way.start_m
            sigma_m = math.hypot(pose.sigma_m, MOVED_SHARE * self.settings.near_m / 3.0)
            other.pose = replace(pose, t_ns=said_ns, east_m=east_m, north_m=north_m, sigma_m=sigma_m)
            other.velocity_m_s = other.pace_m_s = (0.0, 0.0)

    def _stops(self, other: Watched, way: Way) -> None:
        """Another was told to stop on its way: said at every tick until it stands."""
        known = other.target or other.fading
        if known is None or known.end_m != way.end_m:
            start_m = other.place_m or way.start_m
            other.target = Segment(start_m, way.end_m, self.settings.max_speed_m_s)
        other.stop()

    def _allow_goto(
        self, command: GoTo, new: dict[str, Segment], occupied: dict[str, Occupancy], undecided: set[str]
    ) -> Command:
        allowed = super()._allow_goto(command, new, occupied, undecided)
        mine = self.robots.get(command.robot)
        if not isinstance(allowed, GoTo) or mine is None or mine.name != self.me or mine.place_m is None:
            return allowed
        reason = self._sent_beside(mine, mine.place_m, allowed.waypoint, occupied)
        reason = reason or self._delays(mine, mine.place_m, allowed.waypoint, command.t_ns)
        return Hold(command.t_ns, command.robot, reason) if reason else allowed

    def _sent_beside(
        self, mine: Watched, place_m: Place, target: Waypoint, occupied: dict[str, Occupancy]
    ) -> str:
        """Whose new path, given by the same plan, its own comes too near; empty where it keeps clear of all."""
        new = {
            command.robot: segment_to(start_m, command.waypoint)
            for command in self.beside
            if command.robot in occupied and (start_m := self.robots[command.robot].place_m) is not None
        }
        others = {name: occupied[name] for name in new}
        return conflict(mine, segment_to(place_m, target), new, others, (), self.settings)

    # -- one's own way -------------------------------------------------------------------------------------

    def _delays(self, mine: Watched, place_m: Place, target: Waypoint, now_ns: int) -> str:
        """Why it may not set out yet; empty where it may, which is then announced."""
        segment = segment_to(place_m, target)
        is_announced = self.way is not None and math.dist(self.way.end_m, segment.end_m) <= SAME_END_M
        if reason := self._crosses_waiting(segment, is_announced and self.way is not None and self.way.waits):
            return reason
        reason = self._may_meet(segment, now_ns)
        if not reason:
            way = self.way
            if way is None or not is_announced or way.waits or way.speed_m_s != segment.speed_m_s:
                self._announce(segment, now_ns, waits=False, anew=not is_announced)
            return ""
        if is_announced:
            self._asked_ns = now_ns
        elif (
            math.hypot(*mine.velocity_m_s) < SLOW_M_S and not mine.moving and self._is_clear_of_late(segment)
        ):
            self._asked_ns = now_ns
            self._announce(segment, now_ns, waits=True)
        return reason

    def _announce(self, segment: Segment, now_ns: int, *, waits: bool, anew: bool = True) -> None:
        last = NO_WAY if self.way is None else self.way.number
        number = max(now_ns // TICK_NS, last + 1) if anew else last
        start_m = segment.start_m if anew or self.way is None else self.way.start_m
        self.way = Way(number, start_m, segment.end_m, segment.speed_m_s, waits)

    def _announce_rest(self, now_ns: int) -> None:
        """Give back the ground that it does not need: it stands, and does not wait."""
        mine, way = self.robots[self.me], self.way
        place_m = mine.place_m
        if place_m is None or mine.moving:
            return
        home = self.returning.segments(self.robots, self.settings).get(self.me)
        if home is not None:
            if way is None or math.dist(way.end_m, home.end_m) > SAME_END_M:
                self._announce(home, now_ns, waits=False)
            return
        if math.hypot(*mine.velocity_m_s) >= SLOW_M_S:
            return
        if way is not None and way.waits:
            others_first = self._crosses_waiting(way.segment, is_waiting=True)
            if not others_first and (now_ns - self._asked_ns) * 1e-9 <= ASKED_S:
                return
        elif way is not None and way.start_m == way.end_m:
            moved_m = math.dist(place_m, way.end_m)
            if moved_m <= MOVED_SHARE * self.settings.near_m:
                return
        self._announce(standing(place_m), now_ns, waits=False)

    # -- others --------------------------------------------------------------------------------------------

    def _others(self) -> list[tuple[str, Watched, Place]]:
        """Whom it can meet, and where each was last seen."""
        mine = self.robots[self.me]
        return [
            (name, other, other.place_m)
            for name, other in self.robots.items()
            if name != self.me and other.place_m is not None and not are_layered(mine, other, self.settings)
        ]

    def _crosses_waiting(self, segment: Segment, is_waiting: bool) -> str:
        """Which robot waits to go across this path and goes first; `is_waiting`: this path waits as well."""
        for name, _, _ in self._others():
            theirs = self.ways.get(name)
            if theirs is None or not theirs.waits or ever_m(segment, theirs.segment) >= self._clear_m:
                continue
            if leaves(segment, theirs.segment, self._clear_m):
                continue
            ours_first = is_waiting and self.way is not None
            if ours_first and self.way is not None and (self.way.number, self.me) < (theirs.number, name):
                continue
            return f"{name} waits to go across its path, and goes first"
        return ""

    def _ground(self, other: Watched, place_m: Place) -> Segment:
        """Where one heard late may be: on what is left of the way it has announced, or where it was last seen."""
        way = self.ways.get(other.name)
        if way is None or other.pose is None:
            return standing(place_m)
        if way.waits:
            return standing(way.start_m)
        # Seen before it announced this way, it has come to the start of it since.
        return Segment(way.start_m if other.pose.t_ns < way.number * TICK_NS else place_m, way.end_m, 1.0)

    def _is_clear(self, segment: Segment, other: Watched, place_m: Place) -> bool:
        ground = self._ground(other, place_m)
        return ever_m(segment, ground) >= self._clear_m or leaves(segment, ground, self._clear_m)

    def _is_clear_of_late(self, segment: Segment) -> bool:
        """Whether a way is worth announcing: what others have announced is clear of it."""
        return all(
            self._is_clear(segment, other, place_m)
            for _, other, place_m in self._others()
            if self._age_s(other, other.now_ns) > self.settings.pose_timeout_s
        )

    def _age_s(self, other: Watched, now_ns: int) -> float:
        return math.inf if other.pose is None else (now_ns - other.pose.t_ns) * 1e-9

    def _look_at_promise(self, now_ns: int) -> None:
        """Note of whom the promise evidently does not hold, until they are heard again."""
        place_m, settings = self.robots[self.me].place_m, self.settings
        if self.contact_m is None or place_m is None:
            return
        silent_s = {
            name: self._age_s(other, now_ns)
            for name, other, _ in self._others()
            if not self._speaks(name, now_ns)
        }
        silent_s = {name: age_s for name, age_s in silent_s.items() if age_s > settings.pose_timeout_s}
        self.unpromised &= silent_s.keys()
        for name, _, theirs_m in self._others():
            if name not in silent_s:
                continue
            age_s = silent_s[name]
            in_range = math.dist(place_m, theirs_m) + settings.max_speed_m_s * age_s < self.contact_m
            together = {each for each, its_s in silent_s.items() if abs(its_s - age_s) <= TOGETHER_S}
            if in_range and len(together) > 1:
                self.unpromised |= together

    def _speaks(self, name: str, now_ns: int) -> bool:
        """Whether it is heard now, however old what is known of its positions."""
        heard_ns = self.heard_ns.get(name)
        return heard_ns is not None and (now_ns - heard_ns) * 1e-9 <= self.settings.pose_timeout_s

    def _may_meet(self, segment: Segment, now_ns: int, *, under_way: bool = False) -> str:
        """Which robot that is heard or seen late, or not, may be on this path or come onto it; empty where none can."""
        settings, promised = self.settings, self.contact_m is not None
        is_announced = self.way is not None and math.dist(self.way.end_m, segment.end_m) <= SAME_END_M
        for name, other, place_m in self._others():
            silent_s, speaks = self._age_s(other, now_ns), self._speaks(name, now_ns)
            if silent_s <= settings.pose_timeout_s or (
                promised and not speaks and name not in self.unpromised
            ):
                continue
            last = f"{name} was last {'seen' if speaks else 'heard'} {silent_s:.0f} s ago"
            if ever_m(segment, standing(place_m)) >= settings.max_speed_m_s * silent_s + self._clear_m:
                continue
            if not self._is_clear(segment, other, place_m):
                return f"{last}, and may be on its path"
            if promised and speaks and under_way:
                continue  # back in range: it learns of this way with the next words
            if not is_announced or self.way is None or self.knows.get(name, NO_WAY) != self.way.number:
                return f"{last}, and has not confirmed to keep off its path"
        return ""
