"""What crosses a seam or goes to disk: frozen, slotted, SI units, one unit per quantity and in its name.

Instants `t_ns` are UTC nanoseconds. Positions are in the field's local frame: metres east and north of
the field's south-west corner. Headings are degrees clockwise from true north.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: How an RSSI value was obtained. They are not equally good: `db` is the module's last packet from anybody.
RssVia = Literal["rx64", "rx16", "io", "db", "ed", "sniffer", "tap", "lines", "sim", "other"]
"""How a level was obtained; `other`: by a driver of another package."""


@dataclass(frozen=True, slots=True)
class RssReading:
    """One transmission as one robot's radio heard it. Sources are anonymous to the engine."""

    t_ns: int
    robot: str
    rss_dbm: float
    via: RssVia = "sim"
    channel: int | None = None
    frame_id: str | None = None
    """Address and sequence number where a frame carries them; for analysis and association only."""
    lqi: int | None = None
    saturated: bool = False
    """The receiver reports at most this strength: the true one may be higher."""
    sensitivity_dbm: float | None = None
    """About the weakest this receiver hears: weaker packets are missing, not absent. None where not known."""


@dataclass(frozen=True, slots=True)
class ReceiverState:
    """A receiver came up, or went down: while down its silence means nothing."""

    t_ns: int
    robot: str
    up: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a robot was. `sigma_m` is the standard deviation of each horizontal coordinate."""

    t_ns: int
    robot: str
    east_m: float
    north_m: float
    up_m: float = 0.0
    heading_deg: float = 0.0
    sigma_m: float = 0.0
    origin: str = "sim"


#: What a vehicle is doing, in our words; `other` is any mode in which we do not own it.
VehicleMode = Literal["guided", "hold", "return", "land", "other", "unknown"]


@dataclass(frozen=True, slots=True)
class VehicleState:
    """A vehicle's own word on itself, and on the link to it."""

    t_ns: int
    robot: str
    mode: VehicleMode
    armed: bool
    link_up: bool = True
    battery_pct: float | None = None
    text: str = ""
    """The vehicle's last status text or the reason for the link's state."""
    battery_v: float | None = None
    speed_m_s: float | None = None
    """Measured over ground."""
    flies: bool = False
    """It leaves the ground: it needs an altitude, and stops in the air."""
    on_ground: bool | None = None
    """Of one that flies: whether it says that it stands; None where it does not say."""
    reason: str = ""
    """Why it is not ours to steer, where it was and is no longer; never the vehicle's chatter."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Time passes: lets the mission act when nothing else happens."""

    t_ns: int


@dataclass(frozen=True, slots=True)
class Operator:
    """What the operator asked for. `robot` None means all.

    `release` gives a robot up to somebody else's hands, `withdraw` is safety taking one out of the mission until
    it is resumed; `remove` says that the transmitter `source` has been taken away; `exclude` closes the polygon
    `area_m` (east, north) to all robots; `mark` is a person's word that a transmitter is where `robot` stands,
    and `bearing` the bearing that a person has taken there, in words in `reason`. Neither enters the belief.
    """

    t_ns: int
    action: Literal[
        "hold", "resume", "return", "end", "release", "withdraw", "remove", "exclude", "mark", "bearing"
    ]
    robot: str | None = None
    reason: str = ""
    source: int | None = None
    area_m: tuple[tuple[float, float], ...] = ()


Event = RssReading | ReceiverState | Pose | VehicleState | Tick | Operator


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place to be, and how fast to go there."""

    east_m: float
    north_m: float
    speed_m_s: float
    up_m: float = 0.0


@dataclass(frozen=True, slots=True)
class GoTo:
    """Drive to a way-point and stop there."""

    t_ns: int
    robot: str
    waypoint: Waypoint


@dataclass(frozen=True, slots=True)
class Hold:
    """Stop now and stay."""

    t_ns: int
    robot: str
    reason: str


@dataclass(frozen=True, slots=True)
class Return:
    """Go home by the vehicle's own means."""

    t_ns: int
    robot: str
    reason: str


@dataclass(frozen=True, slots=True)
class Land:
    """Of one that flies: come down where you are, and stay."""

    t_ns: int
    robot: str
    reason: str


