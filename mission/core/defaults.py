"""Defaults of mission.toml as they were when a mission was recorded.

A recording holds the mission file as it was written. What the file leaves open goes into the recording as well, so that
a later fieldkit, whose defaults may be others, replays the mission that was flown.
"""

import json
import math
from collections.abc import Mapping
from typing import Any

import tomlkit

from mission.core.tables import (
    AssociationTable,
    EndTable,
    EngineTable,
    MissionFile,
    SafetyTable,
    SourcesTable,
)

TABLES = {
    "sources": SourcesTable(),
    "engine": EngineTable(),
    "association": AssociationTable(),
    "end": EndTable(),
    "safety": SafetyTable(),
}
"""The tables that decide what a mission does, as an empty file has them."""
SINCE = {("safety", "turn_radius_m"): 0.0}
"""Keys that came later and would change a mission by default: what was done before they were there."""


def left_open(file: MissionFile) -> dict[str, dict[str, Any]]:
    """What a mission file does not say, and what it was by default or is estimated as: table, key, value."""
    opened = {
        name: {
            key: value
            for key, value in _plain(getattr(file, name)).items()
            if key not in getattr(file, name).model_fields_set
        }
        for name in TABLES
    }
    if file.safety.turn_radius_m is None:
        opened["safety"]["turn_radius_m"] = file.turn_radius_m
    return opened


def filled_in(text: str, recorded: Mapping[str, Mapping[str, Any]]) -> str:
    """A mission file with what it left open as recorded, where today's default is another.

    A recording that says nothing of a table leaves it to today's defaults.

    Raises `ValueError` for a key that today's mission files do not have.
    """
    missing: dict[tuple[str, str], Any] = {
        (name, key): value
        for (name, key), value in SINCE.items()
        if key not in recorded.get(name, {key: value})
    }
    for name, keys in recorded.items():
        today = _plain(TABLES[name]) if name in TABLES else {}
        for key, value in keys.items():
            if name not in TABLES or key not in type(TABLES[name]).model_fields:
                raise ValueError(f"{name}.{key}: no such key today")
            if today.get(key) != value:
                missing[name, key] = value
    if not missing:
        return text
    document = tomlkit.parse(text)
    for (name, key), value in missing.items():
        table: Any = document.setdefault(name, tomlkit.table())
        table.setdefault(key, value)
    return tomlkit.dumps(document)


def _plain(table: Any) -> dict[str, Any]:
    """Values that TOML and JSON have alike; what is unlimited or not given has none."""
    values = json.loads(table.model_dump_json())
    return {
        key: value
        for key, value in values.items()
        if value is not None and not (isinstance(value, float) and math.isinf(value))
    }
