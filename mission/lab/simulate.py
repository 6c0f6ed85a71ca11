"""A mission in a plain loop under virtual time: thousands of simulated seconds a second, no asyncio.

The world's robots drive with limited speed and turn rate, its channel rounds, loses and saturates readings as
the antenna says. The kernel and safety are the ones of a live mission.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fieldkit import settings as given
from fieldkit.channel.model import Antenna
from fieldkit.messages import (
    Command,
    EndMission,
    Event,
    FloatArray,
    GoTo,
    Hold,
    Pose,
    Return,
    RssReading,
    Tick,
    VehicleState,
)
from fieldkit.world.air import Air
from fieldkit.world.bodies import Rover
from fieldkit.world.disturbed import NONE, Disturbances
from fieldkit.world.shadowing import ShadowField
from fieldkit.world.sources import TransientSource, Transmissions
from fieldkit.world.wander import WANDER_S
from mission.core.kernel import Kernel, Outcome
from mission.core.kernel_settings import KernelSettings


@dataclass(frozen=True, slots=True)
class Truth:
    """What the simulated world is like; the kernel may believe otherwise."""

    antenna: Antenna
    sources: tuple[TransientSource, ...]
    start_m: tuple[tuple[float, float], ...]
    """Where each robot starts, in the order of the teams."""
    packet_loss: float = 0.0
    clock_sigma_s: float = 0.0
    """Each robot's clock offset is drawn once with this deviation."""
    pose_sigma_m: float = 0.03
    pose_bias_m: float = 0.0
    """Each robot's position is off by this much in a direction of its own."""
    max_speed_m_s: float = given.MAX_SPEED_M_S.default
    shadow: tuple[ShadowField, ...] = ()
    """Of each source the shadowing that belongs to places; empty: none."""
    offset_db: tuple[float, ...] = ()
    """How much more each robot's receiver reports, in the order of the teams; empty: all alike."""
    pose_wander_m: float = 0.0
    """Deviation of a position error that wanders, as of satellites, the same for all robots of a moment."""
    pose_wander_s: float = WANDER_S
    """How long such an error lasts."""
    source_up_m: float = 0.0
    """How high the transmitters are; robots fly as high as the mission says."""
    elevation: float = 0.0
    """kappa of `channel.spread`: 2 for two vertical dipoles."""
    disturbed: Disturbances = NONE
    """What else is not as the engine believes."""


@dataclass(slots=True)
class Result:
    """How a simulated mission went."""

    kernel: Kernel
    elapsed_s: float
    end_reason: str
    time_to_all_s: float | None
    """When every true source had a find within one cell (Chebyshev), for good; None if never."""
    false_finds: int
    """Finds further than two cells, or twice what a find is within, from every source, at the end."""


def simulate(
    settings: KernelSettings,
    truth: Truth,
    seed: int,
    *,
    step_s: float = given.TICK_S,
    on_step: Callable[[Kernel, Event, Outcome], Iterable[Command]] | None = None,
) -> Result:
    """Run a mission to its end. Everything random derives from `seed`.

    `on_step` sees every event with its outcome and gives the commands that are carried out: where safety or a
    recorder is put in.
    """
    kernel = Kernel(settings)
    grid = settings.engine.grid
    world = SimulatedWorld(settings.engine.robots, truth, seed, step_s, settings.altitude_m, grid.size_east_m)
    covered_at: dict[int, float] = {}
    inbox: list[Event] = [VehicleState(0, robot, "guided", True) for robot in settings.engine.robots]
    end_reason = ""
    while not end_reason:
        inbox += world.events()
        for event in inbox:
            outcome = kernel.step(event)
            commands = outcome.commands if on_step is None else on_step(kernel, event, outcome)
            for command in commands:
                end_reason = world.obey(command) or end_reason
            if outcome.detections:
                note_covered(kernel, truth, world.t_s, covered_at)
        inbox = []
        world.drive()
        open_ended = settings.sources_expected is None and settings.stop_probability_left is None
        if open_ended and truth.sources and len(covered_at) == len(truth.sources):
            end_reason = "every source is found"
    done = len(covered_at) == len(truth.sources)
    time_to_all_s = max(covered_at.values(), default=0.0) if done else None
    return Result(kernel, world.t_s, end_reason, time_to_all_s, count_false(kernel, truth))


