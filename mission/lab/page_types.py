"""Makes the types of the page's JavaScript from the models in Python: python -m mission.lab.page_types.

Models to JSON schema (pydantic), JSON schema to TypeScript declarations. The result is committed beside the page's
files: it is for those who write them and for the compiler that checks them, and no browser asks for it. A test holds
it against the models.
"""

import json
from collections.abc import Iterator
from functools import reduce
from operator import or_
from typing import Any, get_args

from pydantic import ConfigDict, TypeAdapter

from mission.page.commands import Command, Numbered, Question, Token
from mission.page.protocol import Failed, FittedBearing, OpenedRun, Recorded, Runs, Sent, Where
from mission.page.server import STATIC
from mission.plan.protocol import Draft, HeardVehicle, Port, Preflight

PATH = STATIC / "protocol.d.ts"
SOURCES = "mission/page/protocol.py, mission/page/commands.py, mission/plan/protocol.py"
HEAD = f"// Made by 'make protocol' from {SOURCES}: change those.\n"
STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
"""Read so, a message with a field too many, or with a number that JSON has no word for, is none."""
UNIONS = {"Sent": Sent, "Question": Question, "Command": Command}
PAGES = (Token, Numbered, Recorded, Where, FittedBearing, Runs, OpenedRun, Failed)
EDITORS = (Draft, Port, HeardVehicle, Preflight)
TAIL = """
/** A command as it is sent. */
export type Order = Numbered & Command;

/** Whatever goes over the websocket to the server. */
export type Asked = Token | Question | Order;
"""
WORDS = {"string": "string", "number": "number", "integer": "number", "boolean": "boolean", "null": "null"}


def declarations() -> str:
    """The whole file."""
    everything: Any = reduce(or_, (*UNIONS.values(), *PAGES, *EDITORS))
    adapter: TypeAdapter[Any] = TypeAdapter(everything, config=STRICT)
    shapes = adapter.json_schema()["$defs"]
    parts = [HEAD, *("\n".join(_interface(name, shapes[name])) + "\n" for name in sorted(shapes))]
    parts += [
        f"export type {name} = {' | '.join(each.__name__ for each in get_args(union))};\n"
        for name, union in UNIONS.items()
    ]
    return "\n".join(parts) + TAIL


def _interface(name: str, shape: dict[str, Any]) -> Iterator[str]:
    yield from _said(shape, "")
    yield f"export interface {name} {{"
    needed = shape.get("required", [])
    for key, value in shape["properties"].items():
        yield from _said(value, "  ")
        yield f"  {key}{'' if key in needed else '?'}: {_type(value)};"
    yield "}"


def _said(shape: dict[str, Any], margin: str) -> Iterator[str]:
    if text := " ".join(shape.get("description", "").split()):
        yield f"{margin}/** {text} */"


def _type(shape: dict[str, Any]) -> str:
    match shape:
        case {"$ref": reference}:
            return str(reference).rpartition("/")[2]
        case {"const": value}:
            return json.dumps(value)
        case {"enum": values}:
            return " | ".join(json.dumps(value) for value in values)
        case {"anyOf": ways} | {"oneOf": ways}:
            return " | ".join(_type(way) for way in ways)
        case {"prefixItems": items}:
            return f"[{', '.join(_type(item) for item in items)}]"
        case {"type": "array", "items": item}:
            return f"({_type(item)})[]" if item.keys() & {"anyOf", "oneOf", "enum"} else f"{_type(item)}[]"
        case {"type": "object", "additionalProperties": dict() as value}:
            return f"{{ [key: string]: {_type(value)} }}"
        case {"type": "object"}:
            return "{ [key: string]: unknown }"
        case {"type": str() as word}:
            return WORDS[word]
    return "unknown"


if __name__ == "__main__":
    PATH.write_text(declarations(), encoding="utf-8")
    print(f"wrote {PATH}")
