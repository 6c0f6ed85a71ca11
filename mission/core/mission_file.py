"""mission.toml: read, checked at this edge, and turned into what kernel, safety and setups are given."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from fieldkit import plugins
from fieldkit import settings as given
from fieldkit.channel.antenna_file import (
    AntennaFile,
    Receiver,
    predictive_sigma_db,
    read_antenna,
    spread_of,
    with_pattern,
)
from fieldkit.channel.spread import ChannelSpread, known_power
from fieldkit.engine.grid import Grid
from fieldkit.engine.settings import EngineSettings
from fieldkit.errors import ConfigError
from fieldkit.files import is_stream
from fieldkit.geo import FieldFrame
from fieldkit.geometry.polygons import KeepOut
from fieldkit.tuning import Tuning
from mission.core.defaults import left_open
from mission.core.kernel_settings import KernelSettings
from mission.core.tables import MissionFile, rectangle
from mission.safety.limits import BatteryLimits, RadioLimits, SafetySettings

SCHEMA = 1
LONGEST_INPUT = 120
"""What was found is repeated in an error up to this length."""


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
    def recorded_settings(self) -> dict[str, Any]:
        """What a recording needs beside the two files, to be replayed by a fieldkit with other defaults."""
        kept = {"tuning": self.kernel.engine.tuning.tables(), "defaults": left_open(self.file)}
        if not (picture := self.file.field.background):
            return kept
        return kept | {"background": str((Path(self.where).parent / picture).absolute())}

    @property
    def fence_m(self) -> tuple[tuple[float, float], ...]:
        """Corners of the ground robots may be on."""
        return self.file.field.border

    @property
    def vehicle_fence_m(self) -> tuple[tuple[float, float], ...]:
        """Corners of the vehicles' own fence, their last line; empty where they get none."""
        field, safety = self.file.field, self.file.safety
        if not safety.vehicle_fence:
            return ()
        return rectangle(field.size_east_m, field.size_north_m, safety.vehicle_fence_beyond_m)


def read_mission(path: Path | str) -> Mission:
    """Read and check a mission file and the antenna file it names, relative to itself. Raises `ConfigError`."""
    path = Path(path)
    if is_stream(path):
        raise ConfigError(f"{path}: expected a mission file, got a pipe or device")
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; 'fieldkit new {path}' writes one to start from") from None
    except IsADirectoryError:
        raise ConfigError(f"{path}: is a folder; name the mission file in it") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is no text in UTF-8 ({error}); name a mission file") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    return mission_of(text, path)


def mission_of(text: str, path: Path) -> Mission:
    """A mission from its text, as if it stood at `path`; the antenna file is read. Raises `ConfigError`."""
    file = parse_mission(text.removeprefix("\ufeff"), str(path))
    antenna_path = path.parent / file.antenna.file
    antenna = read_antenna(
        antenna_path,
        allow_refused=file.antenna.allow_refused,
        allow_pattern=file.engine.sensing == "directional" or file.engine.belief == "intensity",
    )
    return assemble(file, text, antenna, antenna_path.read_text(encoding="utf-8"), str(path))


def parse_mission(text: str, where: str) -> MissionFile:
    """Check the text of a mission file. Raises `ConfigError`: file, key path, what was expected, what was there."""
    try:
        raw = tomllib.loads(text)
    except ValueError as error:  # a number of thousands of digits is one as well
        raise ConfigError(f"{where}: not valid TOML: {error}") from error
    except RecursionError:
        raise ConfigError(f"{where}: not valid TOML: nested too deeply") from None
    if "parameters" in raw and "field" not in raw:
        raise ConfigError(f"{where}: is an antenna file; name the mission file that uses it")
    schema = raw.get("schema")
    if isinstance(schema, int) and not isinstance(schema, bool) and schema > SCHEMA:
        raise ConfigError(
            f"{where}: schema: {str(schema)[:20]} is newer than this fieldkit knows ({SCHEMA}); update fieldkit"
        )
    try:
        file = MissionFile.model_validate(raw)
    except pydantic.ValidationError as error:
        problems = [_explain(where, each) for each in error.errors() if not _follows(each, error.errors())]
        raise ConfigError("\n".join(problems)) from None
    _check_robots(file, where)
    _check_names(file, where)
    return file


def _follows(problem: Any, problems: Sequence[Any]) -> bool:
    """A list counts as too short where one of its rows is refused: the row is what is to be mended."""
    loc = problem["loc"]
    return problem["type"] == "too_short" and any(
        each["loc"][: len(loc)] == loc and len(each["loc"]) > len(loc) for each in problems
    )


def _explain(where: str, problem: Any) -> str:
    key = ".".join(str(part) for part in problem["loc"]).replace("schema_", "schema")
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"] == "missing":
        return f"{where}: {key}: expected a value, got nothing"
    if problem["type"] == "extra_forbidden":
        return f"{where}: {key}: no such key; is it misspelt, or in the wrong table?"
    said = f"{where}: {key}: {message[0].lower() + message[1:]}" if key else f"{where}: {message}"
    got = repr(problem["input"])
    # A rule about several keys has the whole table for its input: that helps nobody.
    return said if problem["type"] == "value_error" or len(got) > LONGEST_INPUT else f"{said}, got {got}"


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


def _receivers(file: MissionFile, antenna: AntennaFile) -> dict[str, Receiver]:
    """Each robot's own radio: as the mission file has it, else the antenna file; who is in neither is as calibrated."""
    found = {}
    for robot in file.robot:
        radio = antenna.receivers.get(robot.name, Receiver(offset_measured=False))
        if robot.rss_offset_db is not None:
            radio = replace(radio, offset_db=robot.rss_offset_db, offset_measured=True)
        if robot.threshold_dbm is not None:
            radio = replace(radio, threshold_dbm=robot.threshold_dbm)
        if radio != Receiver(offset_measured=False):
            found[robot.name] = radio
    return found