class SimulatedWorld:
    """What is true: rovers, transmissions, and the errors of clocks and positions."""

    def __init__(
        self,
        robots: tuple[str, ...],
        truth: Truth,
        seed: int,
        step_s: float,
        altitude_m: Mapping[str, float],
        size_m: float,
    ) -> None:
        generators = (np.random.default_rng([seed, k]) for k in range(4))
        rng_traffic, self.rng_channel, self.rng_pose, self.rng_wander = generators
        self.truth, self.step_s, self.t_s = truth, step_s, 0.0
        self.up_m = np.array([altitude_m.get(robot, 0.0) for robot in robots])
        self.rovers = {
            r: Rover(e, n, max_speed_m_s=truth.max_speed_m_s)
            for r, (e, n) in zip(robots, truth.start_m, strict=True)
        }
        offsets_s = self.rng_pose.normal(0.0, 1.0, len(robots)) * truth.clock_sigma_s
        self.clock_s = dict(zip(robots, offsets_s, strict=True))
        turn = self.rng_pose.uniform(0.0, 2 * np.pi, len(robots))
        self.bias = {
            r: truth.pose_bias_m * np.array([np.sin(a), np.cos(a)]) for r, a in zip(robots, turn, strict=True)
        }
        self.traffic = Transmissions(list(truth.sources), rng_traffic)
        self.before = self._places_m()
        self.rng_foreign = np.random.default_rng([seed, 4])
        self.air = Air(
            truth.antenna,
            truth.sources,
            truth.disturbed,
            truth.shadow,
            truth.offset_db,
            truth.packet_loss,
            truth.elevation,
            truth.source_up_m,
            size_m,
            seed,
        )
        wanders = truth.pose_wander_m > 0.0
        self.wander = self.rng_wander.normal(0.0, truth.pose_wander_m, 2) if wanders else np.zeros(2)

    def events(self) -> list[Event]:
        """Where the robots say they are, what they have heard since the last step, and a tick."""
        events: list[Event] = [*self._poses(), *self._foreign()]
        for at_s, source in self.traffic.until(self.t_s):
            if not source.sends_at(at_s):
                continue
            share = 1.0 - (self.t_s - at_s) / self.step_s
            now = self._places_m()
            place = np.array(
                [
                    (e + share * (now[r][0] - e), n + share * (now[r][1] - n))
                    for r, (e, n) in self.before.items()
                ]
            )
            heading = np.array([rover.heading_deg for rover in self.rovers.values()])
            events += self._heard(at_s, source, place, heading)
        return [*events, Tick(round(self.t_s * 1e9))]

    def _poses(self) -> list[Pose]:
        truth = self.truth
        if truth.pose_wander_m > 0.0:
            kept = np.exp(-self.step_s / truth.pose_wander_s)
            fresh = self.rng_wander.normal(0.0, truth.pose_wander_m, 2)
            self.wander = kept * self.wander + fresh * np.sqrt(1.0 - kept**2)
        sigma_m = float(np.hypot(truth.pose_sigma_m, truth.pose_wander_m))
        poses = []
        for (robot, rover), up_m in zip(self.rovers.items(), self.up_m.tolist(), strict=True):
            noisy = truth.pose_sigma_m > 0
            noise = self.rng_pose.normal(0.0, truth.pose_sigma_m, 2) if noisy else np.zeros(2)
            east, north = np.array([rover.east_m, rover.north_m]) + self.bias[robot] + noise + self.wander
            at = float(east), float(north)
            poses.append(Pose(round(self.t_s * 1e9), robot, *at, up_m, rover.heading_deg, sigma_m))
        return poses

    def _foreign(self) -> list[Event]:
        """Packets of somebody far away: anybody may hear one, at any strength just above the threshold."""
        robots = list(self.clock_s)
        return [
            RssReading(round(self.t_s * 1e9), robots[index], rss)
            for index, rss in self.air.foreign(self.step_s, len(robots), self.rng_foreign)
        ]

    def _heard(
        self, at_s: float, source: TransientSource, place: FloatArray, heading_deg: FloatArray
    ) -> list[Event]:
        """What the radios at `place` (m, 2), pointing to `heading_deg` (m,), heard of a packet."""
        truth = self.truth
        number = truth.sources.index(source)
        rss = self.air.heard_dbm(number, at_s, place, self.up_m, heading_deg, self.rng_channel)
        return [
            RssReading(
                round((at_s + self.clock_s[robot]) * 1e9),
                robot,
                float(value),
                saturated=truth.antenna.saturation_dbm is not None and value >= truth.antenna.saturation_dbm,
            )
            for robot, value in zip(self.clock_s, rss, strict=True)
            if not np.isnan(value)
        ]

    def obey(self, command: Command) -> str:
        """Drive, stop, or end: why, where the mission is over."""
        match command:
            case GoTo(_, robot, waypoint):
                self.rovers[robot].go_to(waypoint.east_m, waypoint.north_m, waypoint.speed_m_s)
            case Hold(_, robot, _) | Return(_, robot, _):
                self.rovers[robot].stop()
            case EndMission(_, reason):
                return reason
        return ""

    def drive(self) -> None:
        """One step on."""
        self.before = self._places_m()
        for rover in self.rovers.values():
            rover.step(self.step_s)
        self.t_s += self.step_s

    def _places_m(self) -> dict[str, tuple[float, float]]:
        return {robot: (rover.east_m, rover.north_m) for robot, rover in self.rovers.items()}


def note_covered(kernel: Kernel, truth: Truth, t_s: float, covered_at: dict[int, float]) -> None:
    """Note which sources have a find within one cell now; one that has lost its find is uncovered again."""
    cell = kernel.settings.engine.grid.cell_m
    found = [(s.east_m, s.north_m) for s in kernel.sources() if s.state == "found"]
    for index, source in enumerate(truth.sources):
        near = any(max(abs(e - source.east_m), abs(n - source.north_m)) <= 1.0 * cell for e, n in found)
        if near:
            covered_at.setdefault(index, t_s)
        else:
            covered_at.pop(index, None)


def count_false(kernel: Kernel, truth: Truth) -> int:
    """Finds further than two cells from every source, or than twice what a find is said to be within."""
    engine = kernel.settings.engine
    far_m = 2.0 * max(engine.grid.cell_m, engine.find_radius_m or 0.0)
    return sum(
        all(np.hypot(s.east_m - t.east_m, s.north_m - t.north_m) > far_m for t in truth.sources)
        for s in kernel.sources()
        if s.state == "found"
    )
