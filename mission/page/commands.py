"""What a browser may ask for, checked: anything else is answered with words, never with an error of ours."""

import json
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

Coordinate = Annotated[float, Field(ge=-1e7, le=1e7, allow_inf_nan=False)]


class _Asked(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


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


_Command = Steer | End | Remove | Mark | TakenBearing | Exclude
_COMMAND: TypeAdapter[_Command] = TypeAdapter(Annotated[_Command, Field(discriminator="action")])
ACTIONS = ("hold", "resume", "return", "release", "end", "remove", "mark", "exclude", "bearing")


def message_of(data: str | bytes) -> dict[str, Any]:
    """A frame from a browser as a message; an empty one where it is none."""
    try:
        message = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


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
