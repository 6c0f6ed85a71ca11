"""The tables of mission.toml, checked as they are read: strict types, finite numbers within `fieldkit.settings`."""

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import shapely
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from fieldkit import settings as given
from fieldkit.geometry.polygons import KeepOut, Place, fault_of
from fieldkit.settings import Quantity
from fieldkit.tuning import Tuning

NEAR_DEG = 0.05
"""Corners as near as this to the origin's latitude and longitude are degrees, not metres."""
LONGEST_NAME = 40
COT_ADDRESS = re.compile(r"(udp|tcp)://[\w.-]+:\d{1,5}")


def bounds(quantity: Quantity) -> Any:
    """What a number of this quantity must be like."""
    low: dict[str, Any] = {"gt" if quantity.above_low else "ge": quantity.low}
    return Field(strict=True, allow_inf_nan=False, le=quantity.high, **low)


def value(quantity: Quantity) -> Any:
    """A number of this quantity, with its default."""
    low: dict[str, Any] = {"gt" if quantity.above_low else "ge": quantity.low}
    return Field(default=quantity.default, strict=True, allow_inf_nan=False, le=quantity.high, **low)


Count = Annotated[int, Field(strict=True, ge=1, le=1_000_000)]
Flag = Annotated[bool, Field(strict=True)]
Share = Annotated[float, Field(strict=True, gt=0, lt=1)]
Corner = tuple[Annotated[float, bounds(given.COORDINATE_M)], Annotated[float, bounds(given.COORDINATE_M)]]


class Table(BaseModel):
    """A table with no other keys than its own."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class FieldTable(Table):
    """The search field: a rectangle whose south-west corner is the origin."""

    origin_lat_deg: Annotated[float, Field(strict=True, ge=-90, le=90)]
    origin_lon_deg: Annotated[float, Field(strict=True, ge=-180, le=180)]
    origin_alt_m: float = value(given.ALTITUDE_M)
    size_east_m: Annotated[float, bounds(given.FIELD_SIDE_M)]
    size_north_m: Annotated[float, bounds(given.FIELD_SIDE_M)]
    cell_m: Annotated[float, bounds(given.CELL_M)]
    keep_out: tuple[tuple[Corner, ...], ...] = ()
    """Polygons of (east, north) that no robot may enter."""
    fence: tuple[Corner, ...] = ()
    """A polygon of (east, north) that no robot may leave, inside the rectangle; empty: the rectangle itself."""
    background: str = ""
    """A picture under the page's map: an MBTiles file, or a picture with a world file, or a GeoTIFF."""
    background_crs: str = ""
    """The coordinates of its world file, where they are no degrees: EPSG:32632, EPSG:3857, local."""

    @property
    def border(self) -> tuple[Place, ...]:
        """Corners of the ground robots may be on, closed areas apart."""
        return self.fence or rectangle(self.size_east_m, self.size_north_m)

    @model_validator(mode="after")
    def _polygons(self) -> "FieldTable":
        for number, polygon in enumerate(self.keep_out):
            self._check(f"keep_out {number + 1}", polygon)
        if not self.fence:
            return self
        self._check("fence", self.fence)
        for east_m, north_m in self.fence:
            if not (0 <= east_m <= self.size_east_m and 0 <= north_m <= self.size_north_m):
                raise ValueError(f"fence: corner ({east_m}, {north_m}) lies outside the field")
        return self

    def _check(self, name: str, polygon: Sequence[Place]) -> None:
        if self._are_degrees(polygon):
            raise ValueError(f"{name}: expected metres east and north of the field's origin, got degrees")
        if fault := fault_of(polygon):
            raise ValueError(f"{name}: {fault}")
        if not _meet(polygon, self):
            raise ValueError(
                f"{name}: lies wholly outside the field of {self.size_east_m:g} m x {self.size_north_m:g} m; "
                "are its corners (east, north) in metres?"
            )

    def _are_degrees(self, polygon: Sequence[Place]) -> bool:
        lat, lon = self.origin_lat_deg, self.origin_lon_deg
        return bool(polygon) and all(
            min(math.dist(corner, (lat, lon)), math.dist(corner, (lon, lat))) < NEAR_DEG for corner in polygon
        )

    @model_validator(mode="after")
    def _not_too_many_cells(self) -> "FieldTable":
        cells = self.size_east_m / self.cell_m * self.size_north_m / self.cell_m
        if cells > given.MOST_CELLS:
            side_m = math.sqrt(self.size_east_m * self.size_north_m / given.MOST_CELLS)
            raise ValueError(
                f"cell_m: {cells:.0f} cells are more than {given.MOST_CELLS:,}; take cells of {side_m:.2g} m or larger"
            )
        return self


