"""What the page's server says to a browser, kind by kind; what browsers say is in `mission.page.commands`.

Plain dictionaries with a type each: the type checker reads them where they are made, tests validate what real missions
send, and nothing is validated on its way, many times a second. `python -m mission.lab.page_types` makes the types of
the page's JavaScript from these: a field that is new here is known there.

Places are (east, north) in metres; `t_s` are seconds since the start of the mission.
"""

import json
from typing import Literal, NotRequired

from typing_extensions import TypedDict

from fieldkit.messages import SourceState, VehicleMode
from mission.maps.background import BackgroundShown

Place = tuple[float, float]
TrackPoint = tuple[float, float, float]
"""(s, east, north)."""
SavedAs = tuple[str, str]
"""A word, and where it is answered."""


class FieldShape(TypedDict):
    """The field, from its south-west corner."""

    east_m: float
    north_m: float
    fence_m: list[Place]
    margin_m: float
    """Robots stay so far inside the fence."""


class Member(TypedDict):
    """One robot of the team."""

    name: str
    team: int
    on_foot: bool
    """It is a person."""


Ends = Literal["mission", "agent", "page"]
"""What End on a page ends: of robots without a common computer one agent alone, or nothing but the page."""


class _Hello(TypedDict):
    kind: Literal["hello"]
    mission: str
    field: FieldShape
    robots: list[Member]
    pose_timeout_s: float
    """A position that is older counts as lost."""
    background: BackgroundShown | None
    files: list[SavedAs]
    """What can be saved of it."""


class LiveHello(_Hello):
    """What does not change, of a mission under way. It comes first."""

    live: Literal[True]
    ends: Ends


class PastHello(_Hello):
    """What does not change, of a recording. It comes first."""

    live: Literal[False]
    duration_s: float


class Rights(TypedDict):
    """What a browser may do, once it has shown a token."""

    kind: Literal["rights"]
    may_command: bool
    wrong_token: bool


class Answer(TypedDict):
    """What became of a command."""

    kind: Literal["answer"]
    number: int | None
    """The command's own; null where it had none."""
    ok: bool
    text: str
    """Why it is refused."""


class Robot(TypedDict):
    """One robot now."""

    name: str
    east_m: float | None
    north_m: float | None
    heading_deg: float | None
    """Clockwise from north."""
    pose_age_s: float | None
    link_age_s: float | None
    link_up: bool
    mode: VehicleMode
    armed: bool
    battery_pct: float | None
    reserve_pct: float
    """It goes home at this."""
    fence_m: float | None
    """To the fence; negative outside."""
    text: str
    """The vehicle's own last words."""
    radio_up: bool
    radio_why: str
    """What its receiver says of being down: whoever carries it can mend that."""
    ordered: str
    """A standing order of the operator's, or safety's "withdraw"."""
    call: str
    """Why it needs the operator."""
    doing: str
    """What the planner wants with its path."""
    command: Literal["", "go to", "hold", "return"]
    """The last one, and in `why` where to or why."""
    why: str
    answer: str
    """Of the vehicle to it."""
    path_m: list[Place]
    target_m: Place | None


class Source(TypedDict):
    """What is believed of one source."""

    ident: int
    state: SourceState
    east_m: float
    north_m: float
    half_axes_m: tuple[float | None, float | None]
    """Of its 90 % ellipse, the longer first."""
    turn_deg: float
    """Of the longer one, counter-clockwise from east."""
    p: float
    """Probability that it is within the distance of a find from here."""
    receptions: float
    power_db: float | None
    rate_hz: float | None
    note: str


class MarkedPlace(TypedDict):
    """A person's word that a transmitter is there."""

    by: str
    east_m: float
    north_m: float


class Frame(TypedDict):
    """The present, or one moment of a recording."""

    kind: Literal["frame"]
    t_s: float
    left: float
    """Probability that a source is not found yet."""
    detections: int
    end: str
    """How the mission ended; empty while it runs."""
    robots: list[Robot]
    sources: list[Source]
    areas_m: list[list[Place]]
    """Closed to all robots."""
    marks: list[MarkedPlace]
    alarms: list[str]
    """What the operator must know at once."""
    viewers: NotRequired[int]
    """Live only, as the next three."""
    commanders: NotRequired[int]
    over: NotRequired[bool]
    """Whether nobody is steered any more. Robots that fly still go home and land when the mission has ended."""
    recording: NotRequired[str]
    """How large it is, and how much room is left."""


GridName = Literal["belief", "exposure"]


class Grid(TypedDict):
    """A number for each cell of the field: a byte each, row 0 south, from the west."""

    kind: Literal["grid"]
    name: GridName
    n_east: int
    n_north: int
    cell_m: float
    largest: float
    """What byte 255 stands for; a byte is the square root of the share of it."""
    data: str
    """The bytes in base64."""


class Heard(TypedDict):
    """A transmission as the team heard it."""

    t_s: float
    heard_dbm: dict[str, float]
    listening: list[str]


class Note(TypedDict):
    """A line of the log."""

    t_s: float
    level: str
    text: str


class Point(TypedDict):
    """Probabilities at one time."""

    t_s: float
    left: float
    p: dict[str, float]
    """Of each source, by its number."""


class News(TypedDict):
    """One thing that has happened; one of the three is there."""

    kind: Literal["news"]
    detection: NotRequired[Heard]
    note: NotRequired[Note]
    point: NotRequired[Point]


class _Happened(TypedDict):
    tracks: dict[str, list[TrackPoint]]
    series: list[Point]
    detections: list[Heard]
    notes: list[Note]


class History(_Happened):
    """What has been, for a browser that has just come or goes to another time."""

    kind: Literal["history"]


class Past(TypedDict):
    """A moment looked back at while the mission goes on."""

    kind: Literal["past"]
    frame: Frame
    grids: list[Grid]


Sent = LiveHello | PastHello | Rights | Answer | Frame | Grid | History | News | Past
"""Whatever comes over the websocket."""


class GridAt(TypedDict):
    """A grid of a recording, and when it came."""

    t_s: float
    name: GridName
    grid: Grid


class Recorded(_Happened):
    """A recording inside a report's page."""

    hello: PastHello
    frames: list[Frame]
    grids: list[GridAt]


class Where(TypedDict):
    """The answer of /where: one place in other words, as text to copy."""

    metres: str
    lat_lon: str
    utm: str
    mgrs: str


class FittedBearing(TypedDict):
    """The answer of /bearing: what one turn round says."""

    bearing_deg: float | None
    error_90_deg: float | None
    swing_db: float
    why: str
    """Why there is no bearing; empty where there is one."""


class Run(TypedDict):
    """A recording in a folder."""

    name: str
    start_ns: int | None
    duration_s: float
    bytes: int
    readings: int
    found: int | None
    """Sources; null where it does not say."""
    ended: str
    """How; empty where it does not say."""
    missing: str
    """What of it is; empty where it is complete."""


class UnreadRun(TypedDict):
    """One that cannot be read."""

    name: str
    error: str


class Runs(TypedDict):
    """The answer of /runs/list, the newest first."""

    folder: str
    runs: list[Run | UnreadRun]
    unlisted: int
    """So many more are there."""


class OpenedRun(TypedDict):
    """The answer of /runs/open: where its page is."""

    address: str


class Failed(TypedDict):
    """Any answer, where it is refused."""

    error: str


def text_of(message: Sent) -> str:
    """As it goes over the websocket."""
    return json.dumps(message)
