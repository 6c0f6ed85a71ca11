"""The one home of limits and defaults: mission file, engine, safety and simulator take them from here.

A `Quantity` says what a value means, in which unit, what it is where nobody says otherwise, and between which bounds
it makes sense. The bounds are those of robots and radios that exist: outside them a number is a slip of the pen.
"""

import math
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Quantity:
    """One value somebody may set."""

    default: float
    low: float
    high: float
    unit: str
    meaning: str
    above_low: bool = False
    """Whether `low` itself is too low."""


def positive(default: float, high: float, unit: str, meaning: str) -> Quantity:
    """A quantity above nothing."""
    return Quantity(default, 0.0, high, unit, meaning, above_low=True)


# -- the field -----------------------------------------------------------------------------------------------

FIELD_SIDE_M = positive(25.0, 100_000.0, "m", "side of the field's rectangle")
CELL_M = positive(0.5, 1_000.0, "m", "side of a cell of the belief's grid")
ALTITUDE_M = Quantity(0.0, -500.0, 9_000.0, "m", "altitude of the field's origin above the sea")
MOST_CELLS = 4_000_000
"""Cells of a grid: more do not fit into the memory of a laptop together with what planners keep of them."""
COORDINATE_M = Quantity(0.0, -200_000.0, 200_000.0, "m", "coordinate of a corner in the field frame")

# -- transmitters --------------------------------------------------------------------------------------------

POWER_DB = Quantity(0.0, -60.0, 60.0, "dB", "power of a transmitter relative to the calibrated one")
RATE_HZ = Quantity(0.05, 1e-6, 1_000.0, "Hz", "transmissions of a typical source")
SOURCE_UP_M = Quantity(0.0, -500.0, 9_000.0, "m", "height of transmitters above the field's origin")
EXPECTED_SOURCES = positive(4.0, 10_000.0, "", "expected number of sources in the field")
IDENTITY: Final = "anonymous"
"""The addresses that frames name are not used to distinguish sources."""

# -- receivers -----------------------------------------------------------------------------------------------

RSS_OFFSET_DB = Quantity(
    0.0, -60.0, 60.0, "dB", "how much more a robot's radio reports than the calibrated one"
)
THRESHOLD_DBM = Quantity(-92.0, -250.0, 50.0, "dBm", "strongest level a robot's radio does not receive")

# -- the engine ----------------------------------------------------------------------------------------------

BELIEF: Final = "intensity"
PLANNER: Final = "infogain"
PRIOR_RULE: Final = "em"
SENSING: Final = "levels"
DIRECTIONAL_FORM: Final = "censored"
GROUP_GAP_M = math.inf
"""Ridges of `dprwa` are toured in one group, as the paper does, until a mission says how far apart they may be."""
FOUND_PROBABILITY = Quantity(0.9, 0.5, 0.9999, "", "probability from which a source counts as found")
MIN_RECEPTIONS = positive(3.0, 1_000.0, "", "receptions from which a source counts as found")
PLANNING_PERIOD_S = Quantity(20.0, 1.0, 3_600.0, "s", "time between plans")
POSE_SIGMA_M = Quantity(0.05, 0.0, 100.0, "m", "standard deviation of each coordinate of robots' positions")
ARRIVE_M = Quantity(0.15, 0.01, 1_000.0, "m", "a robot so near to its way-point has arrived")
ARRIVE_SIGMAS = 3.0
"""A robot is not asked to be nearer to a way-point than its position is known."""
ARRIVE_S = 0.6
"""... nor nearer than it drives in this time: measured on the simulated ArduRover, which rests 0.4 m off at 1 m/s."""
SEED_MAX = 2**63 - 1

# -- association ---------------------------------------------------------------------------------------------

WINDOW_S = positive(0.1, 60.0, "s", "receptions nearer than this are one transmission")
LATENESS_S = positive(1.0, 600.0, "s", "how late a reception may reach this computer")
POSE_GAP_S = positive(1.0, 600.0, "s", "longest gap between positions that is interpolated")
SILENCE_STEP_S = 1.0
"""Silence is given to the belief in stretches of this length, each heard from the place in its middle."""

# -- the loop ------------------------------------------------------------------------------------------------

TICK_S = 0.5
"""Time between the kernel's regular looks, in a running mission and in one rebuilt from radios' own logs."""
REPEAT_S = 3.0
"""An order that a vehicle has not shown to follow is given again after this long."""

# -- a walk --------------------------------------------------------------------------------------------------

WALKER: Final = "walker"
"""Whoever walks, where nobody gives a name."""
WALK_SIDE_M = 300.0
"""Side of the field round a walk's first position."""
WALK_RATE_HZ = 0.1
WALK_FOUND_WITHIN_M = 10.0

# -- devices -------------------------------------------------------------------------------------------------

BAUD = 115_200
"""Of radios that print, and of XBee modules in API mode as they are best set."""
CHANNEL = 15
"""Of IEEE 802.15.4."""
MARKERS: Final = "aruco-4x4"
SEEN_SPEED_M_S = 3.0
"""The fastest that a robot may move between two pictures."""
TELEMETRY: Final = "127.0.0.1:14550"
"""Where vehicles send theirs: ArduPilot's own port."""
POSE_NOISE_M = 0.02
"""Standard deviation of each coordinate of an emulated vehicle's positions."""
SURVEY_GAP_S = 5.0
"""Between positions of a log further apart in time than this nobody knows where the radio was."""

# -- calibration ---------------------------------------------------------------------------------------------

MISSED: Final = "auto"
"""Whether a log has the packets that were not received: a single empty reading proves that it has."""
PATTERN: Final = "none"

# -- the page ------------------------------------------------------------------------------------------------

