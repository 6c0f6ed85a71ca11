"""The commented mission.toml that `fieldkit new` writes and the demo runs."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from fieldkit import settings as given


@dataclass(frozen=True, slots=True)
class TemplateRobot:
    """One robot's lines."""

    name: str
    port: str
    address: str
    system_id: int


EXAMPLE_ROBOTS = tuple(
    TemplateRobot(f"r{number}", f"/dev/ttyUSB{number - 1}", "udpin:0.0.0.0:14550", number)
    for number in range(1, 5)
)


_TEXT = """\
# A fieldkit mission. Check it with 'fieldkit check', run it with 'fieldkit run'.
schema = 1
name = "{name}"
seed = {seed}                     # of the planner's random choices; the same seed replays the same

[field]                      # a rectangle; its south-west corner is the origin of all metres
origin_lat_deg = {origin_deg[0]:.6f}
origin_lon_deg = {origin_deg[1]:.6f}
size_east_m = {size_m:.1f}
size_north_m = {size_m:.1f}
cell_m = {cell_m}                 # about a fifth of the shortest range is a good cell
# fence = [[0.5, 0.5], [20.0, 0.5], [12.0, 20.0]]    # a polygon no robot may leave; else the rectangle
# keep_out = [[[3.0, 3.0], [5.0, 3.0], [5.0, 6.0]]]  # polygons of (east, north) in metres no robot may enter

[antenna]
file = "{antenna}"        # relative to this file; written by 'fieldkit calibrate fit'

[sources]                    # what is known of the transmitters beforehand
power_levels_db = [{levels}]  # relative to the transmitter the calibration used
rate_hz = {rate_hz}               # how often a typical one transmits
expected = {expected:.1f}               # roughly how many there may be; not a limit

[engine]
{engine_lines}
found_probability = {found_probability}      # of being within found_within_m of the estimate
# found_within_m = 2.0       # else a tenth of the typical range, at least 2 m, at most a third of the range
min_receptions = 4
planning_period_s = {planning_period_s:.1f}
pose_sigma_m = {given.POSE_SIGMA_M.default}          # of each coordinate of the robots' positions
# arrive_m = 0.5             # so near to its way-point a robot has arrived; else from its speed and its positions
# prior_rule, sensing and more, for the papers' beliefs and planners: see docs/engine.md

[association]
window_s = {window_s}               # receptions this near are one transmission; 0.25 without synchronised clocks

[end]                        # whichever comes first
max_duration_s = {max_duration_s:.1f}
{found}            # where the number is known
{left}      # or: the probability that one is still unfound
# periods_without_find = 20  # or: so many planning periods in a row without another find (the papers' k_max)

# [recording]
# raw = true                 # keep every byte that came from the radios too
# rotate_mb = 500            # go on in a new file (mission.2.mcap, ...) when one has grown so large

[safety]                     # no command passes these
fence_margin_m = {fence_margin_m}         # way-points stay this far inside the field
max_speed_m_s = {given.MAX_SPEED_M_S.default}
pose_timeout_s = {given.POSE_TIMEOUT_S.default}
min_separation_m = {min_separation_m}       # between way-points of different robots; nearer than half of it, one holds
overrun_s = {overrun_s}              # robots hold when the steering loop was silent for longer
battery_reserve_pct = {reserve_pct}   # a robot goes home with this much left, or earlier where the way home is long:
# battery_pct_per_m = 0.02   # what a metre costs; half as much again is kept for the way home
# battery_low_v = 10.5       # or: home at this voltage, where the vehicle's per cent say little
# braking_m = 1.0            # how far a robot rolls on after a hold, at the limit of speed; else estimated
# turn_radius_m = 0.9        # the circle that a robot turns in, 0 for one that turns on the spot; else estimated
# robots that fly: flies = true in their [[robot]] table, or altitude_m = 12.0

# [[positions]]              # where robots are, if not from their own telemetry: see docs/camera.md
# driver = "camera"

{teams}
{each}"""