def _spread(file: MissionFile, antenna: AntennaFile) -> ChannelSpread | None:
    """What readings of one place have in common: as measured, else as assumed, which preflight and `check` say.

    Levels that the mission file gives are known; without any a source may be any transmitter.
    """
    if not file.engine.place_noise or file.engine.belief != "intensity":
        return None
    spread = spread_of(antenna)
    if len(file.robot) == 1:
        # One receiver is off by as much as all sources are stronger: that is in the calibration's power.
        spread = replace(spread, receiver_db=0.0)
    return known_power(spread) if "power_levels_db" in file.sources.model_fields_set else spread


def assemble(
    file: MissionFile,
    text: str,
    antenna: AntennaFile,
    antenna_text: str,
    where: str,
    tuning: Tuning = Tuning(),
) -> Mission:
    """Settings for every part, from a checked file and its antenna. Raises `ConfigError`.

    `tuning` holds where the file says nothing: that of a recording, for one that is replayed.
    """
    field = file.field
    safety = _safety(file)
    engine = _engine(file, antenna, safety, tuning.with_tables(file.tuning))
    kernel = _kernel(file, engine, safety)
    frame = FieldFrame(field.origin_lat_deg, field.origin_lon_deg, field.origin_alt_m)
    return Mission(file, text, antenna_text, antenna, frame, kernel, safety, where)


def _safety(file: MissionFile) -> SafetySettings:
    """The limits of the mission. Engine and kernel take theirs from here."""
    field, table = file.field, file.safety
    braking_m = given.braking_m(table.max_speed_m_s) if table.braking_m is None else table.braking_m
    return SafetySettings(
        robots=tuple(robot for team in file.team for robot in team.robots),
        size_east_m=field.size_east_m,
        size_north_m=field.size_north_m,
        fence_margin_m=file.margin_m,
        max_speed_m_s=table.max_speed_m_s,
        max_leg_m=table.max_leg_m,
        pose_timeout_s=table.pose_timeout_s,
        min_separation_m=table.min_separation_m,
        keep_out=KeepOut(field.keep_out, field.fence, file.margin_m),
        overrun_s=table.overrun_s,
        radio=RadioLimits(table.radio_timeout_s, table.radio_return_s),
        stall_s=table.stall_s,
        call_after_s=table.call_after_s,
        battery=BatteryLimits(table.battery_reserve_pct, table.battery_pct_per_m, table.battery_low_v),
        vertical_separation_m=table.vertical_separation_m,
        braking_m=braking_m,
        turn_radius_m=file.turn_radius_m,
        altitude_m=file.altitudes_m(),
        on_foot=frozenset(robot.name for robot in file.robot if robot.on_foot),
    )


def _engine(
    file: MissionFile, antenna: AntennaFile, safety: SafetySettings, tuning: Tuning
) -> EngineSettings:
    """What belief and planner need, within the limits of safety."""
    field, table = file.field, file.engine
    # The calibration's own uncertainty widens every reading; at the range where most readings are made.
    typical_m = float(np.median(antenna.antenna.nominal_range_m(np.array(file.sources.power_levels_db))))
    sigma_db = float(predictive_sigma_db(antenna, typical_m))
    directional = table.sensing == "directional" or (table.belief == "intensity" and antenna.pattern)
    radio = with_pattern(antenna) if directional else antenna.antenna
    return EngineSettings(
        grid=Grid(field.size_east_m, field.size_north_m, field.cell_m),
        antenna=replace(radio, sigma_db=sigma_db),
        teams=tuple(team.robots for team in file.team),
        power_levels_db=file.sources.power_levels_db,
        found_probability=table.found_probability,
        min_receptions=table.min_receptions,
        spread=_spread(file, antenna),
        found_within_m=table.found_within_m,
        reference_rate_hz=file.sources.rate_hz,
        expected_sources=file.sources.expected,
        planning_period_s=table.planning_period_s,
        keep_teams=table.keep_teams,
        max_speed_m_s=safety.max_speed_m_s,
        max_turn_deg_s=file.safety.max_turn_deg_s,
        min_separation_m=safety.min_separation_m,
        fence_margin_m=safety.fence_margin_m,
        pose_sigma_m=table.pose_sigma_m,
        source_up_m=file.sources.up_m,
        identity=file.sources.identity,
        receivers=_receivers(file, antenna),
        keep_out=safety.keep_out,
        seed=file.seed,
        prior_rule=table.prior_rule,
        sensing=table.sensing,
        directional_form=table.directional_form,
        group_gap_m=table.group_gap_m,
        normalised_entropy=table.normalised_entropy,
        tuning=tuning,
    )


def _kernel(file: MissionFile, engine: EngineSettings, safety: SafetySettings) -> KernelSettings:
    """What decides where robots go and when the mission is over, within the limits of safety."""
    arrive_m = file.engine.arrive_m or given.arrive_m(safety.max_speed_m_s, engine.pose_sigma_m)
    return KernelSettings(
        engine,
        belief=file.engine.belief,
        planner=file.engine.planner,
        association_window_s=file.association.window_s,
        association_lateness_s=file.association.lateness_s,
        max_pose_gap_s=file.association.max_pose_gap_s,
        arrive_m=arrive_m,
        altitude_m=safety.altitude_m,
        max_duration_s=file.end.max_duration_s,
        radio=safety.radio,
        battery=safety.battery,
        sources_expected=file.end.sources_found,
        stop_probability_left=file.end.probability_left,
        stop_after_periods=file.end.periods_without_find,
    )
