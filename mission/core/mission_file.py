"""mission.toml: read, checked at this edge, and turned into what kernel, safety and setups are given."""

import math
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic
from pydantic import BaseModel, ConfigDict, Field, model_validator

from fieldkit import plugins
from fieldkit.channel.antenna_file import AntennaFile, predictive_sigma_db, read_antenna, with_pattern
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.geo import FieldFrame
from fieldkit.geometry.polygons import KeepOut
from fieldkit.geometry.segments import outside
from mission.core.kernel import KernelSettings
from mission.safety.rules import SafetySettings

SCHEMA = 1


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class FieldTable(_Table):
    """The search field: a rectangle whose south-west corner is the origin."""

    origin_lat_deg: float = Field(ge=-90, le=90)
    origin_lon_deg: float = Field(ge=-180, le=180)
    origin_alt_m: float = 0.0
    size_east_m: float = Field(gt=0, le=100_000)
    size_north_m: float = Field(gt=0, le=100_000)
    cell_m: float = Field(gt=0)
    keep_out: tuple[tuple[tuple[float, float], ...], ...] = ()
    """Polygons of (east, north) that no robot may enter."""
    fence: tuple[tuple[float, float], ...] = ()
    """A polygon of (east, north) that no robot may leave, inside the rectangle; empty: the rectangle itself."""

    @model_validator(mode="after")
    def _polygons(self) -> "FieldTable":
        for polygon in self.keep_out:
            if len(polygon) < 3:
                raise ValueError(f"keep_out: a polygon needs at least 3 corners, got {len(polygon)}")
        if self.fence and len(self.fence) < 3:
            raise ValueError(f"fence: a polygon needs at least 3 corners, got {len(self.fence)}")
        for east_m, north_m in self.fence:
            if not (0 <= east_m <= self.size_east_m and 0 <= north_m <= self.size_north_m):
                raise ValueError(f"fence: corner ({east_m}, {north_m}) lies outside the field")
        return self

    @model_validator(mode="after")
    def _not_too_many_cells(self) -> "FieldTable":
        cells = self.size_east_m / self.cell_m * self.size_north_m / self.cell_m
        if cells > 4_000_000:
            raise ValueError(f"cell_m: {cells:.0f} cells are more than 4,000,000; take larger cells")
        return self


class AntennaTable(_Table):
    """Where the calibration is."""

    file: str
    allow_refused: bool = False


class SourcesTable(_Table):
    """What is known of the transmitters beforehand."""

    power_levels_db: tuple[float, ...] = Field(default=(0.0,), min_length=1)
    rate_hz: float = Field(default=0.05, gt=0)
    expected: float = Field(default=4.0, gt=0)


class EngineTable(_Table):
    """Which belief and planner, and their common settings."""

    belief: str = "intensity"
    planner: str = "infogain"
    found_probability: float = Field(default=0.9, gt=0, lt=1)
    min_receptions: float = Field(default=3.0, gt=0)
    planning_period_s: float = Field(default=20.0, gt=0)
    pose_sigma_m: float = Field(default=0.05, ge=0)
    prior_rule: Literal["literal", "uniform", "dirichlet", "em"] = "em"
    sensing: Literal["levels", "pairwise", "directional"] = "levels"
    directional_form: Literal["censored", "interval", "density", "truncated"] = "censored"
    """`directional` sensing: how a reading's probability is written."""
    group_gap_m: float = Field(default=math.inf, gt=0)
    """`dprwa`: ridges further apart than this are toured in separate groups."""
    normalised_entropy: bool = False
    """`prwa`: choose how far abreast pairs drive by a distribution, not by P(C_i) as printed."""


class AssociationTable(_Table):
    """Which receptions are one transmission."""

    window_s: float = Field(default=0.1, gt=0)
    lateness_s: float = Field(default=1.0, gt=0)
    max_pose_gap_s: float = Field(default=1.0, gt=0)


