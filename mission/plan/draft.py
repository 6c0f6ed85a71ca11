"""A mission file as a form, and back: comments, order and whatever the form does not know stay as they are. Pure."""

from collections.abc import Mapping
from typing import Any, cast

import tomlkit
from tomlkit import TOMLDocument
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, Table

from fieldkit.errors import ConfigError
from mission.plan.protocol import (
    AntennaForm,
    EndForm,
    FieldForm,
    Form,
    SafetyForm,
    SourcesForm,
    TopForm,
)

FIELDS: dict[str, tuple[str, ...]] = {
    "": tuple(TopForm.__annotations__),
    "field": tuple(FieldForm.__annotations__),
    "antenna": tuple(AntennaForm.__annotations__),
    "sources": tuple(SourcesForm.__annotations__),
    "end": tuple(EndForm.__annotations__),
    "safety": tuple(SafetyForm.__annotations__),
}
"""Table to the keys that the form has; the first is the file's top."""


def form_of(text: str) -> Form:
    """What the form shows of a mission file's text. Raises `ConfigError` where that is no TOML."""
    document = _parsed(text)
    plain = document.unwrap()
    shown: dict[str, Any] = {}
    for table, keys in FIELDS.items():
        values = plain if not table else _table(plain.get(table))
        shown[table or "top"] = {key: values.get(key) for key in keys}
    robots = [each for each in _rows(plain.get("robot")) if isinstance(each.get("name"), str)]
    shown["robots"] = [
        {
            "name": each["name"],
            "receiver": dict(_table(each.get("receiver"))),
            "vehicle": dict(_table(each.get("vehicle"))),
            "altitude_m": each.get("altitude_m"),
        }
        for each in robots
    ]
    shown["teams"] = [list(each.get("robots") or []) for each in _rows(plain.get("team"))]
    return cast(Form, shown)


def plain_field(text: str) -> Mapping[str, Any]:
    """The file's `[field]`, of whatever kinds its values are. Raises `ConfigError` where the text is no TOML."""
    return _table(_parsed(text).unwrap().get("field"))


def with_form(text: str, form: Mapping[str, Any]) -> str:
    """The text with the form's values. What the form says as before is not touched.

    Raises `ConfigError` where the text is no TOML or the form is not one of `form_of`'s kind.
    """
    document = _parsed(text)
    before = cast(dict[str, Any], form_of(text))
    for table, keys in FIELDS.items():
        values = _table(form.get(table or "top"))
        old = before[table or "top"]
        for key in keys:
            if key in values and values[key] != old[key]:
                _put(document, table, key, values[key])
    robots = form.get("robots", before["robots"])
    if robots != before["robots"]:
        _put_robots(document, robots)
    teams = form.get("teams", before["teams"])
    if teams != before["teams"]:
        _put_teams(document, teams)
    return tomlkit.dumps(document)


def _parsed(text: str) -> TOMLDocument:
    try:
        return tomlkit.parse(text)
    except TOMLKitError as error:
        raise ConfigError(f"not valid TOML: {error}") from error


def _table(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _rows(value: Any) -> list[Mapping[str, Any]]:
    return [each for each in value if isinstance(each, Mapping)] if isinstance(value, list) else []


def _put(document: TOMLDocument, table: str, key: str, value: Any) -> None:
    """Set a value, or take it away where it is None."""
    if table and table not in document:
        document[table] = tomlkit.table()
    holder: Any = document[table] if table else document
    if value is None:
        holder.pop(key, None)
    else:
        holder[key] = _lines(value) if key in ("fence", "keep_out") else value


def _lines(value: Any) -> Any:
    """Corners in one line each polygon: as people write them."""
    if not isinstance(value, list):
        raise ConfigError(f"expected corners, got {value!r}")
    made = tomlkit.array()
    for each in value:
        made.append(_lines(each) if isinstance(each, list) else each)
    return made


def _inline(values: Mapping[str, Any]) -> Any:
    made = tomlkit.inline_table()
    made.update({key: value for key, value in values.items() if value not in (None, "")})
    return made


def _put_robots(document: TOMLDocument, robots: Any) -> None:
    old = {each["name"]: each for each in document.get("robot", []) if "name" in each}
    rows = AoT([])
    for robot in _rows(robots):
        name = str(robot.get("name", ""))
        row: Table = old.pop(str(robot.get("was", name)), None) or tomlkit.table()
        if row.get("name") != name:
            row["name"] = name
        for part in ("receiver", "vehicle"):
            given = {key: value for key, value in _table(robot.get(part)).items() if value not in (None, "")}
            if dict(_table(row.get(part))) != given:
                row[part] = _inline(given)
        altitude_m = robot.get("altitude_m")
        if altitude_m is None:
            row.pop("altitude_m", None)
        elif row.get("altitude_m") != altitude_m:
            row["altitude_m"] = altitude_m
        rows.append(row)
    _replace(document, "robot", rows)


def _put_teams(document: TOMLDocument, teams: Any) -> None:
    rows = AoT([])
    for team in teams if isinstance(teams, list) else []:
        row = tomlkit.table()
        row["robots"] = [str(name) for name in team]
        rows.append(row)
    _replace(document, "team", rows)


def _replace(document: TOMLDocument, key: str, rows: AoT) -> None:
    document.pop(key, None)
    if len(rows):
        document[key] = rows