def rectangle(east_m: float, north_m: float, beyond_m: float = 0.0) -> tuple[Place, ...]:
    """Corners of a field's rectangle, or of one so much larger on every side."""
    low = -beyond_m
    return (
        (low, low),
        (east_m + beyond_m, low),
        (east_m + beyond_m, north_m + beyond_m),
        (low, north_m + beyond_m),
    )


def _meet(polygon: Sequence[Place], field: FieldTable) -> bool:
    """Whether a polygon has ground in common with the field."""
    return bool(
        shapely.intersects(shapely.Polygon(polygon), shapely.box(0, 0, field.size_east_m, field.size_north_m))
    )


class AntennaTable(Table):
    """Where the calibration is."""

    file: Annotated[str, Field(min_length=1)]
    allow_refused: Flag = False


class SourcesTable(Table):
    """What is known of the transmitters beforehand."""

    power_levels_db: Annotated[tuple[Annotated[float, bounds(given.POWER_DB)], ...], Field(min_length=1)] = (
        given.POWER_DB.default,
    )
    rate_hz: float = value(given.RATE_HZ)
    expected: float = value(given.EXPECTED_SOURCES)
    up_m: float = value(given.SOURCE_UP_M)
    identity: Literal["anonymous", "address"] = given.IDENTITY
    """`address`: each address that frames name is one source; frames that name none are of nobody known."""


class EngineTable(Table):
    """Which belief and planner, and their common settings."""

    belief: str = given.BELIEF
    planner: str = given.PLANNER
    found_probability: float = value(given.FOUND_PROBABILITY)
    min_receptions: float = value(given.MIN_RECEPTIONS)
    place_noise: Flag = True
    """`intensity`: condition readings of one place on each other, as the antenna file's `channel` table says."""
    found_within_m: Annotated[float, Field(strict=True, gt=0, le=1e5, allow_inf_nan=False)] | None = None
    """A find is this near; without it 2 m or a tenth of the typical range, or without `place_noise` within one cell."""
    planning_period_s: float = value(given.PLANNING_PERIOD_S)
    pose_sigma_m: float = value(given.POSE_SIGMA_M)
    keep_teams: Flag = False
    """Robots of a team drive abreast with every planner; else `infogain` parts them and joins any two by need."""
    arrive_m: Annotated[float, bounds(given.ARRIVE_M)] | None = None
    """A robot so near to its way-point has arrived; from speed and positions where not given."""
    prior_rule: Literal["literal", "uniform", "dirichlet", "em"] = given.PRIOR_RULE
    sensing: Literal["levels", "pairwise", "directional"] = given.SENSING
    directional_form: Literal["censored", "interval", "density", "truncated"] = given.DIRECTIONAL_FORM
    """`directional` sensing: how a reading's probability is written."""
    group_gap_m: Annotated[float, Field(strict=True, gt=0)] = given.GROUP_GAP_M
    """`dprwa`: ridges further apart than this are toured in separate groups."""
    normalised_entropy: Flag = False
    """`prwa`: choose how far abreast pairs drive by a distribution, not by P(C_i) as printed."""


class AssociationTable(Table):
    """Which receptions are one transmission."""

    window_s: float = value(given.WINDOW_S)
    lateness_s: float = value(given.LATENESS_S)
    max_pose_gap_s: float = value(given.POSE_GAP_S)


class EndTable(Table):
    """When the mission is over; whichever comes first."""

    max_duration_s: float = value(given.MAX_DURATION_S)
    sources_found: Count | None = None
    probability_left: Share | None = None
    periods_without_find: Count | None = None
    """Planning periods in a row in which nothing more was found: the papers' k_max."""