class EndTable(_Table):
    """When the mission is over; whichever comes first."""

    max_duration_s: float = Field(default=3600.0, gt=0)
    sources_found: int | None = Field(default=None, ge=1)
    probability_left: float | None = Field(default=None, gt=0, lt=1)
    periods_without_find: int | None = Field(default=None, ge=1)
    """Planning periods in a row in which nothing more was found: the papers' k_max."""


class RecordingTable(_Table):
    """How the mission is written down."""

    raw: bool = False
    """Whether the bytes that come from the radios are kept as they came, on `/raw/ROBOT`."""
    rotate_mb: float | None = Field(default=None, gt=0)
    """A file that has grown so large is finished, and the recording goes on in the next; None: one file."""


class SafetyTable(_Table):
    """Limits no command passes."""

    fence_margin_m: float = Field(default=0.2, ge=0)
    max_speed_m_s: float = Field(default=0.4, gt=0)
    max_turn_deg_s: float = Field(default=90.0, gt=0)
    max_leg_m: float = Field(default=1_000.0, gt=0)
    pose_timeout_s: float = Field(default=2.0, gt=0)
    min_separation_m: float = Field(default=0.5, ge=0)
    overrun_s: float = Field(default=3.0, gt=0)
    radio_timeout_s: float = Field(default=10.0, gt=0)
    radio_return_s: float = Field(default=120.0, gt=0)
    stall_s: float = Field(default=15.0, gt=0)
    call_after_s: float = Field(default=30.0, gt=0)
    battery_reserve_pct: float = Field(default=25.0, ge=0, lt=100)
    battery_pct_per_m: float = Field(default=0.0, ge=0)
    vehicle_fence: bool = False
    """Whether the vehicles get a fence of their own, round the whole field, for the time of the mission."""
    vehicle_fence_beyond_m: float = Field(default=4.0, ge=0)
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


class RobotTable(_Table):
    """One robot."""

    name: str = Field(min_length=1)
    receiver: ReceiverTable
    vehicle: VehicleTable


class TeamTable(_Table):
    """Robots that move abreast: two, or one."""

    robots: tuple[str, ...] = Field(min_length=1, max_length=2)


class MissionFile(_Table):
    """The whole file."""

    schema_: Literal[1] = Field(alias="schema")
    name: str = "mission"
    seed: int = 0
    field: FieldTable
    antenna: AntennaTable
    sources: SourcesTable = SourcesTable()
    engine: EngineTable = EngineTable()
    association: AssociationTable = AssociationTable()
    end: EndTable = EndTable()
    recording: RecordingTable = RecordingTable()
    safety: SafetyTable = SafetyTable()
    team: tuple[TeamTable, ...] = Field(min_length=1)
    robot: tuple[RobotTable, ...] = Field(min_length=1)
    positions: tuple[PositionsTable, ...] = ()


@dataclass(frozen=True, slots=True)
class Mission:
    """A mission that has been checked: everything its setup, kernel and safety need."""

    file: MissionFile
    text: str
    """The mission.toml as written."""
    antenna_text: str
    antenna: AntennaFile
    frame: FieldFrame
    kernel: KernelSettings
    safety: SafetySettings
    where: str
    """What to call it in messages: its path."""

    @property
    def fence_m(self) -> tuple[tuple[float, float], ...]:
        """Corners of the ground robots may be on."""
        field = self.file.field
        return field.fence or _rectangle(field.size_east_m, field.size_north_m, 0.0)

    @property
    def vehicle_fence_m(self) -> tuple[tuple[float, float], ...]:
        """Corners of the vehicles' own fence, their last line; empty where they get none."""
        field, safety = self.file.field, self.file.safety
        if not safety.vehicle_fence:
            return ()
        return _rectangle(field.size_east_m, field.size_north_m, safety.vehicle_fence_beyond_m)


def _rectangle(east_m: float, north_m: float, beyond_m: float) -> tuple[tuple[float, float], ...]:
    low = -beyond_m
    return (
        (low, low),
        (east_m + beyond_m, low),
        (east_m + beyond_m, north_m + beyond_m),
        (low, north_m + beyond_m),
    )


