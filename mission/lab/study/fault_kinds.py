"""Which faults befall a mission, drawn from its seed, and how each is done to an emulated vehicle or radio."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mission.lab.study.fault_flight import Flight

LARGE_EVERY = 4


@dataclass(frozen=True, slots=True)
class Size:
    """A fleet and its field."""

    robots: int
    field_m: float
    cell_m: float
    sources: int
    duration_s: float


POLYGON = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.62, 1.0), (0.5, 0.72), (0.38, 1.0), (0.0, 1.0))
"""A fence with a notch, in shares of the field's side."""
SMALL, LARGE = Size(4, 10.0, 0.2, 2, 300.0), Size(16, 20.0, 0.4, 4, 160.0)


@dataclass(frozen=True, slots=True)
class Job:
    """One trial."""

    number: int
    seed: int

    @property
    def has_polygon(self) -> bool:
        return self.number // LARGE_EVERY % 2 == 1

    @property
    def size(self) -> Size:
        return LARGE if self.number % LARGE_EVERY == LARGE_EVERY - 1 else SMALL


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that happens to one robot, or to all (robot "")."""

    kind: str
    robot: str
    at_s: float
    until_s: float


#: Kind to the shortest and longest time it lasts, s. Those of no length happen once.
KINDS: dict[str, tuple[float, float]] = {
    "link loss": (10.0, 90.0),
    "radio unplugged": (5.0, 200.0),
    "GPS loss": (10.0, 60.0),
    "stuck": (40.0, 120.0),
    "reboot": (0.0, 0.0),
    "battery drop": (0.0, 0.0),
    "clock step": (0.0, 0.0),
    "packet loss 30 %": (30.0, 120.0),
    "acknowledgements lost": (20.0, 90.0),
    "noisy positions": (20.0, 120.0),
    "forged and replayed frames": (10.0, 60.0),
    "operator takes over": (10.0, 60.0),
    "kill -9 and resume": (0.0, 0.0),
}
STOPS = {"link loss", "GPS loss", "reboot", "battery drop", "operator takes over"}
"""Faults after which the robot must not go on driving to way-points of ours."""
EVERYBODYS = ("packet loss 30 %", "acknowledgements lost", "noisy positions", "kill -9 and resume")
"""Faults that all robots have at once."""
NOISE_M = 0.5
"""Standard deviation of noisy positions."""
RESUMED = STOPS - {"battery drop"} | {"stuck", "radio unplugged"}


def draw_faults(job: Job, robots: tuple[str, ...]) -> list[Fault]:
    """One to three faults of different kinds on different robots, from the seed."""
    rng = np.random.default_rng([job.seed, 0xFA])
    size = job.size
    count = int(rng.integers(1, 4))
    kinds = [str(kind) for kind in rng.choice(list(KINDS), count, replace=False)]
    kinds[0] = list(KINDS)[job.number % len(KINDS)]  # each kind comes up equally often
    victims = rng.choice(robots, count, replace=False)
    faults = []
    for kind, robot in zip(dict.fromkeys(kinds), victims, strict=False):
        at_s = float(rng.uniform(0.1, 0.5)) * size.duration_s
        until_s = at_s + float(rng.uniform(*KINDS[kind]))
        everybody = kind in EVERYBODYS
        faults.append(Fault(kind, "" if everybody else str(robot), at_s, until_s))
    return sorted(faults, key=lambda fault: fault.at_s)


Act = Callable[[Any, "Flight", Fault], Awaitable[None]]


def _act(change: Callable[[Any, "Flight", Fault], object]) -> Act:
    async def act(rover: Any, flight: "Flight", fault: Fault) -> None:
        change(rover, flight, fault)

    return act


async def _forge(rover: Any, flight: "Flight", fault: Fault) -> None:
    while flight.clock.elapsed_s() < fault.until_s:
        rover.forge()
        await flight.clock.sleep(0.5)


def _nothing(rover: Any, flight: "Flight", fault: Fault) -> None:
    """It does not end by itself."""


#: Kind to how it begins and how it ends.
ACTS: dict[str, tuple[Act, Act]] = {
    "link loss": (
        _act(lambda rover, *_: setattr(rover, "silent", True)),
        _act(lambda rover, *_: setattr(rover, "silent", False)),
    ),
    "radio unplugged": (
        _act(lambda _, flight, fault: flight.radios[fault.robot].set_up(False, "unplugged")),
        _act(lambda _, flight, fault: flight.radios[fault.robot].set_up(True, "back")),
    ),
    "GPS loss": (
        _act(lambda rover, *_: rover.autopilot.lose_gps(True)),
        _act(lambda rover, *_: rover.autopilot.lose_gps(False)),
    ),
    "stuck": (
        _act(lambda rover, *_: setattr(rover.autopilot.trouble, "stuck", True)),
        _act(lambda rover, *_: setattr(rover.autopilot.trouble, "stuck", False)),
    ),
    "reboot": (_act(lambda rover, *_: rover.reboot()), _act(_nothing)),
    "battery drop": (
        _act(lambda rover, *_: setattr(rover.autopilot, "battery_pct", 20.0)),
        _act(_nothing),
    ),
    "clock step": (
        _act(lambda rover, _, fault: rover.step_clock(30.0 if fault.at_s % 2 > 1 else -0.8)),
        _act(_nothing),
    ),
    "packet loss 30 %": (
        _act(lambda rover, *_: setattr(rover, "loss", 0.3)),
        _act(lambda rover, *_: setattr(rover, "loss", 0.0)),
    ),
    "acknowledgements lost": (
        _act(lambda rover, *_: setattr(rover, "loses_acknowledgements", True)),
        _act(lambda rover, *_: setattr(rover, "loses_acknowledgements", False)),
    ),
    "noisy positions": (
        _act(lambda rover, *_: setattr(rover.autopilot, "pose_noise_m", NOISE_M)),
        _act(
            lambda rover, flight, _: setattr(rover.autopilot, "pose_noise_m", flight.fleet.spec.pose_noise_m)
        ),
    ),
    "forged and replayed frames": (_forge, _act(_nothing)),
    "operator takes over": (_act(lambda rover, *_: rover.taken_by_hand()), _act(_nothing)),
}
