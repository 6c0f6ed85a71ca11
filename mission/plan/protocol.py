"""What the editor's server answers to its page, and the form that goes to and fro.

As `mission.page.protocol` is for the live page: the types of the page's JavaScript are made from these. What the form
says of a mission file is what the file says: where that is of another kind than stated here, the judge says so.
"""

from typing import Any, Literal, NotRequired

from typing_extensions import TypedDict

from fieldkit.checks import Level
from mission.page.protocol import Place


class TopForm(TypedDict):
    """The keys at the file's top that the form has."""

    name: str | None


class FieldForm(TypedDict):
    """Those of [field]."""

    origin_lat_deg: float | None
    origin_lon_deg: float | None
    size_east_m: float | None
    size_north_m: float | None
    cell_m: float | None
    fence: list[Place] | None
    keep_out: list[list[Place]] | None
    background: str | None


class AntennaForm(TypedDict):
    """Those of [antenna]."""

    file: str | None


class SourcesForm(TypedDict):
    """Those of [sources]."""

    rate_hz: float | None
    expected: float | None


class EndForm(TypedDict):
    """Those of [end]."""

    max_duration_s: float | None
    sources_found: int | None


class SafetyForm(TypedDict):
    """Those of [safety]."""

    max_speed_m_s: float | None
    min_separation_m: float | None
    fence_margin_m: float | None
    battery_reserve_pct: float | None


class FormRobot(TypedDict):
    """A [[robot]]."""

    name: str
    was: NotRequired[str]
    """Its name in the file, where it has been renamed."""
    receiver: dict[str, Any]
    """The driver and its options."""
    vehicle: dict[str, Any]
    altitude_m: float | None


class Form(TypedDict):
    """All that the form shows; null where the file does not say it."""

    top: TopForm
    field: FieldForm
    antenna: AntennaForm
    sources: SourcesForm
    end: EndForm
    safety: SafetyForm
    robots: list[FormRobot]
    teams: list[list[str]]


class RemarkShown(TypedDict):
    """One thing to say of a draft."""

    level: Literal["red", "amber"]
    """Red: it cannot be flown so; amber: it can, but."""
    key: str
    """As in the file: "field.cell_m"; empty where it is about the whole."""
    text: str


class Choices(TypedDict):
    """What there is to choose from: drivers, and files beside the mission file."""

    receivers: list[str]
    vehicles: list[str]
    antennas: list[str]
    pictures: list[str]


class Standing(TypedDict):
    """A vehicle that was heard, where it stands in the draft's field."""

    name: str
    place: Place


class Draft(TypedDict):
    """The answer of /plan/state, /plan/change and /plan/store."""

    path: str
    form: Form
    text: str
    remarks: list[RemarkShown]
    stored: bool
    new: bool
    standing: list[Standing]
    """As last heard; empty where the field's corner is not known."""
    choices: NotRequired[Choices]
    """With /plan/state only."""


class Port(TypedDict):
    """One of the answer of /plan/ports."""

    port: str
    what: str
    advice: list[str]
    settings: dict[str, str]
    answered: bool
    """Whether the port is there, and what is on it was recognised."""


class HeardVehicle(TypedDict):
    """One of the answer of /plan/heard."""

    system_id: int
    firmware: str
    mode: str
    armed: bool
    battery_pct: float | None
    heartbeats: int
    has_position: bool
    place_deg: tuple[float, float] | None
    """Latitude and longitude."""
    address: str
    two_with_this_id: bool
    texts: list[str]


class CheckShown(TypedDict):
    """One check before the start."""

    robot: str
    name: str
    level: Level
    found: str
    remedy: str


class Preflight(TypedDict):
    """The answer of /plan/preflight."""

    verdict: Level
    checks: list[CheckShown]