def read_mission(path: Path) -> Mission:
    """Read and check a mission file and the antenna file it names, relative to itself. Raises `ConfigError`."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; 'fieldkit new {path}' writes one to start from") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from error
    file = parse_mission(text, str(path))
    antenna_path = path.parent / file.antenna.file
    antenna = read_antenna(
        antenna_path,
        allow_refused=file.antenna.allow_refused,
        allow_pattern=file.engine.sensing == "directional",
    )
    return assemble(file, text, antenna, antenna_path.read_text(encoding="utf-8"), str(path))


def parse_mission(text: str, where: str) -> MissionFile:
    """Check the text of a mission file. Raises `ConfigError`: file, key path, what was expected, what was there."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{where}: not valid TOML: {error}") from error
    schema = raw.get("schema")
    if isinstance(schema, int) and schema > SCHEMA:
        raise ConfigError(
            f"{where}: schema: {schema} is newer than this fieldkit knows ({SCHEMA}); update fieldkit"
        )
    try:
        file = MissionFile.model_validate(raw)
    except pydantic.ValidationError as error:
        raise ConfigError("\n".join(_explain(where, problem) for problem in error.errors())) from None
    _check_robots(file, where)
    _check_names(file, where)
    return file


def _explain(where: str, problem: Any) -> str:
    key = ".".join(str(part) for part in problem["loc"]).replace("schema_", "schema")
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"] == "missing":
        return f"{where}: {key}: expected a value, got nothing"
    if problem["type"] == "extra_forbidden":
        return f"{where}: {key}: no such key; is it misspelt, or in the wrong table?"
    return f"{where}: {key}: {message[0].lower() + message[1:]}, got {problem['input']!r}"


def _check_robots(file: MissionFile, where: str) -> None:
    names = [robot.name for robot in file.robot]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(
                f"{where}: robot: the name {name!r} is given to {names.count(name)} robots; give each its own"
            )
    teamed = [name for team in file.team for name in team.robots]
    for name in teamed:
        if name not in names:
            raise ConfigError(
                f"{where}: team.robots: there is no robot {name!r}; robots are: {', '.join(names)}"
            )
        if teamed.count(name) > 1:
            raise ConfigError(
                f"{where}: team.robots: robot {name!r} is in {teamed.count(name)} teams; expected one"
            )
    for name in names:
        if name not in teamed:
            raise ConfigError(
                f"{where}: team: robot {name!r} is in no team; add [[team]] robots = [{name!r}]"
            )
    seen: dict[tuple[str, str, Any], str] = {}
    ports: dict[str, str] = {}
    for robot in file.robot:
        extra = robot.vehicle.model_extra or {}
        if (system_id := extra.get("system_id")) is not None:
            key = (robot.vehicle.driver, robot.vehicle.address, system_id)
            if key in seen:
                raise ConfigError(
                    f"{where}: robot {robot.name!r}: vehicle.system_id: {system_id} is robot {seen[key]!r}'s "
                    "already on "
                    f"{robot.vehicle.address}; every vehicle on a link needs an id of its own (SYSID_THISMAV)"
                )
            seen[key] = robot.name
        port = (robot.receiver.model_extra or {}).get("port")
        if port is not None:
            if str(port) in ports:
                raise ConfigError(
                    f"{where}: robot {robot.name!r}: receiver.port: {port} is robot {ports[str(port)]!r}'s already"
                )
            ports[str(port)] = robot.name