class RecordingTable(Table):
    """How the mission is written down."""

    raw: Flag = False
    """Whether the bytes that come from the radios are kept as they came, on `/raw/ROBOT`."""
    rotate_mb: Annotated[float, Field(strict=True, ge=1, le=1e6)] | None = None
    """A file that has grown so large is finished, and the recording goes on in the next; None: one file."""


class MapsTable(Table):
    """Other maps that the mission informs; none by default."""

    cot: Annotated[tuple[str, ...], Field(max_length=8)] = ()
    """Cursor on Target: udp://239.2.3.1:6969 (what ATAK listens to by itself), udp://HOST:PORT, tcp://HOST:PORT."""
    cot_every_s: float = value(given.COT_EVERY_S)

    @field_validator("cot")
    @classmethod
    def _addresses(cls, addresses: tuple[str, ...]) -> tuple[str, ...]:
        for address in addresses:
            if not COT_ADDRESS.fullmatch(address):
                raise ValueError(f"expected udp://HOST:PORT or tcp://HOST:PORT, got {address!r}")
        return addresses


class SafetyTable(Table):
    """Limits no command passes."""

    fence_margin_m: float = value(given.FENCE_MARGIN_M)
    max_speed_m_s: float = value(given.MAX_SPEED_M_S)
    max_turn_deg_s: float = value(given.MAX_TURN_DEG_S)
    max_leg_m: float = value(given.MAX_LEG_M)
    pose_timeout_s: float = value(given.POSE_TIMEOUT_S)
    min_separation_m: float = value(given.MIN_SEPARATION_M)
    vertical_separation_m: float = value(given.VERTICAL_SEPARATION_M)
    overrun_s: float = value(given.OVERRUN_S)
    radio_timeout_s: float = value(given.RADIO_TIMEOUT_S)
    radio_return_s: float = value(given.RADIO_RETURN_S)
    stall_s: float = value(given.STALL_S)
    call_after_s: float = value(given.CALL_AFTER_S)
    battery_reserve_pct: float = value(given.BATTERY_RESERVE_PCT)
    battery_pct_per_m: float = value(given.BATTERY_PCT_PER_M)
    battery_low_v: float = value(given.BATTERY_LOW_V)
    """A robot whose battery has sunk to this goes home; 0: only per cent are watched."""
    braking_m: Annotated[float, bounds(given.BRAKING_M)] | None = None
    """How far a robot rolls on at the limit of speed; estimated where not given."""
    turn_radius_m: Annotated[float, bounds(given.TURN_RADIUS_M)] | None = None
    """The circle that robots on wheels turn in; estimated where not given, 0 where they turn on the spot."""
    vehicle_fence: Flag = False
    """Whether the vehicles get a fence of their own, round the whole field, for the time of the mission."""
    vehicle_fence_beyond_m: float = value(given.VEHICLE_FENCE_BEYOND_M)
    """How far outside the field it runs: a rover stops up to 3.5 m before its own fence, and stays there."""


class ReceiverTable(BaseModel):
    """A radio: the driver's name and that driver's own options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    driver: str


class VehicleTable(BaseModel):
    """A vehicle: the driver's name, its link's address, that driver's own options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    driver: str
    address: str


class PositionsTable(BaseModel):
    """A source of positions other than the vehicles' telemetry: the driver's name and its own options."""

    model_config = ConfigDict(extra="allow", frozen=True)
    driver: str


class RobotTable(Table):
    """One robot."""

    name: Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
    flies: Flag = False
    """Whether it takes off: it gets a height of its own where `altitude_m` is not given."""
    altitude_m: Annotated[float, bounds(given.FLIGHT_ALTITUDE_M)] | None = None
    """Height above home at which it works; giving one means that it flies."""
    rss_offset_db: Annotated[float, bounds(given.RSS_OFFSET_DB)] | None = None
    """How much more its radio reports than the calibrated one; without it as the antenna file's `receivers` say."""
    threshold_dbm: Annotated[float, bounds(given.THRESHOLD_DBM)] | None = None
    """The strongest level its radio does not receive; without it as the antenna file says."""
    receiver: ReceiverTable
    vehicle: VehicleTable

    @property
    def on_foot(self) -> bool:
        """Whether it is a person, who follows advice."""
        return self.vehicle.driver == "person"

    @model_validator(mode="after")
    def _can_be_called(self) -> "RobotTable":
        if not self.name.isprintable() or self.name != self.name.strip() or "/" in self.name:
            raise ValueError(
                "name: expected printable characters without '/', not beginning or ending with a space"
            )
        if self.name.lower() in ("all", "everybody", "*"):
            raise ValueError("name: means all robots to the operator's commands; choose another")
        return self