PAGE_HOST: Final = "127.0.0.1"
PAGE_PORT = 8321
COMPARED_BY: Final = "planner"
"""How `fieldkit compare` groups missions."""
MOST_TILES = 10_000
"""So many tiles may be asked for by `fieldkit refit --tiles`."""

# -- what is drawn -------------------------------------------------------------------------------------------

ELLIPSE_90 = 2.146
"""Standard deviations around the middle of a plane normal that hold 90 % of it: sqrt(-2 ln 0.1)."""

# -- other people's maps -------------------------------------------------------------------------------------

COT_EVERY_S = Quantity(5.0, 0.2, 600.0, "s", "time between two tellings of everything by Cursor on Target")

# -- robots without a common computer ------------------------------------------------------------------------

STANDS_M_S = 0.2
"""A vehicle on the ground that is no faster stands: satellites give one that stands some speed too."""
DRIFTS_M_S = 0.5
"""One in the air that is no faster hovers, in wind too."""
AGENT_BYTES_S = Quantity(1_400.0, 100.0, 1e6, "B/s", "what one robot's agent sends at the most")
"""Four of them fit on a telemetry radio of 57.6 kbit/s."""
AGENT_ABSENT_S = 12.0
"""A robot of which nothing is known for so long is out of contact: the others plan on without its word."""
AGENT_WAIT_S = Quantity(
    60.0, 0.0, 3_600.0, "s", "at the start an agent waits so long for robots that nobody has heard of"
)
"""Then it goes on without them."""

# -- the end -------------------------------------------------------------------------------------------------

MAX_DURATION_S = positive(3_600.0, 30 * 86_400.0, "s", "longest duration of a mission")
IDLE_LIMIT_S = 120.0
"""A mission in which no robot could be steered for so long ends."""

# -- safety --------------------------------------------------------------------------------------------------

FENCE_MARGIN_M = Quantity(
    0.2, 0.0, 1_000.0, "m", "way-points keep this far inside the fence and off closed ground"
)
MARGIN_SIGMAS = 2.0
"""So many standard deviations of the positions are added to every margin."""
MAX_SPEED_M_S = Quantity(0.4, 0.01, 50.0, "m/s", "no robot is ordered to go faster")
MAX_TURN_DEG_S = Quantity(90.0, 0.1, 1_000.0, "deg/s", "how fast a robot turns")
MAX_LEG_M = Quantity(1_000.0, 0.1, 100_000.0, "m", "no way-point is further away")
POSE_TIMEOUT_S = Quantity(2.0, 0.2, 60.0, "s", "a position that is older is unknown")
MIN_SEPARATION_M = Quantity(
    0.5, 0.05, 1_000.0, "m", "no two way-points are nearer; robots at half of it are too near"
)
VERTICAL_SEPARATION_M = Quantity(3.0, 0.5, 1_000.0, "m", "robots so far above each other cannot meet")
OVERRUN_S = Quantity(3.0, 0.5, 60.0, "s", "robots hold when the steering loop was silent for longer")
RADIO_TIMEOUT_S = positive(10.0, 3_600.0, "s", "a robot whose radio is down for longer holds")
RADIO_RETURN_S = positive(120.0, 86_400.0, "s", "... and after this long goes home")
STALL_S = Quantity(15.0, 2.0, 3_600.0, "s", "a robot that should have moved for so long and has not is stuck")
CALL_AFTER_S = Quantity(30.0, 1.0, 3_600.0, "s", "a robot held for so long needs the operator")
BATTERY_RESERVE_PCT = Quantity(25.0, 0.0, 95.0, "%", "what must be left when a robot is home")
BATTERY_PCT_PER_M = Quantity(0.0, 0.0, 100.0, "%/m", "what a metre costs; 0 where it is not known")
BATTERY_LOW_V = Quantity(
    0.0, 0.0, 1_000.0, "V", "a robot whose battery has sunk to this goes home; 0: not watched"
)
VEHICLE_FENCE_BEYOND_M = Quantity(
    4.0, 0.0, 10_000.0, "m", "how far outside the field the vehicles' own fence runs"
)
BRAKING_M = Quantity(0.0, 0.0, 1_000.0, "m", "how far a robot rolls on after a hold, at the limit of speed")
BRAKING_DECELERATION_M_S2 = 0.5
BRAKING_DELAY_S = 0.25
"""Braking of a robot that nobody has measured: the simulated ArduRover rolls 0.9 to 1.5 m at 1 m/s, this gives 1.25."""
TURN_RADIUS_M = Quantity(0.0, 0.0, 100.0, "m", "the circle that a robot turns in, at the limit of speed")
TURN_S = 0.6
WIDEST_TURN_M = 2.0
"""Turning of a robot that nobody has measured: what it drives in `TURN_S`, as the simulated ArduRover at 1.5 m/s does
(TURN_RADIUS 0.9); no wider than one can build for a field."""
FLIGHT_ALTITUDE_M = Quantity(
    10.0, 1.0, 500.0, "m", "height above home at which the lowest flying robot works"
)


def braking_m(max_speed_m_s: float) -> float:
    """How far a robot rolls on at `max_speed_m_s` after it was ordered to hold, where it was not measured."""
    return BRAKING_DELAY_S * max_speed_m_s + max_speed_m_s**2 / (2.0 * BRAKING_DECELERATION_M_S2)


def turn_radius_m(max_speed_m_s: float) -> float:
    """How wide a robot on wheels turns, where nobody says."""
    return min(WIDEST_TURN_M, TURN_S * max_speed_m_s)


def arrive_m(max_speed_m_s: float, pose_sigma_m: float) -> float:
    """How near a robot must come to its way-point, where nobody says otherwise."""
    return max(ARRIVE_M.default, ARRIVE_SIGMAS * pose_sigma_m, ARRIVE_S * max_speed_m_s)