def _check_names(file: MissionFile, where: str) -> None:
    """Names of drivers, belief and planner must exist; nothing is imported yet."""
    wanted = [
        ("fieldkit.beliefs", "engine.belief", file.engine.belief),
        ("fieldkit.planners", "engine.planner", file.engine.planner),
    ]
    for number, source in enumerate(file.positions):
        wanted.append(("fieldkit.positions", f"positions.{number}.driver", source.driver))
    for robot in file.robot:
        wanted.append(("fieldkit.receivers", f"robot {robot.name!r}: receiver.driver", robot.receiver.driver))
        wanted.append(("fieldkit.vehicles", f"robot {robot.name!r}: vehicle.driver", robot.vehicle.driver))
    for group, key, name in wanted:
        known = plugins.names(group)
        if name not in known:
            raise ConfigError(f"{where}: {key}: expected one of {', '.join(known)}, got {name!r}")


def assemble(file: MissionFile, text: str, antenna: AntennaFile, antenna_text: str, where: str) -> Mission:
    """Settings for every part, from a checked file and its antenna. Raises `ConfigError`."""
    field = file.field
    # The calibration's own uncertainty widens every reading; at the range where most readings are made.
    typical_m = float(np.median(antenna.antenna.nominal_range_m(np.array(file.sources.power_levels_db))))
    sigma_db = float(predictive_sigma_db(antenna, typical_m))
    radio = with_pattern(antenna) if file.engine.sensing == "directional" else antenna.antenna
    engine = EngineSettings(
        grid=Grid(field.size_east_m, field.size_north_m, field.cell_m),
        antenna=replace(radio, sigma_db=sigma_db),
        teams=tuple(team.robots for team in file.team),
        power_levels_db=file.sources.power_levels_db,
        found_probability=file.engine.found_probability,
        min_receptions=file.engine.min_receptions,
        reference_rate_hz=file.sources.rate_hz,
        expected_sources=file.sources.expected,
        planning_period_s=file.engine.planning_period_s,
        max_speed_m_s=file.safety.max_speed_m_s,
        max_turn_deg_s=file.safety.max_turn_deg_s,
        min_separation_m=file.safety.min_separation_m,
        fence_margin_m=file.safety.fence_margin_m,
        pose_sigma_m=file.engine.pose_sigma_m,
        keep_out=KeepOut((*field.keep_out, *((outside(field.fence),) if field.fence else ()))),
        seed=file.seed,
        prior_rule=file.engine.prior_rule,
        sensing=file.engine.sensing,
        directional_form=file.engine.directional_form,
        group_gap_m=file.engine.group_gap_m,
        normalised_entropy=file.engine.normalised_entropy,
    )
    kernel = KernelSettings(
        engine,
        belief=file.engine.belief,
        planner=file.engine.planner,
        association_window_s=file.association.window_s,
        association_lateness_s=file.association.lateness_s,
        max_pose_gap_s=file.association.max_pose_gap_s,
        max_duration_s=file.end.max_duration_s,
        deaf_limit_s=file.safety.radio_timeout_s,
        battery_reserve_pct=file.safety.battery_reserve_pct,
        battery_pct_per_m=file.safety.battery_pct_per_m,
        sources_expected=file.end.sources_found,
        stop_probability_left=file.end.probability_left,
        stop_after_periods=file.end.periods_without_find,
    )
    safety = SafetySettings(
        robots=engine.robots,
        size_east_m=field.size_east_m,
        size_north_m=field.size_north_m,
        fence_margin_m=file.safety.fence_margin_m,
        max_speed_m_s=file.safety.max_speed_m_s,
        max_leg_m=file.safety.max_leg_m,
        pose_timeout_s=file.safety.pose_timeout_s,
        min_separation_m=file.safety.min_separation_m,
        keep_out=engine.keep_out,
        overrun_s=file.safety.overrun_s,
        radio_timeout_s=file.safety.radio_timeout_s,
        radio_return_s=file.safety.radio_return_s,
        stall_s=file.safety.stall_s,
        call_after_s=file.safety.call_after_s,
        battery_reserve_pct=file.safety.battery_reserve_pct,
        battery_pct_per_m=file.safety.battery_pct_per_m,
    )
    frame = FieldFrame(field.origin_lat_deg, field.origin_lon_deg, field.origin_alt_m)
    return Mission(file, text, antenna_text, antenna, frame, kernel, safety, where)