class TeamTable(Table):
    """Robots that move abreast: two, or one."""

    robots: Annotated[tuple[str, ...], Field(min_length=1, max_length=2)]


class MissionFile(Table):
    """The whole file."""

    schema_: Annotated[int, Field(alias="schema", strict=True, ge=1, le=1)]
    name: Annotated[str, Field(max_length=200)] = "mission"
    seed: Annotated[int, Field(strict=True, ge=0, le=given.SEED_MAX)] = 0
    field: FieldTable
    antenna: AntennaTable
    sources: SourcesTable = SourcesTable()
    engine: EngineTable = EngineTable()
    association: AssociationTable = AssociationTable()
    tuning: dict[str, dict[str, Any]] = {}
    """Values of `fieldkit.tuning` set anew, by table and key; for studies and what-ifs."""
    end: EndTable = EndTable()
    recording: RecordingTable = RecordingTable()
    maps: MapsTable = MapsTable()
    safety: SafetyTable = SafetyTable()
    team: Annotated[tuple[TeamTable, ...], Field(min_length=1)]
    robot: Annotated[tuple[RobotTable, ...], Field(min_length=1)]
    positions: tuple[PositionsTable, ...] = ()

    @property
    def margin_m(self) -> float:
        """How far way-points keep inside the fence and off closed ground: the margin, and what positions may be off."""
        return self.safety.fence_margin_m + given.MARGIN_SIGMAS * self.engine.pose_sigma_m

    @property
    def bounds(self) -> KeepOut:
        """What robots must keep out of, fence included, with that margin."""
        return KeepOut(self.field.keep_out, self.field.border, self.margin_m)

    @property
    def turn_radius_m(self) -> float:
        """How wide robots on wheels turn: as the file says, or estimated."""
        given_m = self.safety.turn_radius_m
        return given.turn_radius_m(self.safety.max_speed_m_s) if given_m is None else given_m

    def altitudes_m(self) -> dict[str, float]:
        """Robots that fly, and how high: each where the file says, the others one above the other.

        Nobody gets a height within the vertical separation of another's.
        """
        fixed = {robot.name: robot.altitude_m for robot in self.robot if robot.altitude_m is not None}
        taken, height_m = list(fixed.values()), given.FLIGHT_ALTITUDE_M.default
        layers = dict(fixed)
        for robot in self.robot:
            if not robot.flies or robot.name in layers:
                continue
            while any(abs(height_m - other) < self.safety.vertical_separation_m for other in taken):
                height_m += self.safety.vertical_separation_m
            layers[robot.name] = height_m
            taken.append(height_m)
        return layers

    @field_validator("tuning")
    @classmethod
    def _tuned(cls, tables: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
        Tuning().with_tables(tables)
        return tables

    @model_validator(mode="after")
    def _leaves_room(self) -> "MissionFile":
        side_m = min(self.field.size_east_m, self.field.size_north_m)
        if not KeepOut(self.field.keep_out, self.field.border).leaves_room:
            raise ValueError("field.keep_out: closes the whole field; no robot could move")
        if not self.bounds.leaves_room:
            raise ValueError(
                f"safety.fence_margin_m: with {given.MARGIN_SIGMAS:g} engine.pose_sigma_m it is {self.margin_m:g} m "
                f"on every side, which leaves no ground in this field ({side_m:g} m)"
            )
        within = {
            "safety.min_separation_m": self.safety.min_separation_m if len(self.robot) > 1 else 0.0,
            "safety.braking_m": self.safety.braking_m or 0.0,
            "safety.turn_radius_m": self.safety.turn_radius_m or 0.0,
            "engine.arrive_m": self.engine.arrive_m or 0.0,
        }
        for key, given_m in within.items():
            if given_m > side_m:
                raise ValueError(f"{key}: expected less than the field's {side_m:g} m, got {given_m:g}")
        return self
