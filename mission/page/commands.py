"""What a browser may ask for, checked: anything else is answered with words, never with an error of ours.

What the server says is in `mission.page.protocol`; the types of the page's JavaScript are made from both.
"""

import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

Number = Annotated[float, Field(allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-1e7, le=1e7, allow_inf_nan=False)]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class Token(_Asked):
    """Asks for the right to command."""

    kind: Literal["token"]
    token: str


class Look(_Asked):
    """How was it at that time? Of a mission under way."""

    kind: Literal["look"]
    t_s: Number


class Seek(_Asked):
    """Go to that time of a recording."""

    kind: Literal["seek"]
    t_s: Number


class Play(_Asked):
    """Play a recording from where it is, so many times as fast as it was."""

    kind: Literal["play"]
    rate: Number


class Pause(_Asked):
    """Play no further."""

    kind: Literal["pause"]


Question = Look | Seek | Play | Pause
"""Asks for something else to see."""


class Numbered(_Asked):
    """Goes with every command: its answer has the same number."""

    kind: Literal["command"]
    number: Annotated[int, Field(strict=True)]


class Steer(_Asked):
    """Orders for one robot, or for all where `robot` is None."""

    action: Literal["hold", "resume", "return", "release"]
    robot: Annotated[str, Field(max_length=200)] | None = None


class End(_Asked):
    """The end of the whole mission."""

    action: Literal["end"]
    robot: None = None


class Remove(_Asked):
    """A transmitter that has been taken away."""

    action: Literal["remove"]
    source: Annotated[int, Field(strict=True, ge=0, le=2**31)]


class Mark(_Asked):
    """A person says that a transmitter is where they stand."""

    action: Literal["mark"]
    robot: Annotated[str, Field(max_length=200)]


class TakenBearing(_Asked):
    """A person has turned round with the radio in front."""

    action: Literal["bearing"]
    robot: Annotated[str, Field(max_length=200)]
    bearing_deg: Annotated[float, Field(ge=0.0, le=360.0, allow_inf_nan=False)]
    error_90_deg: Annotated[float, Field(ge=0.0, le=180.0, allow_inf_nan=False)]
    swing_db: Annotated[float, Field(ge=0.0, le=200.0, allow_inf_nan=False)]

    @property
    def words(self) -> str:
        """For the recording."""
        return (
            f"bearing {self.bearing_deg:.0f} degrees, off by {self.error_90_deg:.0f} at most (90 %), "
            f"{self.swing_db:.0f} dB between front and back"
        )


class Exclude(_Asked):
    """An area that is closed to all robots."""

    action: Literal["exclude"]
    area_m: Annotated[tuple[tuple[Coordinate, Coordinate], ...], Field(min_length=3, max_length=100)]


Command = Steer | End | Remove | Mark | TakenBearing | Exclude
"""What a robot or the mission is to do."""
_COMMAND: TypeAdapter[Command] = TypeAdapter(Annotated[Command, Field(discriminator="action")])
_QUESTION: TypeAdapter[Question] = TypeAdapter(Annotated[Question, Field(discriminator="kind")])
ACTIONS = ("hold", "resume", "return", "release", "end", "remove", "mark", "exclude", "bearing")


def message_of(data: str | bytes) -> dict[str, Any]:
    """A frame from a browser as a message; an empty one where it is none."""
    try:
        message = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def token_of(message: dict[str, Any]) -> str:
    """The token it shows; empty where it shows none."""
    try:
        return Token.model_validate(message).token
    except (ValidationError, RecursionError):
        return ""


def number_of(message: dict[str, Any]) -> int | None:
    """A command's number; a command without one is carried out all the same."""
    try:
        return Numbered.model_validate(message).number
    except (ValidationError, RecursionError):
        return None


def question_of(message: dict[str, Any]) -> Question | None:
    """A question; None where it is none that there is, or asks for no time."""
    try:
        return _QUESTION.validate_python(message)
    except (ValidationError, RecursionError):
        return None


def checked_command(message: dict[str, Any]) -> dict[str, Any] | str:
    """A command as `Operator`'s arguments, or why it is none. Which robots there are is for the mission to say."""
    try:
        command = _COMMAND.validate_python(message)
    except (ValidationError, RecursionError) as error:
        return _words(message, error)
    if isinstance(command, TakenBearing):
        return {"action": command.action, "robot": command.robot, "reason": command.words}
    return {"robot": None, **command.model_dump()}


def _words(message: dict[str, Any], error: Exception) -> str:
    action = message.get("action")
    if not isinstance(action, str) or action not in ACTIONS:
        return f"there is no command {repr(action)[:40]}; commands are: {', '.join(ACTIONS)}"
    if not isinstance(error, ValidationError):
        return f"{action}: cannot be read"
    problem = error.errors(include_input=False, include_url=False)[0]
    key = ".".join(str(part) for part in problem["loc"] if part != action)
    return f"{action}: {key}: {problem['msg']}"