def emulated_text(
    *,
    size_m: float,
    origin_deg: tuple[float, float],
    sources: int,
    rate_hz: float,
    max_speed_m_s: float,
    robots: Sequence[tuple[str, int, str, str]],
) -> str:
    """The mission file of an emulated field, ready to run.

    `robots`: (name, system id, port of its radio, address of its telemetry).
    """
    text = mission_text(
        name="emulated field",
        origin_deg=origin_deg,
        size_m=size_m,
        cell_m=0.2,
        power_levels_db=(0.0,),
        rate_hz=rate_hz,
        expected=float(max(1, sources)),
        planning_period_s=20.0,
        sources_found=sources or None,
        fence_margin_m=0.2,
        min_separation_m=0.5,
        robots=[
            TemplateRobot(name, port, f"udpin:{address}", system_id)
            for name, system_id, port, address in robots
        ],
    )
    text = text.replace(f"max_speed_m_s = {given.MAX_SPEED_M_S.default}", f"max_speed_m_s = {max_speed_m_s}")
    return f"# Written by 'fieldkit emulate field', and anew whenever it starts: copy it to keep changes.\n{text}"


def mission_text(
    *,
    name: str = "my-field",
    seed: int = 0,
    origin_deg: tuple[float, float] = (47.397700, 8.545600),
    size_m: float = given.FIELD_SIDE_M.default,
    cell_m: float = given.CELL_M.default,
    antenna: str = "antenna.toml",
    power_levels_db: Sequence[float] = (-8.0, -6.0, -4.0, -2.0, 0.0),
    rate_hz: float = given.RATE_HZ.default,
    expected: float = given.EXPECTED_SOURCES.default,
    planning_period_s: float = given.PLANNING_PERIOD_S.default,
    window_s: float = given.WINDOW_S.default,
    found_probability: float = given.FOUND_PROBABILITY.default,
    max_duration_s: float = given.MAX_DURATION_S.default,
    sources_found: int | None = None,
    fence_margin_m: float = 0.5,
    min_separation_m: float = 1.0,
    overrun_s: float = given.OVERRUN_S.default,
    engine: Mapping[str, str | float | bool] = MappingProxyType({}),
    robots: Sequence[TemplateRobot] = EXAMPLE_ROBOTS,
) -> str:
    """The text of a mission file. Robots are teamed two by two. `engine`: belief, planner, what these want besides."""
    teams = "\n".join(
        f"[[team]]\nrobots = [{', '.join(repr(robot.name).replace(chr(39), chr(34)) for robot in robots[i : i + 2])}]\n"
        for i in range(0, len(robots), 2)
    )
    each = "\n".join(
        f'[[robot]]\nname = "{robot.name}"\n'
        f'receiver = {{ driver = "xbee", port = "{robot.port}" }}\n'
        f'vehicle = {{ driver = "mavlink", address = "{robot.address}", system_id = {robot.system_id} }}\n'
        for robot in robots
    )
    found = f"sources_found = {sources_found}" if sources_found else "# sources_found = 3"
    left = "# probability_left = 0.05" if sources_found else "probability_left = 0.05"
    chosen: dict[str, str | float | bool] = {"belief": given.BELIEF, "planner": given.PLANNER, **engine}
    return _TEXT.format(
        given=given,
        reserve_pct=given.BATTERY_RESERVE_PCT.default,
        name=name,
        seed=seed,
        origin_deg=origin_deg,
        size_m=size_m,
        cell_m=cell_m,
        antenna=antenna,
        levels=", ".join(f"{level:.1f}" for level in power_levels_db),
        rate_hz=rate_hz,
        expected=expected,
        engine_lines="\n".join(f"{key} = {json.dumps(value)}" for key, value in chosen.items()),
        found_probability=found_probability,
        planning_period_s=planning_period_s,
        window_s=window_s,
        max_duration_s=max_duration_s,
        found=found,
        left=left,
        fence_margin_m=fence_margin_m,
        min_separation_m=min_separation_m,
        overrun_s=overrun_s,
        teams=teams,
        each=each,
    )
