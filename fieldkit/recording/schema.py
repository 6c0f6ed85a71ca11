"""The recording's topics and their published JSON schemas. docs/recording.md is the same in words.

`SCHEMA` counts up when an old reader would misread a new file, not for new topics or fields with defaults.
"""

import json
import types
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from fieldkit.messages import (
    CallOperator,
    Command,
    Detection,
    EndMission,
    Event,
    GoTo,
    Hold,
    Land,
    Operator,
    Plan,
    Pose,
    ReceiverState,
    Return,
    RssReading,
    SourceEstimate,
    Tick,
    VehicleState,
)
from fieldkit.recording.codec import array_scalar

SCHEMA = 1
OLDEST_SCHEMA = 1
"""The first that is read still."""
PROFILE = "fieldkit"
HEADER_COPY = "header.json"
"""Attachment with the header message once more, and the number of each of our channels."""
Level = Literal["debug", "info", "warning", "error"]


@dataclass(frozen=True, slots=True)
class Note:
    """A line for the reader of the log: a fault, a phase, a decision of the runner."""

    level: Level
    text: str


@dataclass(frozen=True, slots=True)
class BeliefDigest:
    """What replay compares: the belief's hash after an event. `values` are a few numbers for people."""

    name: str
    digest: str
    values: dict[str, float]


@dataclass(frozen=True, slots=True)
class Topic:
    """One channel of ours: JSON messages of one kind."""

    name: str
    schema: str
    kind: type | None
    family: Literal["header", "event", "command", "detection", "sources", "plan", "belief", "result", "note"]


_IN: dict[str, type[Event]] = {
    "reading": RssReading,
    "receiver": ReceiverState,
    "pose": Pose,
    "vehicle": VehicleState,
    "tick": Tick,
    "operator": Operator,
}
_OUT: dict[str, type[Command]] = {
    "goto": GoTo,
    "hold": Hold,
    "return": Return,
    "land": Land,
    "call": CallOperator,
    "end": EndMission,
}

TOPICS: tuple[Topic, ...] = (
    Topic("/header", "fieldkit.Header", None, "header"),
    *(Topic(f"/in/{name}", f"fieldkit.{kind.__name__}", kind, "event") for name, kind in _IN.items()),
    *(Topic(f"/out/{name}", f"fieldkit.{kind.__name__}", kind, "command") for name, kind in _OUT.items()),
    Topic("/engine/detection", "fieldkit.Detection", Detection, "detection"),
    Topic("/engine/sources", "fieldkit.Sources", SourceEstimate, "sources"),
    Topic("/engine/plan", "fieldkit.Plan", Plan, "plan"),
    Topic("/engine/belief", "fieldkit.BeliefDigest", BeliefDigest, "belief"),
    Topic("/result", "fieldkit.Result", None, "result"),
    Topic("/note", "fieldkit.Note", Note, "note"),
)
BY_NAME = {topic.name: topic for topic in TOPICS}
BY_KIND = {topic.kind: topic for topic in TOPICS if topic.kind is not None}
HEADER, RESULT = BY_NAME["/header"], BY_NAME["/result"]


def json_schema(topic: Topic) -> dict[str, Any]:
    """The JSON schema of a topic's messages."""
    if topic.kind is None:
        return {"title": topic.schema, "type": "object"}
    schema = {"title": topic.schema, **_of(topic.kind)}
    if topic.family == "command":
        schema["properties"] = {"origin": {"type": "string"}, **schema["properties"]}
        schema["required"] = ["origin", *schema["required"]]
    if topic.family == "sources":
        sources = {"type": "array", "items": _of(topic.kind)}
        schema = {
            "title": topic.schema,
            "type": "object",
            "properties": {"sources": sources},
            "required": ["sources"],
        }
    return schema


def schema_text(topic: Topic) -> bytes:
    """The JSON schema as the bytes that go into the file."""
    return json.dumps(json_schema(topic), separators=(",", ":")).encode()


def _of(hint: Any) -> dict[str, Any]:
    origin, args = get_origin(hint), get_args(hint)
    if is_dataclass(hint):
        hints = get_type_hints(hint)
        return {
            "type": "object",
            "properties": {f.name: _of(hints[f.name]) for f in fields(hint)},
            "required": [
                f.name for f in fields(hint) if f.default is MISSING and f.default_factory is MISSING
            ],
        }
    if origin is Literal:
        return {"type": "string", "enum": list(args)}
    if origin in (Union, types.UnionType):
        return _of(next(arg for arg in args if arg is not type(None)))
    if origin is tuple:
        return {"type": "array", "items": _of(args[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": _of(args[1])}
    if (scalar := array_scalar(hint)) is not None:
        return {"type": "array", "items": {"type": "boolean"} if scalar is np.bool_ else {}}
    return {
        bool: {"type": "boolean"},
        int: {"type": "integer"},
        str: {"type": "string"},
        # Viewers take one type per field, so the three words for non-finite numbers are only described.
        float: {"type": "number", "description": "non-finite: the string nan, inf or -inf"},
    }[hint]