@dataclass(frozen=True, slots=True)
class CallOperator:
    """A robot is out of the mission, held or on its way home, until the operator resumes it."""

    t_ns: int
    robot: str
    reason: str


@dataclass(frozen=True, slots=True)
class EndMission:
    """Nothing more to do: the runner holds all robots and closes."""

    t_ns: int
    reason: str


Command = GoTo | Hold | Return | Land | CallOperator | EndMission


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """One transmission, as the whole team heard it or did not.

    `robots` (m,) are those that were listening with a known pose; `position_m` is (m, 2) east, north;
    `heading_deg` is (m,); `rss_dbm` is (m,) with nan where the robot listened and heard nothing.
    `saturated` (m,) marks readings at the receiver's ceiling. `up_m` (m,) is how high each was above the field's
    origin and `sigma_m` (m,) how far its position may be off; both empty where nobody says.
    Robots that were not listening (radio down, pose stale) are absent, not silent.
    """

    t_ns: int
    robots: tuple[str, ...]
    position_m: FloatArray
    heading_deg: FloatArray
    rss_dbm: FloatArray
    saturated: NDArray[np.bool_]
    up_m: FloatArray = field(default_factory=lambda: np.empty(0))
    sigma_m: FloatArray = field(default_factory=lambda: np.empty(0))
    sender: str | None = None
    """The address that the frame names; beliefs look at it only where a mission has `sources.identity` "address"."""

    @property
    def heard(self) -> NDArray[np.bool_]:
        """(m,) True where the robot heard the transmission."""
        return ~np.isnan(self.rss_dbm)


def part_of(detection: Detection, keep: NDArray[np.bool_]) -> Detection:
    """The detection with only the robots that `keep` (m,) says."""
    return replace(
        detection,
        robots=tuple(robot for robot, kept in zip(detection.robots, keep, strict=True) if kept),
        position_m=detection.position_m[keep],
        heading_deg=detection.heading_deg[keep],
        rss_dbm=detection.rss_dbm[keep],
        saturated=detection.saturated[keep],
        up_m=detection.up_m[keep] if detection.up_m.size else detection.up_m,
        sigma_m=detection.sigma_m[keep] if detection.sigma_m.size else detection.sigma_m,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Listening:
    """Who listened where, for how long: what makes silence evidence. `position_m` is (m, 2) east, north.

    `up_m`, `heading_deg` and `sigma_m` (m,) as in `Detection`, empty where nobody says.
    """

    t0_ns: int
    t1_ns: int
    robots: tuple[str, ...]
    position_m: FloatArray
    up_m: FloatArray = field(default_factory=lambda: np.empty(0))
    heading_deg: FloatArray = field(default_factory=lambda: np.empty(0))
    sigma_m: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def duration_s(self) -> float:
        return (self.t1_ns - self.t0_ns) * 1e-9


SourceState = Literal["candidate", "found", "inconsistent", "outside", "removed"]


@dataclass(frozen=True, slots=True, eq=False)
class SourceEstimate:
    """What is believed of one source.

    `cov_m2` is (2, 2) over (east, north). `region_90` counts the cells of the smallest region that holds
    90 % of the location posterior. `inconsistent`: the readings do not look like what the antenna file
    predicts, so no position is claimed; `note` says why. `outside`: it is not in the field; `note` says where.
    `removed`: the operator has taken it away.
    """

    ident: int
    east_m: float
    north_m: float
    cov_m2: FloatArray
    region_90: int
    receptions: float
    rate_hz: float
    p_exists: float
    p_here: float
    """Probability that the source is as near to (east_m, north_m) as a find has to be: `found_within_m` or one cell."""
    state: SourceState
    note: str = ""
    name: str = ""
    """The sender's address, where sources are identified by it."""
    power_db: float = float("nan")
    """Posterior mean of the source's power level, relative to the calibrated transmitter."""
    last_heard_ns: int = 0
    """When it last sent what was heard; 0 where that is not kept."""
    silence_odds: float = float("nan")
    """Probability that nothing is heard of it since then by chance, had it gone on sending."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Paths for some robots: equally long lists of way-points, robots of a pair moving abreast."""

    t_ns: int
    paths: dict[str, tuple[Waypoint, ...]]
    purpose: dict[str, str] = field(default_factory=dict)
    """Robot to a word or two on what its path is for: "search", "resolve 3", "ridge 1"."""
